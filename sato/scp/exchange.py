"""Method 2 for all agents: exchange until every one is settled."""

from collections.abc import Iterator, Mapping

import numpy as np

from problems.convexify import are_hulls_separated
from sato.network.graph import CommunicationGraph, run_round, run_rounds
from sato.scp.planner import Planner, TrajectoryMessage, follows_solo, update_planner


def run_scp(
    planners: Mapping[int, Planner], network: CommunicationGraph
) -> tuple[dict[int, Planner], int]:
    """Method 2 for all agents: exchange until every one is settled.

    Args:
        planners: Every live agent, by number.
        network: Who hears whom.

    Returns:
        The agents settled, and the number of exchanges it took.
    """
    history = [dict(planners), *run_batched(planners, network)]
    return history[-1], len(history) - 1


def run_by_messages(
    planners: Mapping[int, Planner], network: CommunicationGraph
) -> Iterator[dict[int, Planner]]:
    """Run the definition itself: every agent after every exchange."""
    states = [planners.get(i) for i in range(len(network.alive))]

    def done(agent: Planner | None) -> bool:
        return agent is None or agent.is_final

    for now in run_rounds(network, states, _update_if_alive, _message_if_alive, done):
        yield {i: agent for i, agent in enumerate(now) if agent}


def _update_if_alive(
    agent: Planner | None, inbox: list[TrajectoryMessage | None]
) -> Planner | None:
    return agent and update_planner(agent, [plan for plan in inbox if plan])


def _message_if_alive(agent: Planner | None) -> TrajectoryMessage | None:
    return agent and agent.message


def run_batched(
    planners: Mapping[int, Planner], network: CommunicationGraph
) -> Iterator[dict[int, Planner]]:
    """The same as `by_messages`, geometry for all at once and only where paths changed.

    Exchanges in which an agent has nothing to solve only carry whether it is settled.
    """
    numbers = sorted(planners)
    now = [planners[i] for i in numbers]
    if not now:
        return
    radius = now[0].horizon.collision_radius
    order = np.empty(len(now), dtype=int)
    order[sorted(range(len(now)), key=lambda i: now[i].priority)] = np.arange(len(now))
    above = network.adjacency[np.ix_(numbers, numbers)] & (order < order[:, None])
    lower, upper = np.nonzero(above)
    paths = np.stack([agent.control_points for agent in now])
    meets = np.asarray(~are_hulls_separated(paths[lower] - paths[upper], radius).all(axis=-1))
    settled = np.zeros(len(now), dtype=bool)
    busy = np.array([not follows_solo(agent) for agent in now])
    while not settled.all():
        binds = np.zeros(len(now), dtype=bool)
        binds[lower[meets]] = True
        waits = (above & ~settled).any(axis=1)
        acts = ~settled & (binds | busy)
        states: list[Planner | None] = [None] * len(network.alive)
        for number, agent in zip(numbers, now, strict=True):
            states[number] = agent
        told = [_message_if_alive(agent) for agent in states] if acts.any() else []
        settled = settled | (~acts & ~waits)
        now = [a._replace(is_final=True) if s else a for a, s in zip(now, settled, strict=True)]
        moved = np.zeros(len(now), dtype=bool)
        acting = np.flatnonzero(acts).tolist()
        acted = run_round(network, states, _update_if_alive, told, [numbers[i] for i in acting])
        for i in acting:
            after = acted[numbers[i]] or now[i]
            moved[i] = after.control_points is not now[i].control_points
            now[i], settled[i] = after, after.is_final
            busy[i] = not follows_solo(after)
            paths[i] = after.control_points
        afresh = moved[lower] | moved[upper]
        meets[afresh] = ~are_hulls_separated(
            paths[lower[afresh]] - paths[upper[afresh]], radius
        ).all(axis=-1)
        yield dict(zip(numbers, now, strict=True))
