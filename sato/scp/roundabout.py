"""Roundabouts: all keep to the same hand, and take turns to keep clear of everybody they hear.

Where many pass through one place, whoever goes first goes straight and the others go about it: no
order of priority has all go round together, which often costs least. Here nobody goes straight. All
begin bent to one hand, and each in its turn keeps clear of all whom it hears, as they have told,
those whose turn is still to come as well, until all are clear. Bargains follow.
"""

from collections.abc import Mapping

from sato.network import Network, play, turns
from sato.scp.agent import Others, Plan, Planner, past
from sato.scp.bargaining import bargain
from sato.scp.orders import (
    Settled,
    bent,
    cheaper,
    going_on,
    settle_orders,
    tolled,
    totals,
    where_all,
)

BENDS = (1.0, -1.0, 2.0, -2.0)  # of nominals, over R: to the right, and to the left
MOST_ROUNDS = 8  # of turns; ten through one point take one or two


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
    if sweeps == 0:
        return settled
    dealt = bargain(settled.planners, network, sweeps)
    kept, paid = dealt.planners, tolled(dealt.planners)
    flooding = int(network.diameter[list(kept)].max(initial=0))
    exchanges = settled.exchanges + dealt.exchanges + flooding
    solves = settled.solves + dealt.solves
    able = where_all(planners, network, can_go_round)
    for bend in BENDS:
        dear = [i for i, total in totals(paid, network).items() if i in able and any(total)]
        begun = round_about({i: able[i] for i in dear}, network, bend)
        exchanges, solves = exchanges + begun.exchanges, solves + begun.solves
        if begun.planners:
            other = bargain(begun.planners, network, sweeps)
            kept, paid = cheaper(kept, paid, other.planners, tolled(other.planners), network)
            exchanges, solves = exchanges + other.exchanges + flooding, solves + other.solves
    return Settled(kept, exchanges, solves)


def can_go_round(agent: Planner) -> bool:
    """Whether it flies in the plane, without a plan of before, and to its goal if alone."""
    return agent.path.shape[-1] == 2 and agent.flight is agent.free and agent.arrives(agent.free)


def round_about(planners: Mapping[int, Planner], network: Network, bend: float) -> Settled:
    """The agents of those components that come to be clear, with all at their goals in the end.

    A component in which that is not so after `MOST_ROUNDS` is left out.

    Args:
        planners: Agents of whole components, by number, each with `can_go_round`.
        network: Who hears whom.
        bend: Of nominals, over R: to the right, or to the left where negative.
    """
    now = {i: bent(agent, bend) for i, agent in planners.items()}
    done: dict[int, Planner] = {}
    exchanges = 0
    for _ in range(MOST_ROUNDS):
        if not now:
            break
        for turn in turns(network, [(i,) for i in now]):
            states = [now.get(i) for i in range(len(network.alive))]
            told = [agent and agent.plan for agent in states]
            acted = play(network, states, _keep_clear, told, [i for (i,) in turn])
            now |= {i: agent for i, agent in acted.items() if agent}
            exchanges += 1
        exchanges += 1 + int(network.diameter[list(now)].max())
        clear = going_on(now, network)
        done |= where_all(clear, network, lambda agent: agent.arrives(agent.flight))
        now = {i: agent for i, agent in now.items() if i not in done}
    return Settled(done, exchanges, sum(agent.solves for agent in (now | done).values()))


def _keep_clear(agent: Planner | None, inbox: list[Plan | None]) -> Planner | None:
    return agent and keep_clear(agent, tuple(plan for plan in inbox if plan))


def keep_clear(agent: Planner, heard: tuple[Plan, ...]) -> Planner:
    """One turn of one agent: keep clear of all whom it hears, on the side on which it passes.

    Where there is no such flight, it ends as near its goal as it can, and comes too close by as
    little as it can only where even that does not help.
    """
    if len(agent.flight.u) == 0 or not heard:
        return agent.flying(agent.flight)
    agent = agent.relinearised
    others = Others.of(agent, heard)
    for gives in ("nothing", "separation"):
        agent = agent._replace(solves=agent.solves + 1)
        passage = past(agent.level, others, agent.path, "near", gives)
        if passage is not None:
            return agent.flying(passage.flight)
    return agent.flying(agent.flight)
