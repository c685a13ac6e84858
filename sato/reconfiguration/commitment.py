"""Commitment: agents fly only what they have checked against each other, and can always stop.

Each agent flies a committed trajectory, which ends at rest. At every decision it offers others in
its place, the best first: the first steps of its plan, and a stop. Agents that hear each other
agree on offers that keep clear of each other in continuous time, to their ends and ever after; an
agent without one keeps what it has committed to. Such agents then take turns: each changes its
committed trajectory towards its plan as far as those of all its neighbors allow [Wabersich2021].

Later points of an offer are at most (R_comm − R)/2 from earlier ones, so that two agents that do
not hear each other cannot meet before they do. docs/safety.md has the proof.
"""

from collections.abc import Collection, Mapping
from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.trajectory_geometry import hull_distance
from problems import convexify
from problems.convexify import AvoidanceHorizon
from problems.obstacle_paths import is_path_clear
from problems.path_separation import are_hulls_separated, are_paths_separated
from sato.network.encoding import CHOICE, CHOICE_REPORT, PRIORITY, REAL
from sato.network.graph import CommunicationGraph, Pairs
from sato.network.load import Load, count_flood, count_messages, mark_changes
from sato.reconfiguration.evasion import (
    ROUNDING,
    find_evasions,
    is_met,
    list_looks,
    make_report,
    measure_report,
)
from sato.reconfiguration.offers import Offers, is_kept, make_offers, rest_at_target, steps_to_next
from sato.reconfiguration.plan import Plan, Plans
from sato.reconfiguration.state import DecisionContext
from sato.reconfiguration.stopping import (
    Avoided,
    Commitment,
    Commitments,
    find_stop,
    pad_controls,
    stays_within_reach,
    stopping_horizon,
)
from sato.scp.planner import FEASIBILITY_TOLERANCE, PASSING_SIDES

NOBODY = np.zeros(0, dtype=int)

# Rows of both of each pair, and the distance that the two keep [m].
KeptPairs = tuple[Int[Array, " pairs"], Int[Array, " pairs"], Float[Array, " pairs"]]


def choose_offers(
    offers: Offers,
    graph: CommunicationGraph,
    rank: Int[Array, " agents"],
    is_confirmed: bool = False,
) -> tuple[Int[Array, " agents"], Load]:
    """Let all agents agree on offers that are clear of each other; return their choices.

    All begin with their best. While two are not clear, the one that follows its plan for longer
    takes its next choice, or that of lower rank where both do as long. So at the end all are clear
    that were not committed already. With `is_confirmed`, one of higher rank also keeps clear of
    what one of lower rank has committed to, and may go on flying.
    The batched equivalent of `agent_stages.Choosing`.
    """
    i, j, radius = list_pairs(offers, graph)
    choice, last = offers.is_allowed.argmax(axis=1).astype(np.int64), offers.last
    changed, is_clear = np.arange(len(i)), np.ones(len(i), dtype=bool)
    history = [choice.copy()]
    first, second = np.where(rank[i] < rank[j], (i, j), (j, i))
    is_free, rows = np.ones(len(i), dtype=bool), np.arange(len(choice))
    if is_confirmed:
        held = offers.held_paths
        allowed = held_distances(held, (i, j, radius))
    while True:
        is_clear[changed] = are_clear(offers, choice, (i[changed], j[changed], radius[changed]))
        met = np.flatnonzero(~is_clear & (np.minimum(choice[i], choice[j]) < last))
        longer = choice[j[met]] - choice[i[met]]
        is_lower = np.where(longer == 0, rank[i[met]] > rank[j[met]], longer > 0)
        moved = np.unique(np.where(is_lower, i[met], j[met]))
        if is_confirmed:
            both = np.concatenate([offers.paths[rows, choice], held])
            others = first[changed], len(rows) + second[changed], allowed[changed]
            is_free[changed] = are_paths_separated(both, *others)
            blocked = first[~is_free & (choice[first] < last)]
            moved = np.union1d(moved, blocked)
        if not len(moved):
            return choice, _count_choosing(offers, graph, np.array(history))
        for a in moved:
            choice[a] = next_choice(offers.is_allowed[a], int(choice[a]))
        history.append(choice.copy())
        changed = np.flatnonzero(np.isin(i, moved) | np.isin(j, moved))


def _count_choosing(
    offers: Offers, graph: CommunicationGraph, history: Int[Array, "rounds agents"]
) -> Load:
    """Count the load of choices until all know that none changes, from those after each round."""
    is_new = np.ones(history.shape, dtype=bool)
    is_new[1:] = history[1:] != history[:-1]
    when, rows = np.nonzero(is_new)
    steps = offers.count_own_steps(rows, history[when, rows])
    payload, last = np.zeros((2, len(graph.alive)), dtype=np.int64)
    agents, d = offers.agents[rows], offers.paths[:1, 0].shape[-1]
    np.add.at(payload, agents, REAL * d * steps)
    np.maximum.at(last, agents, when)
    rounds = graph.component_max(last) + graph.diameter + 1
    speaks = mark_changes(graph, rounds, (agents, when), 0)
    speaks[offers.agents, 0] = True
    messages = count_messages(rounds, speaks)
    return Load.of(graph, offers.agents, rounds, (messages, payload + CHOICE * messages))


