"""Method 2 for all agents: exchange trajectories until all are final."""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from problems.obstacle_paths import is_path_clear
from problems.path_separation import are_paths_separated
from sato.network.graph import CommunicationGraph
from sato.network.load import Load
from sato.network.rounds import run_round
from sato.scp.planner import Planner, may_have_to_solve, update_planner


class ExchangeResult(NamedTuple):
    """Trajectories that are final."""

    planners: dict[int, Planner]
    round_count: int  # exchanges
    load: Load


def run_scp(planners: Mapping[int, Planner], graph: CommunicationGraph) -> ExchangeResult:
    """Exchange trajectories until those of all agents are final.

    Args:
        planners: Planner of each agent, by its number.
        graph: Communication graph.
    """
    history = [dict(planners), *run_batched(planners, graph)]
    return ExchangeResult(history[-1], len(history) - 1, _count_load(history, graph))


def _count_load(history: Sequence[Mapping[int, Planner]], graph: CommunicationGraph) -> Load:
    """Count the load of an exchange: D rounds after the last trajectory is final, all know it."""
    rounds = np.zeros(len(graph.alive), dtype=np.int64)
    for planners in history:
        rounds[[i for i, agent in planners.items() if not agent.is_final]] += 1
    return Load.of(list(history[0]), graph.component_max(rounds) + graph.diameter)


def run_batched(
    planners: Mapping[int, Planner], graph: CommunicationGraph
) -> Iterator[dict[int, Planner]]:
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
    i, j = graph.pairs_among(ids)
    lower, upper = np.where(rank[i] > rank[j], (i, j), (j, i))
    radius = (own[lower] + own[upper]) / 2
    paths = np.stack([agent.control_points for agent in now])
    conflicts = ~are_paths_separated(paths, lower, upper, radius)
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
        conflicts[changed] = ~are_paths_separated(
            paths, lower[changed], upper[changed], radius[changed]
        )
        yield dict(zip(ids, now, strict=True))
