"""Who hears whom now, and rounds of messages.

An agent's part in a protocol is a pure function of its own state and of the messages
of its neighbours. `play` is the only caller of it, and `rounds`, which plays all agents,
defines what a protocol does. Where a fast path stands in, a test holds it equal to them.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest
from typing import NamedTuple, TypeVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, shortest_path

State = TypeVar("State")
Message = TypeVar("Message")
Value = TypeVar("Value")


@dataclass(frozen=True, eq=False)
class CommunicationGraph:
    """Who hears whom now."""

    adjacency: Bool[Array, "agents agents"]  # symmetric, nobody hears itself or the dead
    alive: Bool[Array, " agents"]

    def __post_init__(self) -> None:
        if not np.array_equal(self.adjacency, self.adjacency.T):
            i, j = np.argwhere(self.adjacency & ~self.adjacency.T)[0]
            raise ValueError(f"agent {i} hears agent {j} but not the other way round")
        if np.any(np.diag(self.adjacency)):
            raise ValueError(f"agent {np.argmax(np.diag(self.adjacency))} is its own neighbour")
        if np.any(self.adjacency[~self.alive]):
            lost = np.flatnonzero(~self.alive & self.adjacency.any(axis=1))[0]
            raise ValueError(f"agent {lost} is not alive but has neighbours")

    @classmethod
    def from_positions(
        cls, position: Float[Array, "agents d"], radius: float, alive: Bool[Array, " agents"]
    ) -> "CommunicationGraph":
        """Agents that are alive and at most `radius` apart hear each other.

        Args:
            position: Where each agent is [m]; the dead may be anywhere, also NaN.
            radius: Reach of a message [m].
            alive: Who is there.
        """
        if not radius > 0:
            raise ValueError(f"the reach of a message must be positive, got {radius} m")
        hears = np.zeros((len(alive), len(alive)), dtype=bool)
        live = np.flatnonzero(alive)
        apart = position[live, None, :] - position[None, live, :]
        near = np.einsum("ijk,ijk->ij", apart, apart) <= radius**2
        np.fill_diagonal(near, False)
        hears[np.ix_(live, live)] = near
        return cls(hears, alive.copy())

    def subgraph(self, which: Bool[Array, " agents"]) -> "CommunicationGraph":
        """The part of it that is made of some whole components."""
        stay = self.alive & which
        return CommunicationGraph(self.adjacency & stay & stay[:, None], stay)

    @cached_property
    def neighbors(self) -> tuple[Int[Array, " _"], ...]:
        """Whom each agent hears, in order of their numbers."""
        return tuple(np.flatnonzero(row) for row in self.adjacency)

    @cached_property
    def component(self) -> Int[Array, " agents"]:
        """Component of each agent, numbered by its lowest member; −1 while not alive."""
        return label_components(self.adjacency, self.alive)

    @cached_property
    def hops(self) -> Float[Array, "agents agents"]:
        """Least number of messages from one agent to another; infinite between components."""
        # The batched equivalent of the waves in `learn_diameter`.
        return np.asarray(shortest_path(csr_array(self.adjacency), directed=False, unweighted=True))

    @cached_property
    def diameter(self) -> Int[Array, " agents"]:
        """Largest number of hops within each agent's component; 0 for one that is alone."""
        reached = np.where(np.isfinite(self.hops), self.hops, 0)
        return self.component_max(reached.max(axis=1, initial=0).astype(np.int64))

    def component_max(self, values: Int[Array, " agents"]) -> Int[Array, " agents"]:
        """Largest value in each agent's component; the dead keep their own.

        The batched equivalent of `flood(network, values, max)`.
        """
        result = values.copy()
        top = np.full(len(values), np.iinfo(np.int64).min)
        np.maximum.at(top, self.component[self.alive], values[self.alive])
        result[self.alive] = top[self.component[self.alive]]
        return result


def label_components(links: Bool[Array, "n n"], alive: Bool[Array, " n"]) -> Int[Array, " n"]:
    """The part that each belongs to, numbered by its lowest member; −1 while not alive.

    Args:
        links: Who is joined to whom; nobody to the dead.
        alive: Who is there.
    """
    labels = connected_components(csr_array(links), directed=False)[1]
    return canonicalize_labels(np.where(alive, labels, -1))


def canonicalize_labels(labels: Int[Array, " n"]) -> Int[Array, " n"]:
    """Labels numbered in order of their first member; negative ones become −1."""
    named = np.full(len(labels), -1)
    live = labels >= 0
    if live.any():
        _, first, inverse = np.unique(labels[live], return_index=True, return_inverse=True)
        named[live] = np.argsort(np.argsort(first))[inverse]
    return named


def schedule_turns(
    network: CommunicationGraph, parties: Iterable[tuple[int, ...]]
) -> list[list[tuple[int, ...]]]:
    """One party of every component at a time, each once, in order of their numbers.

    The batched equivalent of a flood of the parties, which each then puts in order.

    Args:
        network: Who hears whom.
        parties: Agents of one component each, who have their turn together.
    """
    queues: dict[int, list[tuple[int, ...]]] = {}
    for party in sorted(parties):
        queues.setdefault(int(network.component[party[0]]), []).append(party)
    return [[party for party in turn if party] for turn in zip_longest(*queues.values())]


