"""Passive safety of spacecraft: what a mission that asks for it needs, and what agents look at."""

from math import ceil
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.model import StateSamples
from problems.convexify import AvoidanceHorizon
from problems.drifts import KEPT_FACTOR, DriftHorizon, Drifts
from problems.path_separation import find_meetings
from problems.transfer import Trajectory
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.free_motion import FREE_ORBITS, drift_freely, simulate
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.plan import Plans, compute_spent, remaining_controls
from sato.reconfiguration.state import DecisionContext
from sato.scenario.errors import InputError
from sato.scp.passive_safety import PassiveSafety
from sato.scp.planner import Planner

FINE_STEPS = 4  # of the integration of a plan that is flown on, in a step
PIECES_PER_ORBIT = 60  # of a circular orbit: cubics are within 3e-7 of what a vehicle drifts
STEPS_PER_ORBIT = 120  # of the integration: within 2e-7
DRIFT_ERROR = 0.01  # of drifts of up to 25 km an orbit, both together, in each orbit [m]


class OfferedDrifts(NamedTuple):
    """Drifts of the trajectories that agents may commit to."""

    horizon: DriftHorizon
    drifts: Drifts  # of each agent and choice

    def are_safe(
        self, choice: Int[Array, " agents"], i: Int[Array, " pairs"], j: Int[Array, " pairs"]
    ) -> Bool[Array, " pairs"]:
        """Find the pairs whose choices keep clear of each other's drifts."""
        own = self.drifts.take((np.arange(len(choice)), choice))

        def is_safe(a: int, b: int) -> bool:
            return not len(self.horizon.find_near_paths(own.take(a), own.path[[b]]).row)

        pairs = zip(i.tolist(), j.tolist(), strict=True)
        return np.array([is_safe(a, b) and is_safe(b, a) for a, b in pairs], dtype=bool)


def begin_passively_safe(
    context: DecisionContext,
    planners: dict[int, Planner],
    previous: Plans,
    clocks: Int[Array, " agents"],
) -> dict[int, Planner]:
    """Let agents begin with the rests of their plans, or their solo trajectories, and drifts.

    All of a network look ahead as far as the one whose clock has most time left.
    """
    component, found = context.graph.component, dict[int, Planner]()
    for network in np.unique(component[list(planners)]):
        members = {i: own for i, own in planners.items() if component[i] == network}
        steps = int((context.leg.steps - clocks[list(members)]).max())
        own = context.mission, context.leg, context.time, steps
        horizon, arrivals = follow_targets(*own)
        begun = _follow_nominals(context, members, previous, horizon)
        known = {
            i: _foresee(horizon, drifts, arrivals, int(context.memory.target_index[i]))
            for i, (_, drifts) in begun.items()
        }
        for i, (nominal, drifts) in begun.items():
            others = {j: each for j, each in known.items() if j != i}
            found[i] = planners[i]._replace(
                nominal=nominal,
                control_points=planners[i].horizon.control_points(nominal.x, nominal.u),
                passive=PassiveSafety(horizon, others, nominal, drifts),
                in_turn=True,
                has_converged=len(nominal.u) == 0 or planners[i].reaches_target(nominal),
            )
    return {i: found[i] for i in planners}


def _follow_nominals(
    context: DecisionContext, planners: dict[int, Planner], previous: Plans, horizon: DriftHorizon
) -> dict[int, tuple[Trajectory, Drifts]]:
    """Return the nominal with which each agent begins, and its drifts."""
    u, alike = dict[int, Float[Array, "T m"]](), dict[tuple[int, bool], list[int]]()
    for i, planner in planners.items():
        rest = remaining_controls(context, previous, i)
        u[i] = planner.solo.u if rest is None else rest
        alike.setdefault((len(u[i]), rest is None), []).append(i)
    found = dict[int, tuple[Trajectory, Drifts]]()
    for (_, is_new), agents in alike.items():  # at once: it is one integration
        controls = np.stack([u[i] for i in agents])
        if is_new:
            x = np.stack([planners[i].solo.x for i in agents])
        else:  # along the rests of their plans
            fine, h = np.repeat(controls, FINE_STEPS, axis=1), context.mission.step / FINE_STEPS
            x = simulate(context.mission, context.state[agents], fine, context.time, h)
            x = x[:, ::FINE_STEPS]
        followed = horizon.follow(x, controls)
        for row, i in enumerate(agents):
            fuel = float(compute_spent(context.mission, u[i]))
            nominal = planners[i].solo if is_new else Trajectory(x[row], u[i], fuel)
            found[i] = nominal, followed.take(row)
    return found


