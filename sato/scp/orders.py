"""Several orders of priority: who paid most goes first the next time [Joslin1999].

Method 2 is settled once, and then anew under other orders. Each time an agent goes before
others by as much more as it paid for them, and in the plane all begin by keeping to the right,
as on a road: nominals that all meet in one point show nobody a way round. In the end every
network flies the cheapest of what it has tried: agents flood what each of them pays, and add
up for themselves.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from sato.network import Network
from sato.scp.agent import Planner
from sato.scp.run import settle

TIGHT = 1e-6  # of R: who breaks half-spaces by less keeps clear


class Toll(NamedTuple):
    """What an agent pays for others; the smaller is better, a distance before an arrival."""

    close: float  # 1 where it comes too close to somebody
    late: float  # 1 where it does not arrive
    fuel: float  # beyond that of its flight alone [m/s]


def toll(agent: Planner) -> Toll:
    """What an agent pays, by its own knowledge."""
    close = agent.failed or agent.slack > TIGHT * agent.horizon.radius
    return Toll(float(close), float(agent.late > 0), agent.flight.fuel - agent.free.fuel)


def raised(agent: Planner, paid: Toll) -> Planner:
    """An agent before the next order: what it paid, it counts as burnt.

    Who gave something up pays the fuel of its flight alone besides.
    """
    moves, spent, number = agent.rank
    lost = agent.free.fuel if paid.close or paid.late else 0.0
    return agent._replace(rank=(moves, spent - max(paid.fuel, 0.0) - lost, number))


def to_the_right(agent: Planner) -> Planner:
    """An agent in the plane whose nominal bends to the right of its way, by R in the middle."""
    path = agent.horizon.path(agent.free.x, agent.free.u)
    pieces, points, d = path.shape
    way = path[-1, -1] - path[0, 0]
    if d != 2 or len(agent.free.u) == 0 or not way.any():
        return agent
    right = np.array([way[1], -way[0]]) / np.linalg.norm(way)
    along = (np.arange(pieces)[:, None] + np.linspace(0, 1, points)) / pieces
    bend = agent.horizon.radius * np.sin(np.pi * along)
    return agent._replace(path=path + bend[..., None] * right, steady=False)


class Settled(NamedTuple):
    """What agents agreed on, and what that took."""

    planners: dict[int, Planner]
    exchanges: int  # of all orders
    solves: int


def settle_orders(planners: Mapping[int, Planner], network: Network, orders: int) -> Settled:
    """Settle under several orders of priority; each component keeps its cheapest.

    Args:
        planners: Every live agent, by number; the first order is that of their ranks.
        network: Who hears whom.
        orders: Most that are tried; fewer, once nobody pays anything.
    """
    kept, exchanges = settle(planners, network)
    tolls = {i: toll(agent) for i, agent in kept.items()}
    paid = dict(tolls)
    solves = sum(agent.solves for agent in kept.values())
    for _ in range(orders - 1):
        if not any(any(each) for each in paid.values()):
            break
        planners = {i: to_the_right(raised(agent, tolls[i])) for i, agent in planners.items()}
        tried, more = settle(planners, network)
        exchanges, solves = exchanges + more, solves + sum(a.solves for a in tried.values())
        tolls = {i: toll(agent) for i, agent in tried.items()}
        now, before = (totals(some, network) for some in (tolls, paid))
        better = [i for i in tolls if now[i] < before[i]]
        kept |= {i: tried[i] for i in better}
        paid |= {i: tolls[i] for i in better}
    return Settled(kept, exchanges, solves)


def totals(tolls: Mapping[int, Toll], network: Network) -> dict[int, Toll]:
    """What all in an agent's component pay together, by the agent's number.

    The batched equivalent of a flood of `{number: toll}`, added up in order of the numbers.
    """
    sums = np.zeros((len(network.alive), len(Toll._fields)))
    for i in sorted(tolls):
        sums[network.component[i]] += tolls[i]
    return {i: Toll(*sums[network.component[i]].tolist()) for i in tolls}
