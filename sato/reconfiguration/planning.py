"""Planning of trajectories: each agent alone, then conflict resolution among neighbors."""

from collections.abc import Sequence
from functools import lru_cache, partial
from math import ceil, inf, isfinite

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from dynamics.trajectory_geometry import interpolation_error
from problems.convexify import AvoidanceHorizon
from problems.obstacle_paths import is_path_clear
from sato.network.load import Load
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.passive_safety import begin_passively_safe
from sato.reconfiguration.plan import Plan, Plans, is_held, remaining_controls
from sato.reconfiguration.solo_trajectories import relinearize, solve_solo_trajectories
from sato.reconfiguration.state import DecisionContext, Event
from sato.scp import CONVERGENCE_TOLERANCE, FEASIBILITY_TOLERANCE, Planner, resolve_conflicts
from sato.scp.halfway import meet_halfway
from sato.scp.routes import go_around

MAX_PIECES = 12  # of the trajectory within a step


def plan_trajectories(
    context: DecisionContext,
    spent: Float[Array, " agents"],
    previous: Plans,
    solve_count: int = 0,
    clocks: Int[Array, " agents"] | None = None,
) -> tuple[Plans, list[Event], Load]:
    """Plan for every agent that decides: alone first, then clear of the others.

    With the plans come events, and the load of messages. The agent that has spent less fuel or
    energy gives way. Some programs may have been solved for this replanning already. The clocks are
    those before they decided, of the memory by default.
    """
    mission, graph = context.mission, context.graph
    if mission.is_passively_safe:
        graph = graph.relayed
    heard = -graph.component_max(-(context.memory.clock if clocks is None else clocks))
    planners, unreachable, solo_count = plan_alone(context, spent, previous, heard)
    solve_count, rounds, resolved = solve_count + solo_count, 0, dict[int, Planner]()
    load = Load.none(len(graph.alive))
    for steps in sorted({planner.horizon.steps for planner in planners.values()}):
        alike = {i: planner for i, planner in planners.items() if planner.horizon.steps == steps}
        bends = 0
        if mission.keeps_plans:
            alike, bends, meeting = meet_halfway(alike, graph)
            load = load.plus(meeting)
        found = resolve_conflicts(alike, graph, mission.orders, mission.bargains)
        solve_count, rounds = solve_count + found.solve_count, max(rounds, bends, found.round_count)
        resolved |= found.planners
        load = load.plus(found.load)
    replan = {"solves": solve_count, "exchanges": rounds}
    N = len(mission.initial_states)
    hears_all = bool(graph.adjacency.sum() == N * (N - 1))
    plans, relaxed = make_plans(context, resolved, unreachable, previous, hears_all)
    if mission.is_passively_safe:  # others pass on each message
        load = load.relayed(context.graph.diameter)
    return plans, [{"kind": "replan", "agents": [], **replan}, *relaxed], load


def make_plans(
    context: DecisionContext,
    planners: dict[int, Planner],
    unreachable: Sequence[int],
    previous: Plans,
    hears_all: bool,
) -> tuple[Plans, list[Event]]:
    """Make plans of trajectories that are final, and list the constraints that were relaxed.

    `hears_all` is True where all agents of the mission hear each other, without a relay.
    """
    mission, k, target = context.mission, context.step_index, context.memory.target_index
    events = _list_relaxations(mission, planners, unreachable)
    relaxed = {i for event in events for i in event["agents"]}
    # An agent that comes too close to another may still arrive.
    astray = {i for event in events if event["kind"] != "slack" for i in event["agents"]}
    plans, has_one_order = {}, mission.orders == 1 and not mission.bargains
    for i, planner in planners.items():
        if is_held(context, previous, i):
            plans[i] = previous[i]
            continue
        # Agents out of hearing are too far to meet within T_H alone (Proposition 9).
        clear = planner.horizon.steps if hears_all else mission.horizon_steps
        failures = _count_failures(previous, i) + (i in relaxed)
        held = None if i in astray else int(target[i])
        own = planner.nominal, held, k, k + clear, failures, planner.priority
        plans[i] = Plan(*own, has_one_order and planner.is_clear)
    if mission.commits:  # a trajectory for which separation was relaxed is not flown
        events = [event for event in events if event["kind"] == "braked"]
    return plans, events


