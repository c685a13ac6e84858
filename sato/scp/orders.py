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

from sato.network import Network, play
from sato.scp.agent import TIGHT, Plan, Planner, clear
from sato.scp.run import settle


class Toll(NamedTuple):
    """What an agent pays for others; the smaller is better, a distance before an arrival."""

    close: float  # 1 where it comes too close to somebody
    late: float  # 1 where it does not end at its goal
    fuel: float  # beyond that of its flight alone [m/s]


class Settled(NamedTuple):
    """What agents agreed on, and what that took."""

    planners: dict[int, Planner]
    exchanges: int  # of all orders, with what is flooded
    solves: int


def settle_orders(planners: Mapping[int, Planner], network: Network, orders: int) -> Settled:
    """Settle under several orders of priority; each component keeps its cheapest.

    Args:
        planners: Every live agent, by number; the first order is that of their ranks.
        network: Who hears whom.
        orders: Most that are tried; fewer, where nobody in a component pays anything.
    """
    kept, exchanges = settle(planners, network)
    solves = _solves(kept)
    if orders == 1 or not kept:
        return Settled(kept, exchanges, solves)
    paid = tolls = tolled(kept)
    flooding = int(network.diameter[list(kept)].max())
    exchanges += flooding
    if any(map(any, paid.values())):
        begun = going_on(planners, network)
        kept, paid = cheaper(kept, paid, begun, tolled(begun), network)
        exchanges += 1 + flooding
    for _ in range(orders - 1):
        dear = [i for i, total in totals(paid, network).items() if any(total)]
        if not dear:
            break
        planners = {i: bent(raised(planners[i], tolls[i]), 1.0) for i in dear}
        tried, more = settle(planners, network)
        exchanges, solves = exchanges + more + flooding, solves + _solves(tried)
        tolls = tolled(tried)
        kept, paid = cheaper(kept, paid, tried, tolls, network)
    return Settled(kept, exchanges, solves)


def toll(agent: Planner) -> Toll:
    """What an agent pays, by its own knowledge."""
    return Toll(
        float(agent.failed or agent.slack > TIGHT * agent.horizon.radius),
        float(not agent.arrives(agent.flight)),
        agent.flight.fuel - agent.free.fuel,
    )


def raised(agent: Planner, paid: Toll) -> Planner:
    """An agent before the next order: what it paid, it counts as burnt.

    Who gave something up pays the fuel of its flight alone besides.
    """
    moves, first, number = agent.rank
    lost = agent.free.fuel if paid.close or paid.late else 0.0
    return agent._replace(rank=(moves, first - max(paid.fuel, 0.0) - lost, number))


def bent(agent: Planner, aside: float) -> Planner:
    """An agent in the plane whose nominal bends to the right of its way.

    Who begins with a plan of before stays on the side on which that passes.

    Args:
        agent: Before the first exchange.
        aside: How far in the middle, over R; to the left where negative.
    """
    pieces, points, d = agent.path.shape
    way = agent.path[-1, -1] - agent.path[0, 0]
    if d != 2 or len(agent.flight.u) == 0 or agent.flight is not agent.free or not way.any():
        return agent
    path = agent.horizon.path(agent.free.x, agent.free.u)
    right = np.array([way[1], -way[0]]) / np.linalg.norm(way)
    along = (np.arange(pieces)[:, None] + np.linspace(0, 1, points)) / pieces
    bend = aside * agent.horizon.radius * np.sin(np.pi * along)
    return agent._replace(path=path + bend[..., None] * right, steady=False)


def going_on(planners: Mapping[int, Planner], network: Network) -> dict[int, Planner]:
    """The agents of those components in which all are clear as they begin."""
    states = [planners.get(i) for i in range(len(network.alive))]
    told = [agent and agent.plan for agent in states]
    acted = play(network, states, _go_on, told, planners)
    on = {i: agent for i, agent in acted.items() if agent}
    return where_all(on, network, lambda agent: not agent.failed)


def _go_on(agent: Planner | None, inbox: list[Plan | None]) -> Planner | None:
    if agent is None:
        return None
    heard = tuple(plan for plan in inbox if plan)
    failed = not clear(agent.path, heard, agent.horizon.radius)
    return agent._replace(settled=True, steady=True, failed=failed)


def where_all(
    planners: Mapping[int, Planner], network: Network, holds: Callable[[Planner], bool]
) -> dict[int, Planner]:
    """The agents of those components in which it holds of all.

    The batched equivalent of a flood of whether it holds.
    """
    lost = {network.component[i] for i, agent in planners.items() if not holds(agent)}
    return {i: agent for i, agent in planners.items() if network.component[i] not in lost}


def totals(tolls: Mapping[int, Toll], network: Network) -> dict[int, Toll]:
    """What all in an agent's component pay together, by the agent's number.

    The batched equivalent of a flood of `{number: toll}`, added up in order of the numbers.
    """
    sums = np.zeros((len(network.alive), len(Toll._fields)))
    for i in sorted(tolls):
        sums[network.component[i]] += tolls[i]
    return {i: Toll(*sums[network.component[i]].tolist()) for i in tolls}


def cheaper(
    kept: dict[int, Planner],
    paid: dict[int, Toll],
    tried: dict[int, Planner],
    tolls: dict[int, Toll],
    network: Network,
) -> tuple[dict[int, Planner], dict[int, Toll]]:
    """What each component keeps of two ways for it, and what each agent pays then."""
    now, before = totals(tolls, network), totals(paid, network)
    better = [i for i in tried if now[i] < before[i]]
    return kept | {i: tried[i] for i in better}, paid | {i: tolls[i] for i in better}


def tolled(planners: Mapping[int, Planner]) -> dict[int, Toll]:
    """What each of them pays, by its number."""
    return {i: toll(agent) for i, agent in planners.items()}


def _solves(planners: Mapping[int, Planner]) -> int:
    return sum(agent.solves for agent in planners.values())
