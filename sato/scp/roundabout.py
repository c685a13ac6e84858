"""Roundabouts: all keep to the same hand, and take turns to keep clear of everybody.

Where many pass through one place, whoever goes first goes straight and the others go about it: no
order of priority has all go round together, which often costs least. Here nobody goes straight. All
begin bent to one hand, and each in its turn keeps clear of all others as they have told, those
whose turn is still to come as well, until all are clear. Bargains follow.
"""

from collections.abc import Mapping
from itertools import zip_longest

from sato.network import Network, play
from sato.scp.agent import Others, Plan, Planner, past
from sato.scp.bargaining import bargain
from sato.scp.orders import Settled, bent, cheaper, going_on, settle_orders, toll, tolled, totals

BENDS = (1.0, -1.0, 2.0, -2.0)  # of nominals, over R: to the right, and to the left
MOST_ROUNDS = 8  # of turns; mostly it takes two


def come_to_terms(
    planners: Mapping[int, Planner], network: Network, orders: int, sweeps: int
) -> Settled:
    """Orders of priority, and then roundabouts, each with bargains; components keep the cheapest.

    Args:
        planners: Every live agent, by number; the first order is that of their ranks.
        network: Who hears whom.
        orders: Most that are tried.
        sweeps: Most in which pairs bargain; without any there are no roundabouts.
    """
    settled = settle_orders(planners, network, orders)
    dealt = bargain(settled.planners, network, sweeps)
    kept, exchanges, solves = dealt.planners, settled.exchanges, settled.solves
    exchanges, solves = exchanges + dealt.exchanges, solves + dealt.solves
    paid = tolled(kept)
    for bend in BENDS if sweeps else ():
        dear = {i: planners[i] for i, total in totals(paid, network).items() if any(total)}
        begun = round_about(dear, network, bend)
        other = bargain(begun.planners, network, sweeps)
        kept, paid = cheaper(kept, paid, other.planners, tolled(other.planners), network)
        exchanges += begun.exchanges + other.exchanges
        solves += begun.solves + other.solves
    return Settled(kept, exchanges, solves)


def round_about(planners: Mapping[int, Planner], network: Network, bend: float) -> Settled:
    """The agents of those components that come to be clear, with all at their goals in the end.

    Args:
        planners: Agents of whole components, by number, before the first exchange.
        network: Who hears whom.
        bend: Of nominals, over R: to the right, or to the left where negative.
    """
    begun = {i: bent(agent, bend) for i, agent in planners.items()}
    able = {network.component[i] for i in begun if begun[i] is not planners[i]}
    now = {i: agent for i, agent in begun.items() if network.component[i] in able}
    done: dict[int, Planner] = {}
    exchanges = solves = 0
    for _ in range(MOST_ROUNDS):
        if not now:
            break
        before = sum(agent.solves for agent in now.values())
        for turn in turns(now, network):
            states = [now.get(i) for i in range(len(network.alive))]
            told = [agent and agent.plan for agent in states]
            acted = play(network, states, _keep_clear, told, turn)
            now |= {i: agent for i, agent in acted.items() if agent}
            exchanges += 1
        solves += sum(agent.solves for agent in now.values()) - before
        exchanges += 1 + int(network.diameter[list(now)].max())
        done |= arrived(going_on(now, network), network)
        now = {i: agent for i, agent in now.items() if i not in done}
    return Settled(done, exchanges, solves)


def turns(planners: Mapping[int, Planner], network: Network) -> list[list[int]]:
    """One agent of every component at a time, in order of their numbers."""
    queues: dict[int, list[int]] = {}
    for i in sorted(planners):
        queues.setdefault(int(network.component[i]), []).append(i)
    return [[i for i in turn if i is not None] for turn in zip_longest(*queues.values())]


def arrived(planners: dict[int, Planner], network: Network) -> dict[int, Planner]:
    """The agents of those components in which all end at their goals."""
    late = {network.component[i] for i, agent in planners.items() if toll(agent).late}
    return {i: agent for i, agent in planners.items() if network.component[i] not in late}


def _keep_clear(agent: Planner | None, inbox: list[Plan | None]) -> Planner | None:
    return agent and keep_clear(agent, tuple(plan for plan in inbox if plan))


def keep_clear(agent: Planner, heard: tuple[Plan, ...]) -> Planner:
    """One turn of one agent: keep clear of all whom it hears, on the side on which it passes.

    Where there is no such flight, it comes too close by as little as it can.
    """
    if len(agent.flight.u) == 0 or not heard:
        return agent
    agent = agent.relinearised
    others = Others.of(agent, heard)
    for gives in ("nothing", "separation"):
        agent = agent._replace(solves=agent.solves + 1)
        passage = past(agent.level, others, agent.path, "near", gives)
        if passage is not None:
            path = agent.horizon.path(passage.flight.x, passage.flight.u)
            return agent._replace(flight=passage.flight, path=path, late=passage.late)
    return agent
