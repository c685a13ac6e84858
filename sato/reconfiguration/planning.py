"""How to get there: a flight for every agent among its neighbours."""

from functools import lru_cache
from math import ceil, isfinite
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.trajectory_geometry import interpolation_error
from problems.convexify import AvoidanceHorizon
from problems.transfer import Trajectory, compute_fuel
from sato.reconfiguration.auction_costs import AgentMemory
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.moment import DecisionContext
from sato.reconfiguration.solo_trajectories import make_relinearizer, solve_solo_trajectories
from sato.scp import CONVERGENCE_TOLERANCE, FEASIBILITY_TOLERANCE, Planner, resolve_conflicts

MAX_PIECES = 12  # in a step

Event = dict[str, Any]


class Plans(NamedTuple):
    """What each agent is about to fly, and since when."""

    trajectories: dict[int, Trajectory]
    target_indices: dict[
        int, int
    ]  # the target that a flight ends at; absent where it ends elsewhere
    planned_at: dict[int, int]  # steps since the start of the leg

    def controls_at(
        self, k: int, alive: Bool[Array, " agents"], axes: int
    ) -> Float[Array, "agents m"]:
        """Controls at a step of the leg; none once a flight is over, NaN for the dead."""
        control = np.full((len(alive), axes), np.nan)
        for i in np.flatnonzero(alive).tolist():
            u = self.trajectories[i].u[k - self.planned_at[i] :]
            control[i] = u[0] if len(u) else 0.0
        return control

    def remaining_controls(self, i: int, target: int, k: int, T: int) -> Float[Array, "T m"] | None:
        """What is left of an agent's controls, if they still lead to its target in T steps."""
        if self.target_indices.get(i) != target:
            return None
        u = self.trajectories[i].u[k - self.planned_at[i] :]
        return u if len(u) == T else None

    def reaches_target(
        self, minds: AgentMemory, k: int, left: Int[Array, " agents"]
    ) -> Bool[Array, " agents"]:
        """Who has a plan that leads to its target in the steps that it has left."""
        there = [
            self.remaining_controls(i, int(target), k, int(left[i])) is not None
            for i, target in enumerate(minds.target_index)
        ]
        return np.array(there, dtype=bool)

    def remaining_fuel(
        self, moment: DecisionContext, minds: AgentMemory
    ) -> Float[Array, " agents"]:
        """Fuel in what is left of each agent's plan; infinite where none serves it [m/s]."""
        mission, fuel = moment.mission, np.full(len(minds.target_index), np.inf)
        for i in self.target_indices:
            left = moment.leg.steps - int(minds.clock[i])
            u = self.remaining_controls(i, int(minds.target_index[i]), moment.step_index, left)
            if u is not None:
                fuel[i] = compute_fuel(u, mission.step, mission.fuel_norm)
        return fuel

    def updated_with(self, newer: "Plans") -> "Plans":
        """These plans, with those of some agents replaced by newer ones."""
        ends = {
            i: target for i, target in self.target_indices.items() if i not in newer.trajectories
        }
        return Plans(
            {**self.trajectories, **newer.trajectories},
            {**ends, **newer.target_indices},
            {**self.planned_at, **newer.planned_at},
        )


NO_PLANS = Plans({}, {}, {})


def plan_trajectories(
    moment: DecisionContext,
    minds: AgentMemory,
    spent: Float[Array, " agents"],
    before: Plans,
    solves: int = 0,
) -> tuple[Plans, list[Event]]:
    """Plan for every agent that decides.

    Args:
        moment: What there is to decide with.
        minds: What the agents remember: their targets and clocks.
        spent: Fuel that each has burnt [m/s]; who has more left gives way.
        before: The plans flown so far.
        solves: Programmes that were solved for this replan already.
    """
    mission, network, state = moment.mission, moment.graph, moment.state
    horizon = make_horizon(mission, moment.time, moment.leg.steps - moment.step_index)
    planners: dict[int, Planner] = {}
    late: list[int] = []
    # Who goes first may have given way by little in a bargain, and others count on it.
    same = (
        FEASIBILITY_TOLERANCE if mission.bargains else CONVERGENCE_TOLERANCE
    ) * horizon.collision_radius
    for clock in np.unique(minds.clock[network.alive]):
        those = np.flatnonzero(network.alive & (minds.clock == clock)).tolist()
        steps = moment.remaining_model(int(clock))
        goals = moment.leg.targets[minds.target_index[those]]
        rests = {
            i: before.remaining_controls(
                i, int(minds.target_index[i]), moment.step_index, len(steps)
            )
            for i in those
        }
        routes, counted = solve_solo_trajectories(
            moment, steps, state[those], goals, list(rests.values())
        )
        solves += counted
        paths = horizon.control_points(
            *(np.stack(part) for part in zip(*(r.trajectory[:2] for r in routes), strict=True))
        )
        for i, goal, route, path in zip(those, goals, routes, paths, strict=True):
            rank = (len(steps) > 0, -float(spent[i]), i)
            free, about = route.trajectory, make_relinearizer(moment, route.transfer)
            planner = Planner(rank, goal, route.transfer, horizon, free, free, path, about)
            planners[i] = _start_from_previous(planner, rests[i], same)
            late += [i] if route.is_unreachable else []
    settled = resolve_conflicts(planners, network, mission.orders, mission.bargains)
    planners, solves = settled.planners, solves + settled.solve_count
    events: list[Event] = [
        {"kind": "replan", "agents": [], "solves": solves, "exchanges": settled.round_count}
    ]
    events += _make_relaxation_events(mission, planners, late)
    chosen = {i: p.nominal for i, p in planners.items()}
    # Who comes too close to somebody may still arrive.
    astray = {i for event in events if event["kind"] != "slack" for i in event["agents"]}
    ends = {i: int(minds.target_index[i]) for i in planners if i not in astray}
    return before.updated_with(
        Plans(chosen, ends, dict.fromkeys(planners, moment.step_index))
    ), events


