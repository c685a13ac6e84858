"""Method 2 for all agents: exchange trajectories until all are final."""

from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Int
from numpy import ndarray as Array

from problems.obstacle_paths import is_path_clear
from problems.path_separation import are_paths_separated
from sato.network.encoding import CLEARANCE, EXCHANGE_REPORT, FLAG, PRIORITY, REAL, has_moved
from sato.network.graph import CommunicationGraph
from sato.network.load import Load, count_flood
from sato.network.rounds import run_round
from sato.scp.planner import Planner, Planners, may_have_to_solve, update_planner


class ConflictResolution(NamedTuple):
    """Trajectories that agents agreed on, and the effort it took."""

    planners: dict[int, Planner]
    round_count: int  # rounds of messages, floods included
    solve_count: int  # programs
    load: Load


def run_scp(planners: Planners, graph: CommunicationGraph) -> ConflictResolution:
    """Exchange trajectories until those of all agents are final."""
    history = [dict(planners), *run_batched(planners, graph)]
    effort = len(history) - 1, count_solves(history[-1]), _count_load(history, graph)
    return ConflictResolution(history[-1], *effort)


def count_solves(planners: Planners) -> int:
    """Count the programs that all agents solved."""
    return sum(agent.solve_count for agent in planners.values())


def _count_load(history: Sequence[Planners], graph: CommunicationGraph) -> Load:
    """Count the load of an exchange: D rounds after the last trajectory is final, all know it.

    Those that have met know the trajectories with which the exchange begins.
    """
    made, payload = np.full(len(graph.alive), -1), np.zeros(len(graph.alive), int)
    speaks = np.zeros((len(made), len(history) + int(graph.diameter.max(initial=0))), dtype=bool)
    for i, agent in history[0].items():
        known = 0 if agent.in_turn else CLEARANCE + REAL * agent.number_count
        payload[i], speaks[i, 0] = PRIORITY + known, True
    for round, (before, after) in enumerate(pairwise(history), 1):
        made[[i for i, agent in after.items() if agent.is_final and not before[i].is_final]] = round
        for i, size in measure_changes(before, after).items():
            speaks[i, round] = True
            payload[i] += size
    rounds = graph.component_max(made) + graph.diameter
    messages, reports = count_flood(graph, rounds, made, EXCHANGE_REPORT, speaks)
    payload += reports + FLAG * messages
    return Load.of(graph, list(history[0]), rounds, (messages, payload))


def count_trajectories(
    planners: Planners, graph: CommunicationGraph, rounds: Int[Array, " agents"]
) -> Load:
    """Estimate from above the load of rounds in which an agent tells no more than a trajectory."""
    size = np.zeros(len(graph.alive), dtype=np.int64)
    for i, agent in planners.items():
        size[i] = FLAG + PRIORITY + CLEARANCE + REAL * agent.number_count
    return Load.of(graph, list(planners), rounds, (rounds, rounds * size))


def measure_changes(before: Planners, after: Planners) -> dict[int, int]:
    """Return the bytes of the trajectories that have changed, by the numbers of the agents."""
    return {
        i: REAL * agent.number_count
        for i, agent in after.items()
        if agent.control_points is not before[i].control_points
        and has_moved(agent.control_points, before[i].control_points, agent.horizon.clearance).any()
    }


def run_batched(planners: Planners, graph: CommunicationGraph) -> Iterator[dict[int, Planner]]:
    """Let all agents update their planners in rounds, with the geometry of all at once.

    Separations are computed only where trajectories changed. Exchanges in which an agent has
    nothing to solve only carry whether its trajectory is final.
    """
    ids = sorted(planners)
    now = [planners[i] for i in ids]
    if not now:
        return
    own = np.array([agent.horizon.clearance for agent in now])
    rank = np.argsort(sorted(range(len(now)), key=lambda k: now[k].priority))
    i, j = graph.pairs_among(np.array(ids))
    lower, upper = np.where(rank[i] > rank[j], (i, j), (j, i))
    pairs = lower, upper, (own[lower] + own[upper]) / 2
    paths = np.stack([agent.control_points for agent in now])
    conflicts = ~are_paths_separated(paths, *pairs)
    final = np.zeros(len(now), dtype=bool)
    has_deviated = np.array([may_have_to_solve(agent) for agent in now])
    meets = np.array([not is_path_clear(agent.control_points, agent.obstacles) for agent in now])
    in_turn = np.array([agent.in_turn for agent in now])
    while not final.all():
        in_conflict = meets.copy()
        in_conflict[lower[conflicts]] = True
        waits = np.zeros(len(now), dtype=bool)
        waits[lower[~final[upper]]] = True
        acts = ~final & (in_conflict | has_deviated) & ~(in_turn & waits)
        acting = np.flatnonzero(acts).tolist()
        messages = {i: agent.message for i, agent in zip(ids, now, strict=True)} if acting else {}
        updated = run_round(graph, {ids[k]: now[k] for k in acting}, update_planner, messages)
        final = final | (~acts & ~waits)
        for k in np.flatnonzero(final).tolist():
            if not now[k].is_final:
                now[k] = now[k]._replace(is_final=True)
        moved = np.zeros(len(now), dtype=bool)
        for k in acting:
            after = updated[ids[k]]
            moved[k] = after.control_points is not now[k].control_points
            now[k], final[k], paths[k] = after, after.is_final, after.control_points
            has_deviated[k] = may_have_to_solve(after)
            meets[k] = not is_path_clear(after.control_points, after.obstacles)
        changed = moved[lower] | moved[upper]
        conflicts[changed] = ~are_paths_separated(paths, *(part[changed] for part in pairs))
        yield dict(zip(ids, now, strict=True))