def list_pairs(offers: Offers, graph: CommunicationGraph) -> KeptPairs:
    """List pairs of agents that hear each other and could meet by some choice."""
    i, j = graph.pairs_among(offers.agents)
    radius = (offers.clearance[i] + offers.clearance[j]) / 2
    if offers.drifts is not None:  # they may meet far away
        return i, j, radius
    # Most pairs are too far apart.
    middle, extent = offers.enclose()
    near = np.linalg.norm(middle[i] - middle[j], axis=1) < extent[i] + extent[j] + radius
    return i[near], j[near], radius[near]


def are_clear(
    offers: Offers, choice: Int[Array, " agents"], pairs: KeptPairs
) -> Bool[Array, " pairs"]:
    """Find the pairs whose choices are clear of each other."""
    paths = offers.paths[np.arange(len(choice)), choice]
    clear = are_paths_separated(paths, *pairs)
    return clear if offers.drifts is None else clear & offers.drifts.are_safe(choice, *pairs[:2])


def held_distances(
    held: Float[Array, "agents pieces 4 d"], pairs: KeptPairs
) -> Float[Array, " pairs"]:
    """Return the distances to keep, or those that pairs keep by what they have committed to."""
    i, j, radius = pairs
    near, found = np.flatnonzero(~are_paths_separated(held, *pairs)), radius.copy()
    kept = hull_distance(held[i[near]] - held[j[near]])[0].min(axis=1, initial=np.inf)
    found[near] = np.minimum(radius[near], kept * (1 - ROUNDING))
    return found


def next_choice(is_allowed: Bool[Array, " choices"], choice: int) -> int:
    """Return the next offer that is allowed."""
    return choice + 1 + int(is_allowed[choice + 1 :].argmax())


class CommitmentChoice(NamedTuple):
    """Trajectories to which agents commit."""

    committed: Commitments
    plans: Plans  # without a target where they are not flown
    cautious: list[int]  # agents that could not commit to their plans
    load: Load
    # Pairs of neighbors in which the first commits only once it knows that the second does.
    waits: Pairs = (NOBODY, NOBODY)


def commit(context: DecisionContext, plans: Plans, committed: Commitments) -> CommitmentChoice:
    """Commit the agents that have planned to trajectories that they have checked.

    Where decisions take time, agents commit once all that they could meet have confirmed it.
    """
    if not plans:
        return CommitmentChoice({}, plans, [], Load.none(len(context.state)))
    is_confirmed = context.mission.lag_steps > 0
    offers = make_offers(context, plans, committed)
    rank = rank_of(offers, plans)
    choice, load = choose_offers(offers, context.graph, rank, is_confirmed)
    rows = np.arange(len(plans))
    u, paths = offers.u[rows, choice], offers.paths[rows, choice]
    adjacent = context.graph.adjacency[np.ix_(offers.agents, offers.agents)]
    component = context.graph.component[offers.agents]
    kept = {a for a, plan in enumerate(plans.values()) if is_kept(context, plan)}
    order = [a for a in np.argsort(rank).tolist() if a not in kept]
    cautious = [a for a in order if choice[a] == offers.last]
    flown = np.array(offers.plan_steps)[choice]
    held = offers.held_paths if is_confirmed else paths
    improved = dict[int, int]()  # steps of the controls
    for a in cautious:
        near, i = adjacent[a], int(offers.agents[a])
        T = int(offers.steps[component == component[a]].max())
        horizon = stopping_horizon(context.mission, T)
        pieces = len(horizon.fine_model)
        others, beside = paths[near, :pieces], offers.clearance[near]
        if is_confirmed:
            below = near & (rank > rank[a])
            others = np.concatenate([others, held[below, :pieces]])
            beside = np.concatenate([beside, offers.clearance[below]])
        clearance = (offers.clearance[a] + beside) / 2
        found = improve(context, i, plans[i], horizon, paths[a, :pieces], others, clearance)
        if found is not None:
            u[a, :T], paths[a, :pieces], flown[a] = found
            improved[a] = T
            paths[a, pieces:] = found[1][-1, -1]
    done = {i: Commitment(context.instant, u[a]) for a, i in enumerate(plans)}
    followed = {
        i: follow(context, plan, int(flown[a]), u[a]) for a, (i, plan) in enumerate(plans.items())
    }
    met = {
        c for a, c in enumerate(component.tolist()) if is_met(context, offers, a, int(choice[a]))
    }
    evaded, size = _list_evasions(context, plans, offers, u, paths, met)
    done |= {i: Commitment(context.instant, own) for i, own in evaded.items()}
    followed |= {i: leave(context, plans[i]) for i in evaded}
    left = {int(offers.agents[a]) for a in cautious if flown[a] == 0}.union(evaded)
    left = {i for i in left if leaves_plan(plans[i], followed[i])}
    waits = find_waits(offers, context.graph, paths) if is_confirmed else (NOBODY, NOBODY)
    load = load.plus(_count_turns(context.graph, offers, cautious, improved))
    made, rounds = np.where(size > 0, 0, -1), context.graph.diameter
    reports = count_flood(context.graph, np.where(size > 0, rounds, 0), made, size)
    load = load.plus(Load.of(context.graph, np.flatnonzero(size), rounds, reports))
    return CommitmentChoice(done, followed, sorted(left), load, waits)