def _list_relaxations(
    mission: Reconfiguration, planners: dict[int, Planner], unreachable: Sequence[int]
) -> list[Event]:
    """List the agents for which constraints were relaxed, or whose targets are out of reach."""
    tolerance = FEASIBILITY_TOLERANCE * mission.least_separation
    slack = {i: p.slack for i, p in planners.items() if p.slack > tolerance}
    failed = [i for i, p in planners.items() if p.has_failed]
    missing = [i for i, p in planners.items() if _misses_target(mission, p)]
    astray = {*unreachable, *failed, *missing}
    beyond = "the target is out of reach in the time that is left"
    blocked = "no trajectory keeps clear of agents with priority"
    events: list[Event] = [
        {"kind": "slack", "agents": list(slack), "amount_m": list(slack.values())},
        {"kind": "braked", "agents": [i for i in planners if i in astray]},
        {"kind": "infeasible", "agents": [*unreachable], "what": beyond},
        {"kind": "infeasible", "agents": failed, "what": blocked},
    ]
    return [event for event in events if event["agents"]]


def _misses_target(mission: Reconfiguration, planner: Planner) -> bool:
    d, error = mission.axes, np.abs(planner.nominal.x[-1] - planner.target_state)
    is_far = (error[:d] > mission.position_tolerance).any()
    is_fast = (error[d:] > mission.velocity_tolerance).any()
    # A plan of no steps, made after the deadline, leads nowhere, and none was solved for.
    is_inexact = planner.terminal_error > 0 or len(planner.nominal.u) == 0
    return is_inexact and bool(is_far or is_fast)


def make_horizon(
    mission: Reconfiguration, time: float, steps_left: int, leg: Leg | None = None
) -> AvoidanceHorizon:
    """Build the avoidance horizon at a time, with so many steps of the leg left.

    It has T_H steps, or as many as are foreseen among agents within hearing, but does not pass
    the end of the leg for the last of these.
    """
    T = max(mission.horizon_steps, min(mission.foresight, steps_left))
    return divide_horizon(mission, time, T, leg)


def divide_horizon(
    mission: Reconfiguration, time: float, T: int, leg: Leg | None = None
) -> AvoidanceHorizon:
    """Divide the steps of a horizon so finely that two agents move by about R_col in a piece."""
    S, margin = 1, mission.margin
    if not mission.printed:
        fastest = float(mission.top_speeds.max())
        speed = fastest if isfinite(fastest) else 0.0
        S = min(MAX_PIECES, max(1, ceil(2 * speed * mission.step / mission.least_separation)))
        margin += _interpolation_margin(mission, leg or mission.legs[0], mission.step / S)
    return AvoidanceHorizon(
        mission.discretize(T, time),
        discretize_zoh(mission.linear_model, mission.step / S, T * S, time),
        mission.largest_separation + margin,
        mission.separation_scale,
        samples_only=mission.printed,
    )


