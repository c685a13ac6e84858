"""Several orders of priority: agents that pay most come first the next time [Joslin1999].

Method 2 runs once, and then again under other orders. Each time the priority of an agent rises by
the fuel that it paid for others, and in the plane all that fly their solo trajectory begin offset
to the right: nominals that all meet in one point show no agent a way around. The trajectories that
all begin with are tried too, where they are clear. After each order agents flood their costs and
add them up for themselves, and every component keeps the cheapest of its trials.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from sato.network.graph import CommunicationGraph
from sato.network.rounds import run_round
from sato.scp.exchange import ConflictResolution, count_trajectories, run_scp
from sato.scp.planner import FEASIBILITY_TOLERANCE, Planner, Planners, TrajectoryMessage, is_clear


class PriorityCost(NamedTuple):
    """Cost of the other agents to one agent, in lexicographic order: separation comes first."""

    is_too_close: float  # 1 where it comes too close to another
    misses_target: float  # 1 where it does not end at its target
    extra_cost: float  # fuel [m/s] or energy [m²/s³] beyond that of its solo trajectory


def try_priority_orders(
    planners: Planners, graph: CommunicationGraph, orders: int
) -> ConflictResolution:
    """Run Method 2 under several orders of priority; each component keeps its cheapest.

    The first order is that of `priority`. There are fewer where no agent of a component has a
    cost.
    """
    kept, rounds, solves, load = run_scp(planners, graph)
    tried = kept
    if orders == 1 or not kept:
        return ConflictResolution(kept, rounds, solves, load)
    flooding = int(graph.diameter[list(kept)].max())
    rounds += flooding
    costs = component_costs(kept, graph)
    if any(map(any, costs.values())):
        kept = keep_cheaper(kept, select_clear_components(planners, graph), graph)
        rounds += 1 + flooding
        tell = {i: agent for i, agent in kept.items() if any(costs[i])}
        load = load.plus(count_trajectories(tell, graph, 1 + graph.diameter))
    for _ in range(orders - 1):
        costly = [i for i, total in component_costs(kept, graph).items() if any(total)]
        if not costly:
            break
        planners = {i: offset_right(raise_priority(planners[i], tried[i]), 1.0) for i in costly}
        tried, exchanges, programs, more = run_scp(planners, graph)
        rounds, solves, load = rounds + exchanges + flooding, solves + programs, load.plus(more)
        kept = keep_cheaper(kept, tried, graph)
    return ConflictResolution(kept, rounds, solves, load)


def compute_priority_cost(agent: Planner) -> PriorityCost:
    """Compute the cost of the others to one agent, from its own memory."""
    slack_limit = FEASIBILITY_TOLERANCE * agent.horizon.clearance
    return PriorityCost(
        float(agent.has_failed or agent.slack > slack_limit),
        float(not agent.reaches_target(agent.nominal)),
        agent.transfer.cost(agent.nominal) - agent.transfer.cost(agent.solo),
    )


def raise_priority(agent: Planner, tried: Planner) -> Planner:
    """Count the extra cost as spent, and where a constraint was relaxed that of `solo` as well."""
    (can_move, rank, agent_id), cost = agent.priority, compute_priority_cost(tried)
    is_relaxed = cost.is_too_close or cost.misses_target
    relaxed = agent.transfer.cost(agent.solo) if is_relaxed else 0.0
    return agent._replace(priority=(can_move, rank - max(cost.extra_cost, 0.0) - relaxed, agent_id))


def offset_right(agent: Planner, offset: float) -> Planner:
    """Bend the nominal of an agent in the plane to the right of its solo trajectory.

    Agents that begin with a previous plan keep it, and with it the side on which they pass. The
    offset is the largest displacement, halfway, over R; to the left where negative.
    """
    pieces, points, d = agent.control_points.shape
    way = agent.control_points[-1, -1] - agent.control_points[0, 0]
    if d != 2 or len(agent.nominal.u) == 0 or agent.nominal is not agent.solo or not way.any():
        return agent
    path = agent.horizon.control_points(agent.solo.x, agent.solo.u)
    right = np.array([way[1], -way[0]]) / np.linalg.norm(way)
    along = (np.arange(pieces)[:, None] + np.linspace(0, 1, points)) / pieces
    bend = offset * agent.horizon.clearance * np.sin(np.pi * along)
    return agent._replace(control_points=path + bend[..., None] * right, has_converged=False)


def select_clear_components(planners: Planners, graph: CommunicationGraph) -> dict[int, Planner]:
    """Keep the components in which all agents are clear of their neighbors, as they are."""
    messages = {i: agent.message for i, agent in planners.items()}
    marked = run_round(graph, planners, _mark_clear, messages)
    return select_components(marked, graph, lambda agent: not agent.has_failed)


def _mark_clear(agent: Planner, inbox: list[TrajectoryMessage]) -> Planner:
    has_failed = not is_clear(agent.control_points, inbox, agent.horizon.clearance)
    return agent._replace(is_final=True, has_converged=True, has_failed=has_failed)


def select_components(
    planners: Planners, graph: CommunicationGraph, predicate: Callable[[Planner], bool]
) -> dict[int, Planner]:
    """Keep the components in which a predicate is true of all agents.

    The batched equivalent of a flood of the predicate.
    """
    dropped = {graph.component[i] for i, agent in planners.items() if not predicate(agent)}
    return {i: agent for i, agent in planners.items() if graph.component[i] not in dropped}


def component_costs(planners: Planners, graph: CommunicationGraph) -> dict[int, PriorityCost]:
    """Add up the costs of all agents in each agent's component.

    The batched equivalent of a flood of `{number: cost}`, added in order of the numbers.
    """
    sums = np.zeros((len(graph.alive), len(PriorityCost._fields)))
    for i in sorted(planners):
        sums[graph.component[i]] += compute_priority_cost(planners[i])
    return {i: PriorityCost(*sums[graph.component[i]].tolist()) for i in planners}


def keep_cheaper(
    kept: dict[int, Planner], tried: dict[int, Planner], graph: CommunicationGraph
) -> dict[int, Planner]:
    """Keep the cheaper of two solutions in each component."""
    new, old = component_costs(tried, graph), component_costs(kept, graph)
    return kept | {i: agent for i, agent in tried.items() if new[i] < old[i]}