def _count_turns(
    graph: CommunicationGraph, offers: Offers, cautious: list[int], improved: Mapping[int, int]
) -> Load:
    """Count the load of reports, and of the turns of cautious agents.

    Nobody hears what changes in the last turn.
    """
    d, size = offers.horizon.discrete_model.B.shape[-1], np.full(len(graph.alive), CHOICE_REPORT)
    made = np.full_like(size, -1)
    made[offers.agents], size[offers.agents[cautious]] = 0, CHOICE_REPORT + PRIORITY
    reports = count_flood(graph, graph.diameter, made, size)
    turns = np.bincount(graph.component[offers.agents[cautious]], minlength=len(size))
    messages, payload, had = np.zeros((3, len(size)), dtype=np.int64)
    for a in cautious:
        i = int(offers.agents[a])
        c = graph.component[i]
        had[c] += 1
        if a in improved and had[c] < turns[c]:
            messages[i], payload[i] = 1, REAL * d * improved[a]
    rounds = graph.diameter + turns[graph.component]
    return Load.of(graph, offers.agents, rounds, reports, (messages, payload))


def find_waits(
    offers: Offers, graph: CommunicationGraph, paths: Float[Array, "agents pieces 4 d"]
) -> Pairs:
    """Find the agents whose new trajectories are not clear of what a neighbor has committed to."""
    i, j = graph.pairs_among(offers.agents)
    i, j, held = np.append(i, j), np.append(j, i), offers.held_paths
    radius = held_distances(held, (i, j, (offers.clearance[i] + offers.clearance[j]) / 2))
    meets = ~are_paths_separated(np.concatenate([paths, held]), i, len(paths) + j, radius)
    return offers.agents[i[meets]], offers.agents[j[meets]]


def _list_evasions(
    context: DecisionContext,
    plans: Plans,
    offers: Offers,
    u: Float[Array, "agents T m"],
    paths: Float[Array, "agents pieces 4 d"],
    met: Collection[int],
) -> tuple[dict[int, Float[Array, "_ m"]], Int[Array, " all"]]:
    """List new controls in the components in which something came over what an agent chose.

    With the bytes of all reports.
    """
    sizes = np.zeros(len(context.state), dtype=np.int64)
    mission, component = context.mission, context.graph.component[offers.agents]
    found: dict[int, Array] = {}
    for c in sorted(met):
        rows = np.flatnonzero(component == c)
        horizon = stopping_horizon(mission, int(offers.steps[rows].max()))
        T, pieces, reports = horizon.steps, len(horizon.fine_model), []
        for a in rows:
            i, kept = int(offers.agents[a]), float(offers.clearance[a])
            own = i, plans[i].priority, horizon, u[a, :T], paths[a, :pieces].copy(), kept
            reports.append(make_report(context, *own))
            sizes[i] = measure_report(reports[-1])
        after = find_evasions(mission, horizon, reports)
        for a, i in zip(rows, offers.agents[rows].tolist(), strict=True):
            if i in after:
                found[i], paths[a, :pieces] = after[i].u, after[i].path
                paths[a, pieces:] = after[i].path[-1, -1]
    return found, sizes


def rank_of(offers: Offers, plans: Plans) -> Int[Array, " agents"]:
    """Return the place of each agent in the order of their priorities."""
    order = sorted(range(len(plans)), key=lambda a: plans[int(offers.agents[a])].priority)
    return np.argsort(order)


def leaves_plan(plan: Plan, followed: Plan | None = None) -> bool:
    """Tell whether an agent that could not commit to its plan leaves one that has steps.

    One that is over has none; what it follows instead may leave the target.
    """
    is_away = followed is not None and followed.target_index != plan.target_index
    return len(plan.trajectory.u) > 0 or is_away


