"""Passive safety of spacecraft: what a mission that asks for it needs, and what agents look at."""

from math import ceil
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.model import StateSamples
from dynamics.trajectory_geometry import control_points
from problems.convexify import AvoidanceHorizon
from problems.drifts import KEPT_FACTOR, DriftHorizon, Drifts
from problems.transfer import Trajectory
from sato.reconfiguration.free_motion import FREE_ORBITS, simulate
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.plan import Plans, compute_spent, remaining_controls
from sato.reconfiguration.state import DecisionContext
from sato.scp.passive_safety import PassiveSafety
from sato.scp.planner import Planner

FINE_STEPS = 4  # of the integration of a plan that is flown on, in a step
PIECES_PER_ORBIT = 60  # of a circular orbit: cubics are within 3e-7 of what a vehicle drifts
STEPS_PER_ORBIT = 120  # of the integration: within 2e-7
DRIFT_ERROR = 0.02  # of drifts of up to 50 km in two orbits, both together [m]


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


class OfferedDrifts(NamedTuple):
    """Drifts of the trajectories that agents may commit to."""

    horizon: DriftHorizon
    drifts: Drifts  # of agents and choices

    def are_safe(
        self, choice: Int[Array, " agents"], i: Int[Array, " pairs"], j: Int[Array, " pairs"]
    ) -> Bool[Array, " pairs"]:
        """Find the pairs whose choices keep clear of each other's drifts."""
        own = self.drifts.take((np.arange(len(choice)), choice))
        none = own.path[:0, self.horizon.steps.steps :]
        found = [
            self.horizon.find_encounters(own.take(a), own.take([b]), none, KEPT_FACTOR)
            for a, b in zip(i.tolist(), j.tolist(), strict=True)
        ]
        return np.array([not any(len(each.drift) for each in both) for both in found], dtype=bool)


def offer_drifts(
    context: DecisionContext, steps: int, x: Float[Array, "agents 2 _ n"], u: Array
) -> OfferedDrifts | None:
    """Return the drifts of trajectories over some steps; None where nobody looks at them."""
    if not context.mission.is_passively_safe:
        return None
    horizon = make_horizon(context.mission, context.time, steps)
    return OfferedDrifts(horizon, horizon.follow(x, u))


def begin_passively_safe(
    context: DecisionContext,
    planners: dict[int, Planner],
    previous: Plans,
    clocks: Int[Array, " agents"],
) -> dict[int, Planner]:
    """Let agents begin with the rests of their plans, or their solo trajectories, and drifts.

    Args:
        context: States, memory, graph and time.
        planners: Planners of the agents.
        previous: Plans that were flown so far.
        clocks: Clock of each agent; all of a network look as far as the one with most time left.
    """
    graph, steps = context.graph, context.leg.steps
    left = graph.component_max(steps - clocks)
    outlooks = {T: _look_ahead(context, T) for T in {int(left[i]) for i in planners}}
    own = previous, context.memory, context.step_index, steps
    rests = {i: remaining_controls(own[0], i, *own[1:]) for i in planners}
    u = {i: own.solo.u if rests[i] is None else rests[i] for i, own in planners.items()}
    alike = dict[tuple[int, int, bool], list[int]]()
    for i in planners:
        alike.setdefault((int(left[i]), len(u[i]), rests[i] is None), []).append(i)
    begun = dict[int, Planner]()
    for (T, _, is_new), agents in alike.items():  # at once: it is one integration
        controls = np.stack([u[i] for i in agents])
        x = np.stack([planners[i].solo.x for i in agents])
        x = x if is_new else _fly_on(context, agents, controls)
        followed = outlooks[T].horizon.follow(x, controls)
        fuel = compute_spent(context.mission, controls)
        for row, i in enumerate(agents):
            nominal = Trajectory(x[row], controls[row], float(fuel[row]))
            planner = planners[i]._replace(
                passive=outlooks[T].knowledge_of(context, i),
                in_turn=True,
                has_converged=planners[i].reaches_target(nominal),
            )
            begun[i] = planner.with_nominal(nominal, followed.take(row))
    return {i: begun[i] for i in planners}


def _fly_on(
    context: DecisionContext, agents: list[int], u: Float[Array, "agents T m"]
) -> Float[Array, "agents _ n"]:
    """Return the states of agents along the rests of their plans."""
    mission, fine = context.mission, np.repeat(u, FINE_STEPS, axis=1)
    h = mission.step / FINE_STEPS
    return simulate(mission, context.state[agents], fine, context.time, h)[:, ::FINE_STEPS]


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
    model, dt, period = mission.linear_model, mission.step, mission.orbital_period
    duration = mission.passive_safety_time or FREE_ORBITS * period
    swing = _perigee_rate(mission)
    h, longest = period / ceil(PIECES_PER_ORBIT * swing), period / (STEPS_PER_ORBIT * swing**2)

    def move(x: StateSamples, t: float, length: float) -> StateSamples:
        count = ceil(length / longest)
        rest = np.zeros((*x.shape[:-1], count, mission.axes))
        return simulate(mission, x, rest, t, length / count)[..., -1, :]

    plan = discretize_zoh(model, dt, steps, time)
    later = discretize_zoh(model, h, ceil(duration / h), time + steps * dt)
    distance = mission.passive_safety + DRIFT_ERROR
    piecewise = AvoidanceHorizon(plan, plan, distance)
    return DriftHorizon(piecewise, later, move, time, duration, distance)


def _perigee_rate(mission: Reconfiguration) -> float:
    """Return the angular rate of the chief at perigee, over its mean."""
    e = 0.0 if mission.chief is None else mission.chief.orbit.eccentricity
    return float((1 + e) ** 2 / (1 - e**2) ** 1.5)