def plan_alone(
    context: DecisionContext,
    spent: Float[Array, " agents"],
    previous: Plans,
    heard_clock: Int[Array, " agents"],
) -> tuple[dict[int, Planner], list[int], int]:
    """Plan for every agent that decides as if it were alone.

    `heard_clock` is the clock with the most time left in each agent's component, as it was
    announced. With the planners come agents whose targets are out of reach, and the number of
    programs solved.
    """
    mission, leg, memory = context.mission, context.leg, context.memory
    is_nonlinear = mission.nonlinear_model is not None
    # Given targets need no agreement: others hear of a reset at the next replan.
    is_given = mission.assignment == "given"
    is_fresh = mission.keeps_plans or mission.is_passively_safe or mission.printed
    first_clock = heard_clock if is_given else np.minimum(heard_clock, memory.clock)
    ahead = np.minimum(leg.steps - first_clock, mission.foresight)
    ahead = np.maximum(ahead, mission.horizon_steps)
    horizons = {
        T: make_horizon(mission, context.time, T, leg)
        for T in set(ahead[context.graph.alive].tolist())
    }
    each_agent = np.arange(len(memory.clock))
    kept = {T: mission.own_clearances(own.clearance, each_agent) for T, own in horizons.items()}
    planners: dict[int, Planner] = {}
    unreachable: list[int] = []
    solve_count, around = 0, context.surroundings
    flown = {T: around.fly(mission, own) for T, own in horizons.items()} if around else {}
    # The first agent may have given way by little in a negotiation, and others count on it.
    relative = FEASIBILITY_TOLERANCE if mission.bargains else CONVERGENCE_TOLERANCE
    for clock, group in context.group_agents():
        agents, model = group.tolist(), context.remaining_model(clock)
        rests = [remaining_controls(context, previous, i) for i in agents]
        transfers, solos, stranded, count = solve_solo_trajectories(context, model, agents, rests)
        unreachable += stranded
        solve_count += count
        x, u = (np.stack(part) for part in zip(*(solo[:2] for solo in solos), strict=True))
        paths = {T: own.control_points(x, u) for T, own in horizons.items()}
        each = zip(agents, transfers, solos, rests, strict=True)
        for row, (i, transfer, solo, rest) in enumerate(each):
            steps = int(ahead[i])
            clearance = horizons[steps].clearance
            obstacles = around and around.known_to(mission, i, flown[steps], clearance)
            planner = Planner(
                priority=(_priority_class(context, i, previous), -float(spent[i]), i),
                target_state=leg.targets[memory.target_index[i]],
                transfer=transfer,
                solver=context.solver_of(i),
                horizon=horizons[steps].with_clearance(float(kept[steps][i])),
                solo=solo,
                nominal=solo,
                control_points=paths[steps][row],
                relinearize=partial(relinearize, context, transfer) if is_nonlinear else None,
                has_plan=mission.keeps_plans and rest is not None,
                is_delayed=rest is None and _count_failures(previous, i) > 0,
                in_turn=mission.keeps_plans,
                obstacles=obstacles,
            )
            if obstacles is not None and rest is None:
                planner = go_around(planner)
            if rest is not None and not is_fresh:
                # Begin with the previous plan, where it kept clear of an agent by another way.
                prior = transfer.simulate(solo.x[0], rest)
                if np.abs(prior.x - solo.x).max() > relative * clearance:
                    planner = planner.with_nominal(prior)._replace(has_converged=False)
            planners[i] = planner
    if mission.is_passively_safe:
        clocks = np.minimum(heard_clock, memory.clock)
        planners = begin_passively_safe(context, planners, previous, clocks)
    return planners, unreachable, solve_count


def _priority_class(context: DecisionContext, i: int, previous: Plans) -> float:
    # Among agents of equal priority, those first that others have kept from their targets.
    mission, is_over = context.mission, context.memory.clock[i] == context.leg.steps
    if is_over or is_held(context, previous, i):
        return -inf
    failures = 0 if mission.printed else _count_failures(previous, i)
    given = 0.0 if mission.priority is None else mission.priority[i]
    return -given - failures / (failures + 1)


def _count_failures(previous: Plans, i: int) -> int:
    return previous[i].failure_count if i in previous else 0


def give_up_closed(context: DecisionContext, plans: Plans, seen_by: list[int]) -> Plans:
    """Give up plans that are closed by what agents have seen only now, or that comes over rest.

    Those in `seen_by` have seen something new.
    """
    mission, around = context.mission, context.surroundings
    found, k = dict(plans), context.step_index
    if around is None:
        return found
    for i in np.flatnonzero(context.graph.alive).tolist():
        plan = plans.get(i)
        if plan is None or plan.target_index is None:
            continue
        u, escape = plan.controls_from(k), around.escape_steps(mission, i)
        has_arrived = mission.is_point_mass and escape > 0 and not len(u)
        if not (has_arrived or i in seen_by):
            continue
        horizon = divide_horizon(mission, context.time, len(u) + max(1, escape))
        x = plan.trajectory.x[k - plan.planned_at :]
        if has_arrived:
            x = np.append(context.state[i, : mission.axes], np.zeros(mission.axes))[None]
        elif not len(u):
            x = context.state[i][None]
        if not is_path_clear(horizon.control_points(x, u), context.known_obstacles(i, horizon)):
            found[i] = plan._replace(target_index=None)
    return found


@lru_cache(maxsize=8)  # the same at every replanning of a mission
def _interpolation_margin(mission: Reconfiguration, own: Leg, h: float) -> float:
    # Error of the cubic pieces of two agents, at the states with which the mission begins and
    # ends and under full control; doubled for the states in between.
    ends = np.concatenate([mission.initial_states, *[leg.targets for leg in (*mission.legs, own)]])
    u = np.broadcast_to(mission.largest_control, (len(ends), 1, mission.axes))
    return 4 * interpolation_error(mission.linear_model, np.stack([ends, ends], axis=1), u, h)