def follow(context: DecisionContext, plan: Plan, steps: int, u: Float[Array, "T m"]) -> Plan:
    """Return a plan of which so many steps are flown; without a target if it is left too early.

    The controls u are all that the agent has committed to.
    """
    if is_kept(context, plan):
        return plan
    least = min(steps_to_next(context), len(plan.trajectory.u))
    if steps < least or is_kept_away(context, plan, u):
        return leave(context, plan)
    return plan._replace(clear_until=plan.planned_at + steps)


def leave(context: DecisionContext, plan: Plan) -> Plan:
    """Return a plan that is not flown."""
    failures = plan.failure_count + context.mission.keeps_plans
    return plan._replace(target_index=None, failure_count=failures)


def is_kept_away(context: DecisionContext, plan: Plan, u: Float[Array, "T m"]) -> bool:
    """Tell whether an agent whose time is over is not at its target, or makes way for something."""
    if context.surroundings is None or plan.target_index is None or len(plan.trajectory.u):
        return False
    d, target = context.mission.axes, context.leg.targets[plan.target_index]
    away = float(np.abs(plan.trajectory.x[-1, :d] - target[:d]).max())
    return away > FEASIBILITY_TOLERANCE * context.mission.least_separation or bool(u.any())


def improve(
    context: DecisionContext,
    agent: int,
    plan: Plan,
    horizon: AvoidanceHorizon,
    path: Float[Array, "pieces 4 d"],
    others: Float[Array, "others pieces 4 d"],
    clearance: Float[Array, " others"],
) -> tuple[Float[Array, "T m"], Float[Array, "pieces 4 d"], int] | None:
    """Change a committed trajectory towards the agent's plan, or to a stop later on it.

    From a neighbor that it is too near to, as noise may have it, the change keeps what it had.

    Args:
        context: State of the agent, and its solver.
        agent: Number of the agent.
        plan: Its plan.
        horizon: Horizon in which all have come to rest.
        path: Control points of its committed trajectory.
        others: Control points of those of its neighbors.
        clearance: Distance to keep from each [m].

    Returns:
        Controls, control points, and the steps for which these follow the plan; None where none
        are found that are safe.
    """
    kept = hull_distance(path - others)[0].min(axis=1)
    clearance = np.minimum(clearance, kept * (1 - ROUNDING))
    period, d = steps_to_next(context), context.mission.axes
    for n, (rest_steps, obstacles) in enumerate(list_looks(context, agent, horizon, path)):
        is_clear = is_path_clear(path, obstacles)
        if n and is_clear:
            return None
        avoided = Avoided(others, clearance, obstacles, rest_steps)
        # Where something comes an agent's way, it may pass on all sides.
        for k, side in product((period, 0), PASSING_SIDES[d][: 1 if is_clear else None]):
            u = _find_stop_after(context, agent, plan, k, horizon, path, avoided, side)
            if u is None:
                continue
            x = horizon.discrete_model.simulate(context.state[agent], u)
            points = horizon.control_points(x, u)
            is_clear = bool(are_hulls_separated(points - others, clearance).all())
            is_clear = is_clear and is_path_clear(points, obstacles)
            if is_clear and stays_within_reach(context.mission, horizon, x, points):
                return u, points, min(k, len(plan.trajectory.u))
    return None


def _find_stop_after(
    context: DecisionContext,
    agent: int,
    plan: Plan,
    k: int,
    horizon: AvoidanceHorizon,
    path: Float[Array, "pieces 4 d"],
    avoided: Avoided,
    side: convexify.PassingSide,
) -> Float[Array, "T m"] | None:
    """Find controls that follow the plan for k steps, and then stop near it."""
    mission, period = context.mission, steps_to_next(context)
    others, clearance, obstacles, rest_steps = avoided
    own, x = mission.planned_control_limit(agent).cut(plan.trajectory.u), plan.trajectory.x
    wanted, start = x[min(k + period, len(own))], context.state[agent]
    if not len(own):  # back to the target
        wanted, period = rest_at_target(context, agent), mission.horizon_steps
    if k:
        left = horizon.steps - k
        if left < 2 or len(own) <= k:
            return None
        start, horizon = x[k], stopping_horizon(mission, left)
        (rest,) = pad_controls([own[k : k + left]], left)
        path = horizon.control_points(horizon.discrete_model.simulate(start, rest), rest)
        others = others[:, k * horizon.pieces_per_step :]
        if obstacles is not None:
            obstacles = obstacles.after_pieces(k * horizon.pieces_per_step)
    aim = agent, start, wanted, min(period, max(horizon.steps - 1 - rest_steps, 1))
    avoided = Avoided(others, clearance, obstacles, rest_steps)
    found = find_stop(mission, horizon, *aim, path, avoided, context.solver_of(agent), side)
    return None if found is None else np.vstack([own[:k], found[0]])