def _foresee(
    horizon: DriftHorizon, own: Drifts, arrivals: Float[Array, "targets later 4 d"], target: int
) -> Drifts:
    """Return what others know of an agent that tells them its state and its target, and no plan."""
    path, T = np.zeros_like(own.path), horizon.steps.steps
    path[T:] = arrivals[target] if target >= 0 else own.path[T:]
    return Drifts(path, np.where((horizon.step == 0)[:, None, None], own.drifts, 0.0))


def follow_targets(
    mission: Reconfiguration, leg: Leg, time: float, steps: int
) -> tuple[DriftHorizon, Float[Array, "targets later 4 d"]]:
    """Return over what time drifts are looked at, and the free motion of all targets then."""
    horizon, begin = make_horizon(mission, time, steps), time + steps * mission.step
    later = len(horizon.later), begin, horizon.later.dt
    return horizon, drift_freely(mission, leg.targets, *later)


def make_horizon(mission: Reconfiguration, time: float, steps: int) -> DriftHorizon:
    """Return over what time drifts are looked at, of plans with so many steps from a time on."""
    assert mission.passive_safety is not None and mission.orbital_period is not None
    model, dt, period = mission.linear_model, mission.step, mission.orbital_period
    duration = mission.passive_safety_time or FREE_ORBITS * period
    e = 0.0 if mission.chief is None else mission.chief.orbit.eccentricity
    swing = float((1 + e) ** 2 / (1 - e**2) ** 1.5)  # rate of the chief at perigee over its mean
    h, longest = period / ceil(PIECES_PER_ORBIT * swing), period / (STEPS_PER_ORBIT * swing**2)

    def move(x: StateSamples, t: float, length: float) -> StateSamples:
        count = ceil(length / longest)
        rest = np.zeros((*x.shape[:-1], count, mission.axes))
        return simulate(mission, x, rest, t, length / count)[..., -1, :]

    plan = discretize_zoh(model, dt, steps, time)
    later = discretize_zoh(model, h, ceil(duration / h), time + steps * dt)
    distance = mission.passive_safety + DRIFT_ERROR * max(1.0, duration / period)
    piecewise = AvoidanceHorizon(plan, plan, distance)
    return DriftHorizon(piecewise, later, move, time, duration, distance)


def check_targets(mission: Reconfiguration) -> None:
    """Refuse targets that do not keep the distance themselves for as long as drifts are to."""
    begun = 0
    for number, leg in enumerate(mission.legs):
        horizon, arrivals = follow_targets(mission, leg, begun * mission.step, leg.steps)
        begun += leg.steps
        i, j = np.triu_indices(len(arrivals), 1)
        met, _ = find_meetings(arrivals, i, j, np.full(len(i), KEPT_FACTOR * horizon.distance))
        if len(met):
            i, j = i[met.min()], j[met.min()]
            raise InputError(
                "plan.passive_safety_m",
                f"targets {i} and {j} of leg {number} come within "
                f"{mission.passive_safety:g} m of each other as they drift; a smaller distance, a "
                "wider shape or fewer targets would do",
            )


def check_network(mission: Reconfiguration) -> None:
    """Refuse starts in several networks: a drift leads far, and nobody knows of another network."""
    place, alive = mission.initial_states[:, : mission.axes], mission.alive
    graph = CommunicationGraph.from_positions(place, mission.comm_radius, alive)
    count = len(np.unique(graph.component[alive]))
    if count > 1:
        raise InputError(
            "plan.passive_safety_m",
            f"needs all vehicles in one network, and the starts form {count}; a larger "
            "swarm.comm_radius_m, more vehicles or starts nearer to each other would do",
        )
