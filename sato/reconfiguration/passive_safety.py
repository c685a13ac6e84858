"""Passive safety of spacecraft: what a mission that asks for it needs, and what agents look at."""

from math import ceil
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.model import StateSamples
from dynamics.trajectory_geometry import control_points
from problems.convexify import AvoidanceHorizon
from problems.drifts import DriftHorizon
from sato.reconfiguration.free_motion import FREE_ORBITS, PIECES_PER_ORBIT, simulate
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import DecisionContext
from sato.scp.passive_safety import PassiveSafety


class DriftOutlook(NamedTuple):
    """Time over which the agents of a network look at drifts, and the motion of all targets."""

    horizon: DriftHorizon
    arrivals: Float[Array, "targets later 4 d"]  # control points of free motion from targets [m]

    def knowledge_of(self, context: DecisionContext, agent: int) -> PassiveSafety:
        """Return what an agent knows of the others in its network: the targets they claim."""
        graph, target = context.graph, context.memory.target_index
        network = np.flatnonzero(graph.alive & (graph.component == graph.component[agent]))
        others = [j for j in network.tolist() if j != agent and target[j] >= 0]
        return PassiveSafety(self.horizon, {j: self.arrivals[target[j]] for j in others})


def look_ahead(
    context: DecisionContext, clocks: Int[Array, " agents"]
) -> dict[int, DriftOutlook] | None:
    """Return how far each network looks at drifts; None where the mission does not ask for it.

    Args:
        context: Time and graph.
        clocks: Clock of each agent; all of a network look as far as the one with most time left.
    """
    if context.mission.passive_safety is None:
        return None
    graph, steps = context.graph, context.leg.steps
    left = graph.component_max(steps - clocks)
    outlooks = {T: _look_ahead(context, T) for T in set(left[graph.alive].tolist())}
    members = np.flatnonzero(graph.alive).tolist()
    return {int(graph.component[i]): outlooks[int(left[i])] for i in members}


def _look_ahead(context: DecisionContext, steps: int) -> DriftOutlook:
    mission, d = context.mission, context.mission.axes
    horizon = make_horizon(mission, context.time, steps)
    h, begin = horizon.later.dt, context.time + steps * mission.step
    rest = np.zeros((len(context.leg.targets), len(horizon.later), d))
    states = simulate(mission, context.leg.targets, rest, begin, h)
    return DriftOutlook(horizon, control_points(states[..., :d], states[..., d:], h))


def make_horizon(mission: Reconfiguration, time: float, steps: int) -> DriftHorizon:
    """Return over what time drifts are looked at, of plans with so many steps from a time on."""
    assert mission.passive_safety is not None and mission.orbital_period is not None
    model, dt, distance = mission.linear_model, mission.step, mission.passive_safety
    duration = mission.passive_safety_time or FREE_ORBITS * mission.orbital_period
    h = mission.orbital_period / PIECES_PER_ORBIT

    def move(x: StateSamples, t: float, length: float) -> StateSamples:
        rest = np.zeros((*x.shape[:-1], 1, mission.axes))
        return simulate(mission, x, rest, t, length)[..., 1, :]

    plan = discretize_zoh(model, dt, steps, time)
    later = discretize_zoh(model, h, ceil(duration / h), time + steps * dt)
    return DriftHorizon(
        AvoidanceHorizon(plan, plan, distance), later, move, time, duration, distance
    )
