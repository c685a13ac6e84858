"""Planning of trajectories: each agent alone, then conflict resolution among neighbors."""

from functools import lru_cache
from math import ceil, isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.trajectory_geometry import interpolation_error
from problems.convexify import AvoidanceHorizon
from problems.transfer import Trajectory, compute_fuel
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.solo_trajectories import (
    SoloSolution,
    make_relinearizer,
    solve_solo_trajectories,
)
from sato.reconfiguration.state import AgentMemory, DecisionContext, Event
from sato.scp import CONVERGENCE_TOLERANCE, FEASIBILITY_TOLERANCE, Planner, resolve_conflicts

MAX_PIECES = 12  # of the trajectory within a step


class Plans(NamedTuple):
    """Planned trajectory of each agent, its target, and the step at which it was planned."""

    trajectories: dict[int, Trajectory]
    target_indices: dict[int, int]  # absent where a trajectory ends elsewhere
    planned_at: dict[int, int]  # steps since the start of the leg

    def controls_at(
        self, k: int, alive: Bool[Array, " agents"], axes: int
    ) -> Float[Array, "agents m"]:
        """Return the controls at a step of the leg: 0 after the end of a plan, NaN if lost."""
        control = np.full((len(alive), axes), np.nan)
        for i in np.flatnonzero(alive).tolist():
            u = self.trajectories[i].u[k - self.planned_at[i] :]
            control[i] = u[0] if len(u) else 0.0
        return control

    def remaining_controls(self, i: int, target: int, k: int, T: int) -> Float[Array, "T m"] | None:
        """Return the rest of an agent's controls, if they reach its target in T steps."""
        if self.target_indices.get(i) != target:
            return None
        u = self.trajectories[i].u[k - self.planned_at[i] :]
        return u if len(u) == T else None

    def reaches_target(
        self, memory: AgentMemory, k: int, left: Int[Array, " agents"]
    ) -> Bool[Array, " agents"]:
        """Tell which agents have a plan that reaches their target in the steps that are left."""
        found = [
            self.remaining_controls(i, int(target), k, int(left[i])) is not None
            for i, target in enumerate(memory.target_index)
        ]
        return np.array(found, dtype=bool)

    def remaining_fuel(
        self, context: DecisionContext, memory: AgentMemory
    ) -> Float[Array, " agents"]:
        """Return the fuel left in each plan [m/s]; infinite where none reaches the target."""
        mission, fuel = context.mission, np.full(len(memory.target_index), np.inf)
        for i in self.target_indices:
            left = context.leg.steps - int(memory.clock[i])
            u = self.remaining_controls(i, int(memory.target_index[i]), context.step_index, left)
            if u is not None:
                fuel[i] = compute_fuel(u, mission.step, mission.fuel_norm)
        return fuel

    def updated_with(self, newer: "Plans") -> "Plans":
        """Return these plans, with those of some agents replaced by newer ones."""
        kept = {i: j for i, j in self.target_indices.items() if i not in newer.trajectories}
        return Plans(
            self.trajectories | newer.trajectories,
            kept | newer.target_indices,
            self.planned_at | newer.planned_at,
        )


NO_PLANS = Plans({}, {}, {})


def plan_trajectories(
    context: DecisionContext,
    memory: AgentMemory,
    fuel_used: Float[Array, " agents"],
    previous: Plans,
    solve_count: int = 0,
) -> tuple[Plans, list[Event]]:
    """Plan for every agent that decides: alone first, then clear of the others.

    Args:
        context: States and graph of the agents that decide.
        memory: Targets and clocks of the agents.
        fuel_used: Fuel burned so far [m/s]; the agent that has burned less gives way.
        previous: Plans that were flown so far.
        solve_count: Programs solved for this replanning already.
    """
    mission = context.mission
    planners, unreachable, solo_count = _plan_alone(context, memory, fuel_used, previous)
    resolved = resolve_conflicts(planners, context.graph, mission.orders, mission.bargains)
    replan = {"solves": solve_count + solo_count + resolved.solve_count}
    events: list[Event] = [
        {"kind": "replan", "agents": [], **replan, "exchanges": resolved.round_count}
    ]
    events += _relaxation_events(mission, resolved.planners, unreachable)
    # An agent that comes too close to another may still arrive.
    astray = {i for event in events if event["kind"] != "slack" for i in event["agents"]}
    new = Plans(
        {i: planner.nominal for i, planner in resolved.planners.items()},
        {i: int(memory.target_index[i]) for i in resolved.planners if i not in astray},
        dict.fromkeys(resolved.planners, context.step_index),
    )
    return previous.updated_with(new), events


def make_horizon(mission: Reconfiguration, time: float, steps_left: int) -> AvoidanceHorizon:
    """Build the avoidance horizon at a time, with so many steps of the leg left as planned.

    It has T_H steps, or as many as are foreseen among agents within hearing, but does not pass
    the planned end of the leg, which all agents know. A step is divided so finely that two
    agents at full speed move by about R_col in a piece.
    """
    speed = mission.max_speed if isfinite(mission.max_speed) else 0.0
    S = min(MAX_PIECES, max(1, ceil(2 * speed * mission.step / mission.collision_radius)))
    T = max(mission.horizon_steps, min(mission.foresight_steps, steps_left))
    margin = mission.margin + _interpolation_margin(mission, mission.step / S)
    return AvoidanceHorizon(
        discretize_zoh(mission.linear_model, mission.step, T, time),
        discretize_zoh(mission.linear_model, mission.step / S, T * S, time),
        mission.collision_radius + margin,
    )


