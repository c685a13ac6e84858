"""Passive safety of spacecraft: what a mission that asks for it needs, and what agents look at."""

from math import ceil
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.model import StateSamples
from dynamics.trajectory_geometry import control_points
from problems.convexify import AvoidanceHorizon
from problems.drifts import DriftHorizon
from sato.reconfiguration.free_motion import FREE_ORBITS, PIECES_PER_ORBIT, simulate
from sato.scp.passive_safety import PassiveSafety

if TYPE_CHECKING:
    from sato.reconfiguration.state import DecisionContext


def look_ahead(context: "DecisionContext", steps: int) -> DriftHorizon | None:
    """Return over what time drifts are looked at; None where nobody asks for it.

    Args:
        context: Time.
        steps: Steps of plans from now on.
    """
    mission, dt = context.mission, context.mission.step
    if mission.passive_safety is None:
        return None
    assert mission.orbital_period is not None
    duration = mission.passive_safety_time or FREE_ORBITS * mission.orbital_period
    h = mission.orbital_period / PIECES_PER_ORBIT
    model = mission.linear_model

    def move(x: StateSamples, t: float, length: float) -> StateSamples:
        rest = np.zeros((*x.shape[:-1], 1, mission.axes))
        return simulate(mission, x, rest, t, length)[..., 1, :]

    plan = discretize_zoh(model, dt, steps, context.time)
    later = discretize_zoh(model, h, ceil(duration / h), context.time + steps * dt)
    piecewise = AvoidanceHorizon(plan, plan, mission.passive_safety)
    return DriftHorizon(piecewise, later, move, context.time, duration, mission.passive_safety)


def list_arrivals(
    context: "DecisionContext", horizon: DriftHorizon
) -> Float[Array, "targets later 4 d"]:
    """Return the control points of the free motion from each target on [m]."""
    mission, count, d = context.mission, len(horizon.later), context.mission.axes
    x, h = context.leg.targets, horizon.later.dt
    begin = context.time + horizon.steps.steps * mission.step
    states = simulate(mission, x, np.zeros((len(x), count, d)), begin, h)
    return control_points(states[..., :d], states[..., d:], h)


def make_passive(
    context: "DecisionContext",
    agent: int,
    horizon: DriftHorizon,
    arrivals: Float[Array, "targets later 4 d"],
) -> PassiveSafety:
    """Return what an agent knows of the others in its network: which targets they have claimed."""
    graph, target = context.graph, context.memory.target_index
    network = np.flatnonzero(graph.alive & (graph.component == graph.component[agent]))
    others = [j for j in network.tolist() if j != agent and target[j] >= 0]
    return PassiveSafety(horizon, {j: arrivals[target[j]] for j in others})
