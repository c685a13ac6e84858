"""Meeting halfway: agents in conflict give way at once, and share what it costs.

By priority the first flies straight and the last goes around all, if it can. Where many pass
through one place, all give way instead. In rounds of messages, paths to dense groups of targets
spread out, and paths that come too close push each other aside, those that meet head-on to their
right. Then each agent looks for the trajectory of least cost on its side of the planes halfway
between its path and those of all others. All do so at once: two that keep to their sides keep the
distance. An agent that finds none takes the one that enters the others' sides by least, and in the
next round these make room for it.

An agent gives way alone to those of a higher class of priority, and to none of a lower one.
"""

from collections.abc import Callable, Sequence
from itertools import pairwise

import numpy as np

from problems.avoidance import Relaxation
from problems.path_separation import are_paths_separated
from sato.network.encoding import FIRST_PATH, LAST_CHANGE, REAL, measure_shift
from sato.network.graph import CommunicationGraph
from sato.network.load import Load, count_messages, mark_changes
from sato.network.rounds import run_round
from sato.scp.bending import bend_all, can_move, stack_paths
from sato.scp.exchange import measure_changes
from sato.scp.planner import VIOLATION_TOLERANCE, Planner, Planners, TrajectoryMessage, solve_around
from sato.scp.spreading import spread_all

MAX_BENDS = 40  # rounds in which paths push each other aside
MEETINGS = 6  # rounds in which trajectories are solved for
IMPROVEMENTS = 4  # programs of an agent, after which it acts only where it has to
IMPROVEMENTS_OF_PLAN = 1  # the same of one that begins with a plan
RELAXATIONS: tuple[Relaxation, ...] = ("none", "half-spaces")


Update = Callable[[dict[int, Planner], CommunicationGraph], dict[int, Planner]]


def meet_halfway(
    planners: Planners, graph: CommunicationGraph
) -> tuple[dict[int, Planner], int, Load]:
    """Let all agents bend their paths and solve for trajectories; count rounds with a change.

    The batched equivalent of `halfway_stages`: agents that have nothing to change are left out.
    All horizons have equal steps.
    """
    spread = [dict(planners), spread_all(dict(planners), graph)]
    bends = _repeat(MAX_BENDS, bend_all, spread[-1], graph)
    meetings = _repeat(MEETINGS, _solve_all, bends[-1], graph)
    done = {i: come_after(agent) for i, agent in meetings[-1].items()}
    count = 1 + min(len(bends), MAX_BENDS) + min(len(meetings), MEETINGS)
    load = _count_bending([*spread, *bends[1:]], graph).plus(_count_meetings(meetings, graph))
    return done, count, load


def _repeat(
    most: int, update: Update, now: dict[int, Planner], graph: CommunicationGraph
) -> list[dict[int, Planner]]:
    """Repeat a round of messages until it changes nothing; return the planners after each."""
    history = [now]
    for _ in range(most):
        updated = update(now, graph)
        if all(updated[i] is now[i] for i in updated):
            break
        now = now | updated
        history.append(now)
    return history


def _count_bending(history: Sequence[Planners], graph: CommunicationGraph) -> Load:
    """Count the load of paths that bend until all know that none moves."""
    first, payload = history[0], np.zeros(len(graph.alive), dtype=np.int64)
    for i, agent in first.items():
        payload[i] = FIRST_PATH + REAL * (agent.control_points.shape[-1] + agent.number_count)
    moves = list[tuple[int, int]]()
    for round, (before, after) in enumerate(pairwise(history), 1):
        for i in [i for i, agent in after.items() if agent is not before[i]]:
            was, now = (planners[i].control_points[:, 0] for planners in (before, after))
            payload[i] += measure_shift(was, now, after[i].horizon.clearance)
            moves.append((i, round))
    agents, when = np.array(moves, dtype=np.int64).reshape(-1, 2).T
    last = np.ones_like(payload)  # paths spread in the first round
    np.maximum.at(last, agents, when)
    rounds = graph.component_max(last) + graph.diameter + 1
    speaks = mark_changes(graph, rounds, (agents, when), 1)
    speaks[list(first), 0] = True
    speaks[agents[when == 1], 1] = True
    messages = count_messages(rounds, speaks)
    return Load.of(graph, list(first), rounds, (messages, payload + LAST_CHANGE * messages))


def _count_meetings(history: Sequence[Planners], graph: CommunicationGraph) -> Load:
    """Count the load of trajectories that change; the exchange begins with the last."""
    messages, payload = np.zeros((2, len(graph.alive)), dtype=np.int64)
    for round, pair in enumerate(pairwise(history), 1):
        for i, size in measure_changes(*pair).items():
            payload[i] += size
            messages[i] += round < MEETINGS
    rounds = np.full_like(messages, MEETINGS)
    return Load.of(graph, list(history[0]), rounds, (messages, payload))


def _solve_all(now: dict[int, Planner], graph: CommunicationGraph) -> dict[int, Planner]:
    ids, paths, own = stack_paths(now)
    rank = np.array([now[i].priority[0] for i in ids])
    i, j = graph.pairs_among(np.array(ids, dtype=int))
    meets = ~are_paths_separated(paths, i, j, (own[i] + own[j]) / 2)
    i, j = i[meets], j[meets]
    acts = np.array([_improves(own) or not own.keeps_clear([]) for own in now.values()])
    acts[i[rank[j] <= rank[i]]] = acts[j[rank[i] <= rank[j]]] = True
    messages = {k: agent.message for k, agent in now.items()}
    acting = {k: now[k] for k, is_acting in zip(ids, acts, strict=True) if is_acting}
    return run_round(graph, acting, solve_halfway, messages)


def solve_halfway(agent: Planner, inbox: Sequence[TrajectoryMessage]) -> Planner:
    """Solve for the trajectory on the agent's side of the planes halfway to all others.

    Where there is none, it solves for the one that passes them by least, and the others make room
    in the next round.
    """
    nominal, R = agent.control_points, agent.horizon.clearance
    inbox = [other for other in inbox if other.priority[0] <= agent.priority[0]]
    if not can_move(agent) or not (inbox or agent.obstacles):
        return agent
    if not _improves(agent) and agent.keeps_clear(inbox):
        return agent
    middles = [
        other._replace(
            control_points=(other.control_points + nominal) / 2, clearance=(other.clearance - R) / 2
        )
        if other.priority[0] == agent.priority[0]
        else other
        for other in inbox
    ]
    # One that found none in the last round is likely to find none.
    least = VIOLATION_TOLERANCE * R
    for relaxation in RELAXATIONS[1:] if agent.slack > least else RELAXATIONS:
        agent = agent._replace(solve_count=agent.solve_count + 1)
        result = solve_around(agent, middles, nominal, "same", relaxation)
        if result is not None:
            return agent.with_result(result)._replace(has_converged=result.slack <= least)
    return agent


def _improves(agent: Planner) -> bool:
    # Its path was pushed aside, or what it has found may still become better.
    most = IMPROVEMENTS_OF_PLAN if agent.has_plan else IMPROVEMENTS
    return not agent.has_converged or 0 < agent.solve_count < most


def come_after(agent: Planner) -> Planner:
    """Return an agent that has found no trajectory with a lower priority than those that have."""
    if agent.has_converged or not can_move(agent):
        return agent
    rank, spent, number = agent.priority
    return agent._replace(priority=(rank + 1.0, spent, number))
