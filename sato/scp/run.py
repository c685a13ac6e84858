"""Method 2 for all agents: exchange until every one is settled."""

from collections.abc import Iterator, Mapping

import numpy as np

from problems.convexify import apart
from sato.network import Network, play, rounds
from sato.scp.agent import Plan, Planner, revise, untouched


def settle(planners: Mapping[int, Planner], network: Network) -> tuple[dict[int, Planner], int]:
    """Method 2 for all agents: exchange until every one is settled.

    Args:
        planners: Every live agent, by number.
        network: Who hears whom.

    Returns:
        The agents settled, and the number of exchanges it took.
    """
    history = [dict(planners), *exchanged(planners, network)]
    return history[-1], len(history) - 1


def by_messages(planners: Mapping[int, Planner], network: Network) -> Iterator[dict[int, Planner]]:
    """Run the definition itself: every agent after every exchange."""
    states = [planners.get(i) for i in range(len(network.alive))]

    def done(agent: Planner | None) -> bool:
        return agent is None or agent.settled

    for now in rounds(network, states, _revise, _tell, done):
        yield {i: agent for i, agent in enumerate(now) if agent}


def _revise(agent: Planner | None, inbox: list[Plan | None]) -> Planner | None:
    return agent and revise(agent, [plan for plan in inbox if plan])


def _tell(agent: Planner | None) -> Plan | None:
    return agent and agent.plan


def exchanged(planners: Mapping[int, Planner], network: Network) -> Iterator[dict[int, Planner]]:
    """The same as `by_messages`, geometry for all at once and only where paths changed.

    Exchanges in which an agent has nothing to solve only carry whether it is settled.
    """
    numbers = sorted(planners)
    now = [planners[i] for i in numbers]
    if not now:
        return
    radius = now[0].horizon.radius
    order = np.empty(len(now), dtype=int)
    order[sorted(range(len(now)), key=lambda i: now[i].rank)] = np.arange(len(now))
    above = network.hears[np.ix_(numbers, numbers)] & (order < order[:, None])
    lower, upper = np.nonzero(above)
    paths = np.stack([agent.path for agent in now])
    meets = np.asarray(~apart(paths[lower] - paths[upper], radius).all(axis=-1))
    settled = np.zeros(len(now), dtype=bool)
    busy = np.array([not untouched(agent) for agent in now])
    while not settled.all():
        binds = np.zeros(len(now), dtype=bool)
        binds[lower[meets]] = True
        waits = (above & ~settled).any(axis=1)
        acts = ~settled & (binds | busy)
        states: list[Planner | None] = [None] * len(network.alive)
        for number, agent in zip(numbers, now, strict=True):
            states[number] = agent
        told = [_tell(agent) for agent in states] if acts.any() else []
        settled = settled | (~acts & ~waits)
        now = [a._replace(settled=True) if s else a for a, s in zip(now, settled, strict=True)]
        moved = np.zeros(len(now), dtype=bool)
        acting = np.flatnonzero(acts).tolist()
        acted = play(network, states, _revise, told, [numbers[i] for i in acting])
        for i in acting:
            after = acted[numbers[i]] or now[i]
            moved[i] = after.path is not now[i].path
            now[i], settled[i] = after, after.settled
            busy[i] = not untouched(after)
            paths[i] = after.path
        afresh = moved[lower] | moved[upper]
        meets[afresh] = ~apart(paths[lower[afresh]] - paths[upper[afresh]], radius).all(axis=-1)
        yield dict(zip(numbers, now, strict=True))