def _start_from_previous(agent: Planner, rest: Float[Array, "T m"] | None, same: float) -> Planner:
    """Begin with the plan of before, where that kept clear of somebody by going another way."""
    if rest is None:
        return agent
    prior = agent.transfer.simulate(agent.solo.x[0], rest)
    if float(np.abs(prior.x - agent.solo.x).max()) <= same:
        return agent
    path = agent.horizon.control_points(prior.x, prior.u)
    return agent._replace(nominal=prior, control_points=path, has_converged=False)


def make_horizon(mission: Reconfiguration, time: float, left: int) -> AvoidanceHorizon:
    """The avoidance horizon from a time on, when so many steps of the leg are left as asked for.

    T_H steps, or as far as is foreseen among agents in earshot, but not past the end of a
    leg that takes the time asked for, which all agents know. A step is cut so finely that
    two agents at full speed move by about R_col in a piece.
    """
    fast = mission.max_speed if isfinite(mission.max_speed) else 0.0
    S = min(MAX_PIECES, max(1, ceil(2 * fast * mission.step / mission.collision_radius)))
    T = max(mission.horizon_steps, min(mission.foresight_steps, left))
    return AvoidanceHorizon(
        discretize_zoh(mission.linear_model, mission.step, T, time),
        discretize_zoh(mission.linear_model, mission.step / S, T * S, time),
        mission.collision_radius
        + mission.margin
        + _interpolation_margin(mission, mission.step / S),
    )


@lru_cache(maxsize=8)  # the same at every replan of a mission
def _interpolation_margin(mission: Reconfiguration, h: float) -> float:
    # What the pieces of two agents could miss, at the states that the mission begins and
    # ends with and under full control, twice over for what lies between.
    ends = np.concatenate([mission.initial_states, *(leg.targets for leg in mission.legs)])
    x = np.stack([ends, ends], axis=1)
    u = np.full((len(ends), 1, mission.linear_model.axes), mission.max_control)
    return 4 * interpolation_error(mission.linear_model, x, u, h)


def _make_relaxation_events(
    mission: Reconfiguration, planners: dict[int, Planner], late: list[int]
) -> list[Event]:
    tight = FEASIBILITY_TOLERANCE * mission.collision_radius
    slack = {i: p.slack for i, p in planners.items() if p.slack > tight}
    failed = [i for i, p in planners.items() if p.has_failed]
    braked = [
        i for i, p in planners.items() if i in late or p.has_failed or _misses_target(mission, p)
    ]
    events: list[Event] = []
    if slack:
        events.append({"kind": "slack", "agents": list(slack), "amount_m": list(slack.values())})
    if braked:
        events.append({"kind": "braked", "agents": braked})
    if late:
        what = "the target is out of reach in the time that is left"
        events.append({"kind": "infeasible", "agents": late, "what": what})
    if failed:
        what = "no flight keeps clear of those that go before"
        events.append({"kind": "infeasible", "agents": failed, "what": what})
    return events


def _misses_target(mission: Reconfiguration, planner: Planner) -> bool:
    d = mission.linear_model.axes
    miss = np.abs(planner.nominal.x[-1] - planner.target_state)
    off = (miss[:d] > mission.position_tolerance).any()
    return planner.terminal_error > 0 and bool(off or (miss[d:] > mission.velocity_tolerance).any())
