"""Several orders of priority: who paid most goes first the next time [Joslin1999].

Method 2 is settled once, and then anew under other orders. Each time an agent goes before
others by as much more as it paid for them, and in the plane all who fly straight begin by
keeping to the right, as on a road: nominals that all meet in one point show nobody a way round.
To go on as each begins is tried too, where that is clear. After each order agents flood what
they pay and add up for themselves, and every network keeps the cheapest of what it has tried.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from sato.network.graph import CommunicationGraph, run_round
from sato.scp.exchange import run_scp
from sato.scp.planner import FEASIBILITY_TOLERANCE, Planner, TrajectoryMessage, is_clear


class PriorityCost(NamedTuple):
    """What an agent pays for others; the smaller is better, a distance before an arrival."""

    is_too_close: float  # 1 where it comes too close to somebody
    misses_target: float  # 1 where it does not end at its goal
    extra_fuel: float  # beyond that of its flight alone [m/s]


class ConflictResolution(NamedTuple):
    """What agents agreed on, and what that took."""

    planners: dict[int, Planner]
    round_count: int  # of all orders, with what is flooded
    solve_count: int


def try_priority_orders(
    planners: Mapping[int, Planner], network: CommunicationGraph, orders: int
) -> ConflictResolution:
    """Settle under several orders of priority; each component keeps its cheapest.

    Args:
        planners: Every live agent, by number; the first order is that of their ranks.
        network: Who hears whom.
        orders: Most that are tried; fewer, where nobody in a component pays anything.
    """
    kept, exchanges = run_scp(planners, network)
    solves = _count_solves(kept)
    if orders == 1 or not kept:
        return ConflictResolution(kept, exchanges, solves)
    paid = tolls = compute_priority_costs(kept)
    flooding = int(network.diameter[list(kept)].max())
    exchanges += flooding
    if any(map(any, paid.values())):
        begun = select_clear_components(planners, network)
        kept, paid = keep_cheaper(kept, paid, begun, compute_priority_costs(begun), network)
        exchanges += 1 + flooding
    for _ in range(orders - 1):
        dear = [i for i, total in sum_by_component(paid, network).items() if any(total)]
        if not dear:
            break
        planners = {i: offset_right(raise_priority(planners[i], tolls[i]), 1.0) for i in dear}
        tried, more = run_scp(planners, network)
        exchanges, solves = exchanges + more + flooding, solves + _count_solves(tried)
        tolls = compute_priority_costs(tried)
        kept, paid = keep_cheaper(kept, paid, tried, tolls, network)
    return ConflictResolution(kept, exchanges, solves)


def compute_priority_cost(agent: Planner) -> PriorityCost:
    """What an agent pays, by its own knowledge."""
    return PriorityCost(
        float(
            agent.has_failed or agent.slack > FEASIBILITY_TOLERANCE * agent.horizon.collision_radius
        ),
        float(not agent.reaches_target(agent.nominal)),
        agent.nominal.fuel - agent.solo.fuel,
    )


def raise_priority(agent: Planner, paid: PriorityCost) -> Planner:
    """An agent before the next order: what it paid, it counts as burnt.

    Who gave something up pays the fuel of its flight alone besides.
    """
    moves, first, number = agent.priority
    lost = agent.solo.fuel if paid.is_too_close or paid.misses_target else 0.0
    return agent._replace(priority=(moves, first - max(paid.extra_fuel, 0.0) - lost, number))


def offset_right(agent: Planner, offset: float) -> Planner:
    """An agent in the plane whose nominal bends to the right of its way.

    Who begins with a plan of before stays on the side on which that passes.

    Args:
        agent: Before the first exchange.
        aside: How far in the middle, over R; to the left where negative.
    """
    pieces, points, d = agent.control_points.shape
    way = agent.control_points[-1, -1] - agent.control_points[0, 0]
    if d != 2 or len(agent.nominal.u) == 0 or agent.nominal is not agent.solo or not way.any():
        return agent
    path = agent.horizon.control_points(agent.solo.x, agent.solo.u)
    right = np.array([way[1], -way[0]]) / np.linalg.norm(way)
    along = (np.arange(pieces)[:, None] + np.linspace(0, 1, points)) / pieces
    bend = offset * agent.horizon.collision_radius * np.sin(np.pi * along)
    return agent._replace(control_points=path + bend[..., None] * right, has_converged=False)


def select_clear_components(
    planners: Mapping[int, Planner], network: CommunicationGraph
) -> dict[int, Planner]:
    """The agents of those components in which all are clear as they begin."""
    states = [planners.get(i) for i in range(len(network.alive))]
    told = [agent and agent.message for agent in states]
    acted = run_round(network, states, _mark_clear, told, planners)
    on = {i: agent for i, agent in acted.items() if agent}
    return select_components(on, network, lambda agent: not agent.has_failed)


def _mark_clear(agent: Planner | None, inbox: list[TrajectoryMessage | None]) -> Planner | None:
    if agent is None:
        return None
    heard = tuple(plan for plan in inbox if plan)
    failed = not is_clear(agent.control_points, heard, agent.horizon.collision_radius)
    return agent._replace(is_final=True, has_converged=True, has_failed=failed)


def select_components(
    planners: Mapping[int, Planner],
    network: CommunicationGraph,
    predicate: Callable[[Planner], bool],
) -> dict[int, Planner]:
    """The agents of those components in which it holds of all.

    The batched equivalent of a flood of whether it holds.
    """
    lost = {network.component[i] for i, agent in planners.items() if not predicate(agent)}
    return {i: agent for i, agent in planners.items() if network.component[i] not in lost}


def sum_by_component(
    tolls: Mapping[int, PriorityCost], network: CommunicationGraph
) -> dict[int, PriorityCost]:
    """What all in an agent's component pay together, by the agent's number.

    The batched equivalent of a flood of `{number: toll}`, added up in order of the numbers.
    """
    sums = np.zeros((len(network.alive), len(PriorityCost._fields)))
    for i in sorted(tolls):
        sums[network.component[i]] += tolls[i]
    return {i: PriorityCost(*sums[network.component[i]].tolist()) for i in tolls}


def keep_cheaper(
    kept: dict[int, Planner],
    paid: dict[int, PriorityCost],
    tried: dict[int, Planner],
    tolls: dict[int, PriorityCost],
    network: CommunicationGraph,
) -> tuple[dict[int, Planner], dict[int, PriorityCost]]:
    """What each component keeps of two ways for it, and what each agent pays then."""
    now, before = sum_by_component(tolls, network), sum_by_component(paid, network)
    better = [i for i in tried if now[i] < before[i]]
    return kept | {i: tried[i] for i in better}, paid | {i: tolls[i] for i in better}


def compute_priority_costs(planners: Mapping[int, Planner]) -> dict[int, PriorityCost]:
    """What each of them pays, by its number."""
    return {i: compute_priority_cost(agent) for i, agent in planners.items()}


def _count_solves(planners: Mapping[int, Planner]) -> int:
    return sum(agent.solve_count for agent in planners.values())