def _plan_alone(
    context: DecisionContext,
    memory: AgentMemory,
    fuel_used: Float[Array, " agents"],
    previous: Plans,
) -> tuple[dict[int, Planner], list[int], int]:
    """Return a planner for every agent, those whose targets are unreachable, and the solves."""
    mission, k = context.mission, context.step_index
    horizon = make_horizon(mission, context.time, context.leg.steps - k)
    planners: dict[int, Planner] = {}
    unreachable: list[int] = []
    solve_count = 0
    # The first agent may have given way by little in a negotiation, and others count on it.
    relative = FEASIBILITY_TOLERANCE if mission.bargains else CONVERGENCE_TOLERANCE
    tolerance = relative * horizon.clearance
    for clock in np.unique(memory.clock[context.graph.alive]):
        agents = np.flatnonzero(context.graph.alive & (memory.clock == clock)).tolist()
        model = context.remaining_model(int(clock))
        targets = context.leg.targets[memory.target_index[agents]]
        rests = [
            previous.remaining_controls(i, int(memory.target_index[i]), k, len(model))
            for i in agents
        ]
        solutions, count = solve_solo_trajectories(
            context, model, context.state[agents], targets, rests
        )
        solve_count += count
        each = zip(*(solution.trajectory[:2] for solution in solutions), strict=True)
        paths = horizon.control_points(*(np.stack(part) for part in each))
        for i, target, solution, path, rest in zip(
            agents, targets, solutions, paths, rests, strict=True
        ):
            priority = (len(model) > 0, -float(fuel_used[i]), i)
            planner = _make_planner(context, priority, target, solution, horizon, path)
            planners[i] = _start_from_previous(planner, rest, tolerance)
            unreachable += [i] if solution.is_unreachable else []
    return planners, unreachable, solve_count


def _make_planner(
    context: DecisionContext,
    priority: tuple[bool, float, int],
    target: Float[Array, " n"],
    solution: SoloSolution,
    horizon: AvoidanceHorizon,
    path: Float[Array, "pieces 4 d"],
) -> Planner:
    return Planner(
        priority=priority,
        target_state=target,
        transfer=solution.transfer,
        horizon=horizon,
        solo=solution.trajectory,
        nominal=solution.trajectory,
        control_points=path,
        relinearize=make_relinearizer(context, solution.transfer),
    )


def _start_from_previous(
    planner: Planner, rest: Float[Array, "T m"] | None, tolerance: float
) -> Planner:
    """Begin with the previous plan, where it kept clear of an agent by another way."""
    if rest is None:
        return planner
    prior = planner.transfer.simulate(planner.solo.x[0], rest)
    if float(np.abs(prior.x - planner.solo.x).max()) <= tolerance:
        return planner
    path = planner.horizon.control_points(prior.x, prior.u)
    return planner._replace(nominal=prior, control_points=path, has_converged=False)


@lru_cache(maxsize=8)  # the same at every replanning of a mission
def _interpolation_margin(mission: Reconfiguration, h: float) -> float:
    # Error of the cubic pieces of two agents, at the states with which the mission begins and
    # ends and under full control; doubled for the states in between.
    ends = np.concatenate([mission.initial_states, *(leg.targets for leg in mission.legs)])
    x = np.stack([ends, ends], axis=1)
    u = np.full((len(ends), 1, mission.axes), mission.max_control)
    return 4 * interpolation_error(mission.linear_model, x, u, h)


def _relaxation_events(
    mission: Reconfiguration, planners: dict[int, Planner], unreachable: list[int]
) -> list[Event]:
    tolerance = FEASIBILITY_TOLERANCE * mission.collision_radius
    slack = {i: p.slack for i, p in planners.items() if p.slack > tolerance}
    failed = [i for i, p in planners.items() if p.has_failed]
    astray = {i for i, p in planners.items() if p.has_failed or _misses_target(mission, p)}
    braked = [i for i in planners if i in unreachable or i in astray]
    events: list[Event] = []
    if slack:
        events.append({"kind": "slack", "agents": list(slack), "amount_m": list(slack.values())})
    if braked:
        events.append({"kind": "braked", "agents": braked})
    if unreachable:
        what = "the target is out of reach in the time that is left"
        events.append({"kind": "infeasible", "agents": unreachable, "what": what})
    if failed:
        what = "no trajectory keeps clear of agents with priority"
        events.append({"kind": "infeasible", "agents": failed, "what": what})
    return events


def _misses_target(mission: Reconfiguration, planner: Planner) -> bool:
    d, error = mission.axes, np.abs(planner.nominal.x[-1] - planner.target_state)
    is_far = (error[:d] > mission.position_tolerance).any()
    is_fast = (error[d:] > mission.velocity_tolerance).any()
    return planner.terminal_error > 0 and bool(is_far or is_fast)