def run_rounds(
    network: CommunicationGraph,
    states: Sequence[State],
    act: Callable[[State, list[Message]], State],
    tell: Callable[[State], Message],
    done: Callable[[State], bool],
) -> Iterator[list[State]]:
    """Synchronous rounds: everybody listens, acts once and tells its neighbours.

    A message told at the end of one round is heard in the next, so news travels one
    hop a round. What a finished agent told last stays readable, as on a notice board;
    it does nothing more. The iterator ends when all live agents are done.

    Args:
        network: Who hears whom.
        states: State of each agent before the first round, also of the dead, who never act.
        act: What one agent does in a round: a pure function of its own state and of the
            messages of its neighbours.
        tell: What an agent in that state tells its neighbours.
        done: Whether an agent in that state has finished, by its own knowledge.

    Yields:
        The states after each round.
    """
    now = list(states)
    while True:
        running = [i for i in np.flatnonzero(network.alive).tolist() if not done(now[i])]
        if not running:
            return
        told = [tell(state) for state in now]
        for i, state in run_round(network, now, act, told, running).items():
            now[i] = state
        yield list(now)


def run_round(
    network: CommunicationGraph,
    states: Sequence[State],
    act: Callable[[State, list[Message]], State],
    told: Sequence[Message],
    who: Iterable[int],
) -> dict[int, State]:
    """One round for some agents: each hears its neighbours and acts once.

    Nothing else calls what an agent does.

    Args:
        network: Who hears whom.
        states: State of each agent before the round.
        act: What one agent does: a pure function of its own state and what it hears.
        told: What each agent has told.
        who: Those who act.
    """
    return {i: act(states[i], [told[j] for j in network.neighbors[i]]) for i in who}


def run_until_done(
    network: CommunicationGraph,
    states: Sequence[State],
    act: Callable[[State, list[Message]], State],
    tell: Callable[[State], Message],
    done: Callable[[State], bool],
) -> list[State]:
    """The states when all are done: the last of `rounds`."""
    last = list(states)
    for now in run_rounds(network, states, act, tell, done):
        last = now
    return last


def flood(
    network: CommunicationGraph, values: Sequence[Value], merge: Callable[[Value, Value], Value]
) -> list[Value]:
    """Agree on the merged value of a component: D rounds of telling what one has merged.

    Args:
        network: Who hears whom. Each agent stops after as many rounds as the diameter of
            its component, which it has learnt (`learn_diameter`).
        values: What each agent starts with.
        merge: Commutative, associative and idempotent, such as `max`.
    """

    def act(state: tuple[Value, int], inbox: list[Value]) -> tuple[Value, int]:
        value, left = state
        for heard in inbox:
            value = merge(value, heard)
        return value, left - 1

    states = list(zip(values, network.diameter.tolist(), strict=True))
    agreed = run_until_done(
        network, states, act, lambda state: state[0], lambda state: state[1] <= 0
    )
    return [value for value, _ in agreed]


class WaveMessage(NamedTuple):
    """What an agent tells while it measures its component."""

    known_agents: frozenset[int]  # agents whose wave has arrived, its own included
    max_eccentricity: int = -1  # largest eccentricity heard of; −1 for none


class DiameterEstimator(NamedTuple):
    """One agent that measures its component."""

    message: WaveMessage
    round: int = 0
    eccentricity: int = -1  # hops to the farthest agent; −1 while not known


def update_diameter(state: DiameterEstimator, inbox: list[WaveMessage]) -> DiameterEstimator:
    """One round of one agent: pass on the waves, and note when they cease.

    Every agent starts a wave that carries its number, one hop a round. After r rounds an
    agent has heard of exactly those within r hops. A shortest path to its farthest agent,
    e hops away, passes through every distance below e, so something new arrives in each of
    the rounds 1 … e and nothing in round e + 1: then it knows e, its eccentricity, and
    that the diameter D is at most 2 e.

    Agents learn their e at different times, and gossip the largest they know from then on.
    Why agent i may stop after 2 e_i further rounds, at its round 3 e_i + 1: agent j knows
    e_j in round e_j + 1, and i, at most e_i hops away, hears it by round e_j + 1 + e_i,
    which is at most D + 1 + e_i ≤ 3 e_i + 1. By then it has heard of all, and the largest
    is D. That an agent stops does not cut others off: what it told last stays readable and
    holds all there is to know. Since e_i ≤ D, all are through by round 3 D + 1, which every
    one of them can compute: the protocol that follows can begin there in step.
    """
    heard = state.message.known_agents.union(*(news.known_agents for news in inbox))
    eccentricity, this_round = state.eccentricity, state.round + 1
    if eccentricity < 0 and heard == state.message.known_agents:
        eccentricity = this_round - 1
    widest = max(
        [state.message.max_eccentricity, eccentricity, *(news.max_eccentricity for news in inbox)]
    )
    return DiameterEstimator(WaveMessage(heard, widest), this_round, eccentricity)


def knows_diameter(state: DiameterEstimator) -> bool:
    """Whether an agent knows the diameter of its component."""
    return state.eccentricity >= 0 and state.round >= 3 * state.eccentricity + 1


def learn_diameter(network: CommunicationGraph) -> Int[Array, " agents"]:
    """Diameter of each agent's component, as agents learn it: by messages alone.

    The definition behind `Network.diameter`, which is the fast path.
    """
    states = [DiameterEstimator(WaveMessage(frozenset([i]))) for i in range(len(network.alive))]
    ends = run_until_done(
        network, states, update_diameter, lambda state: state.message, knows_diameter
    )
    return np.array([max(end.message.max_eccentricity, 0) for end in ends], dtype=np.int64)
