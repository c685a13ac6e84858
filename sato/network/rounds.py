"""Synchronous rounds of messages, and protocols that are built from them.

Distributed means: what an agent does is a pure function of its own memory and its inbox, the
messages of its neighbors. `run_round` alone calls such functions.

Code that computes the same for all agents at once is called batched. It pretends three things:
all agents act in lock step, a message is heard by all neighbors one round after it was sent,
and none is lost. (CBAA alone models delay and loss, in `auctions.cbaa`.) Each batched path is
tested to be equal to its definition by messages:

    definition                          batched
    learn_diameter                      CommunicationGraph.diameter
    flood                               CommunicationGraph.component_max,
                                        scp.priority_orders.sum_by_component, select_components
    flood, then sort                    schedule_turns
    auctions.vsdaa.run_by_messages      auctions.vsdaa_kernel
    tests.test_cbaa.run_by_messages     auctions.cbaa
    scp.exchange.run_by_messages        scp.exchange.run_batched
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from itertools import zip_longest
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Int
from numpy import ndarray as Array

from sato.network.graph import CommunicationGraph

State = TypeVar("State")
Message = TypeVar("Message")
Result = TypeVar("Result")
Value = TypeVar("Value")


def run_round(
    graph: CommunicationGraph,
    states: Mapping[int, State],
    update: Callable[[State, list[Message]], Result],
    messages: Mapping[int, Message],
) -> dict[int, Result]:
    """Let each of these agents act once, on the messages of its neighbors.

    Args:
        graph: Communication graph.
        states: Memory of each agent that acts, by its number.
        update: Pure function of one agent's memory and inbox, most often its new memory.
        messages: Message of each agent that has sent one, by its number.
    """
    return {
        i: update(state, [messages[j] for j in graph.neighbors[i] if j in messages])
        for i, state in states.items()
    }


def run_rounds(
    graph: CommunicationGraph,
    states: Mapping[int, State],
    update: Callable[[State, list[Message]], State],
    message: Callable[[State], Message],
    is_finished: Callable[[State], bool],
) -> Iterator[dict[int, State]]:
    """Run synchronous rounds until all agents have finished.

    A message sent at the end of one round is heard in the next, so news travels one hop a round.
    The last message of a finished agent stays readable; it does nothing more.

    Args:
        graph: Communication graph.
        states: State of each live agent before the first round, by its number.
        update: New state of one agent, a pure function of its state and its inbox.
        message: Message that an agent in a state sends.
        is_finished: True where an agent in a state has finished, by its own knowledge.

    Yields:
        The states after each round.
    """
    now = dict(states)
    while running := {i: state for i, state in now.items() if not is_finished(state)}:
        messages = {i: message(state) for i, state in now.items()}
        now |= run_round(graph, running, update, messages)
        yield dict(now)


def flood(
    graph: CommunicationGraph, values: Mapping[int, Value], merge: Callable[[Value, Value], Value]
) -> dict[int, Value]:
    """Agree on the merged value of a component, in as many rounds as its diameter.

    Args:
        graph: Communication graph; each agent knows the diameter of its component.
        values: Value of each live agent, by its number.
        merge: Commutative, associative and idempotent function, such as `max`.
    """

    def update(state: tuple[Value, int], inbox: list[Value]) -> tuple[Value, int]:
        value, rounds_left = state
        for received in inbox:
            value = merge(value, received)
        return value, rounds_left - 1

    last = {i: (value, int(graph.diameter[i])) for i, value in values.items()}
    for now in run_rounds(graph, last, update, lambda s: s[0], lambda s: s[1] <= 0):
        last = now
    return {i: value for i, (value, _) in last.items()}


def schedule_turns(
    graph: CommunicationGraph, groups: Iterable[tuple[int, ...]]
) -> list[list[tuple[int, ...]]]:
    """Give each group one turn, one group of every component at a time, in ascending order.

    The batched equivalent of a flood of the groups, which each agent then sorts.

    Args:
        graph: Communication graph.
        groups: Agents of one component each, that act in the same turn.
    """
    queues: dict[int, list[tuple[int, ...]]] = {}
    for group in sorted(groups):
        queues.setdefault(int(graph.component[group[0]]), []).append(group)
    return [[group for group in turn if group] for turn in zip_longest(*queues.values())]


class WaveMessage(NamedTuple):
    """Message of an agent that measures its component."""

    known_agents: frozenset[int]  # agents whose wave has arrived, its own included
    max_eccentricity: int = -1  # largest eccentricity heard of; −1 for none


class DiameterEstimator(NamedTuple):
    """Memory of an agent that measures its component."""

    message: WaveMessage
    round: int = 0
    eccentricity: int = -1  # hops to the farthest agent; −1 while not known


def update_diameter(state: DiameterEstimator, inbox: list[WaveMessage]) -> DiameterEstimator:
    """Pass on the waves of all agents, and note when no new one arrives.

    Every agent starts a wave that carries its number, one hop a round. After r rounds an
    agent has heard of exactly those within r hops. A shortest path to its farthest agent,
    e hops away, passes through every distance below e, so something new arrives in each of
    the rounds 1 … e and nothing in round e + 1: then it knows e, its eccentricity, and
    that the diameter D is at most 2 e.

    Agents learn their e at different times, and gossip the largest they know from then on.
    Agent i may stop after 2 e_i further rounds, at its round 3 e_i + 1, since agent j knows
    e_j in round e_j + 1, and i, at most e_i hops away, hears it by round e_j + 1 + e_i,
    which is at most D + 1 + e_i ≤ 3 e_i + 1. By then it has heard of all, and the largest
    is D. An agent that stops does not cut others off: its last message stays readable and
    holds all there is to know. Since e_i ≤ D, all are through by round 3 D + 1, which every
    one of them can compute: the protocol that follows can begin there in step.
    """
    known = state.message.known_agents.union(*(message.known_agents for message in inbox))
    eccentricity, this_round = state.eccentricity, state.round + 1
    if eccentricity < 0 and known == state.message.known_agents:
        eccentricity = this_round - 1
    received = [message.max_eccentricity for message in inbox]
    largest = max([state.message.max_eccentricity, eccentricity, *received])
    return DiameterEstimator(WaveMessage(known, largest), this_round, eccentricity)


def knows_diameter(state: DiameterEstimator) -> bool:
    """Return True once an agent knows the diameter of its component."""
    return state.eccentricity >= 0 and state.round >= 3 * state.eccentricity + 1


def learn_diameter(graph: CommunicationGraph) -> Int[Array, " agents"]:
    """Measure the diameter of each agent's component by messages alone; 0 where not alive."""
    live = np.flatnonzero(graph.alive).tolist()
    last = {i: DiameterEstimator(WaveMessage(frozenset([i]))) for i in live}
    for now in run_rounds(graph, last, update_diameter, lambda s: s.message, knows_diameter):
        last = now
    diameter = np.zeros(len(graph.alive), dtype=np.int64)
    for i, state in last.items():
        diameter[i] = state.message.max_eccentricity
    return diameter
