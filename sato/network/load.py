"""Load of a network by what its agents agree on: synchronous rounds, messages and bytes.

An agent sends a message to all of its neighbors in the rounds in which it has something new to
say, and is silent in all others: see `network.encoding`. Reports that agents pass on travel
one hop a round, so the number of hops between all agents tells when each of them has something to
pass on.
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray as Array

from problems.kernels import compiled
from sato.network.encoding import ECCENTRICITY, HEADER
from sato.network.graph import CommunicationGraph

PURPOSES = ("census", "auction", "trajectories", "commitment")

Events = tuple[Int[Array, " events"], Int[Array, " events"]]  # agents, rounds
Counts = tuple[Int[Array, " agents"], Int[Array, " agents"]]  # messages and bytes of each agent


class Load(NamedTuple):
    """Load of each agent's network, of one or more stages."""

    rounds: Int[Array, " agents"]  # synchronous ones that the agent gets through
    messages: Int[Array, " agents"]  # that it receives
    bytes: Int[Array, " agents"]  # of these, with headers

    @classmethod
    def none(cls, agents: int) -> "Load":
        """Return that of agents that send nothing."""
        return cls(*np.zeros((len(cls._fields), agents), dtype=np.int64))

    @classmethod
    def of(
        cls,
        graph: CommunicationGraph,
        agents: Sequence[int] | Int[Array, " some"],
        rounds: Int[Array, " agents"],
        *sent: Counts,
    ) -> "Load":
        """Return that of agents of whole components, from arrays of all.

        Sent are the messages of each to its neighbors, and their bytes without headers.
        """
        some = np.isin(np.arange(len(rounds)), agents)
        received = np.zeros((2, len(rounds)), dtype=np.int64)
        i, j = graph.edges
        for messages, payload in sent:
            for row, each in zip(received, (messages, payload), strict=True):
                row += np.bincount(i, each[j], minlength=len(row)).astype(np.int64)
        messages, payload = received
        own = cls(rounds, messages, payload + HEADER * messages)
        return cls(*(np.where(some, part, 0) for part in own))

    def plus(self, other: "Load", where: Bool[Array, " agents"] | None = None) -> "Load":
        """Add the load of another stage, to some of the agents alone."""
        some = True if where is None else where
        pairs = zip(self, other, strict=True)
        return Load(*(own + np.where(some, more, 0) for own, more in pairs))

    def relayed(self, hops: Int[Array, " agents"]) -> "Load":
        """Return the load where others pass on each message over so many hops."""
        return self._replace(rounds=self.rounds * np.maximum(hops, 1))


def count_flood(
    graph: CommunicationGraph,
    rounds: Int[Array, " agents"],
    made: Int[Array, " agents"],
    size: int | Int[Array, " agents"],
    speaks: Bool[Array, "agents rounds"] | None = None,
) -> Counts:
    """Count the messages in which agents pass on reports of all, and the bytes of the reports.

    An agent makes its report, of some bytes, after a round; −1 for none. It may speak after some
    rounds of the stage, for it has something else to say.
    """
    if speaks is None:
        speaks = np.zeros((len(made), int(rounds.max(initial=0))), dtype=bool)
    payload = np.zeros(len(made), dtype=np.int64)
    _pass_on(graph.hops, rounds, made, np.broadcast_to(size, made.shape), speaks, payload)
    return count_messages(rounds, speaks), payload


def count_messages(
    rounds: Int[Array, " agents"], speaks: Bool[Array, "agents rounds"]
) -> Int[Array, " agents"]:
    """Count the messages of agents that have something to say after these rounds."""
    return np.asarray((speaks & (np.arange(speaks.shape[1]) < rounds[:, None])).sum(axis=1))


def mark_changes(
    graph: CommunicationGraph, rounds: Int[Array, " agents"], changes: Events, first: int
) -> Bool[Array, "agents rounds"]:
    """Mark the rounds after which agents know of a later change than before.

    Changes are the agents that changed something, and in which round. Of a change in the round
    `first` all know at first.
    """
    speaks = np.zeros((len(rounds), int(rounds.max(initial=0))), dtype=bool)
    _mark_changes(graph.hops, rounds, *changes, first, speaks)
    return speaks


def fingerprint(table: Int[Array, "rows columns"] | Bool[Array, "rows columns"]) -> Array:
    """Return a number for each row, the same for equal rows alone, but for one case in 10¹⁹."""
    if table.dtype == bool:
        bits = np.packbits(table, axis=1)
        table = np.pad(bits, ((0, 0), (0, -bits.shape[1] % 8))).view(np.int64)
    return np.asarray(table @ _draw_weights(table.shape[1]))


@lru_cache(maxsize=8)
def _draw_weights(count: int) -> Int[Array, " count"]:
    return np.random.default_rng(count).integers(-(2**63), 2**63 - 1, count)


@compiled()
@no_type_check
def _pass_on(hops, rounds, made, size, speaks, payload):
    for j in range(len(rounds)):
        for a in range(len(rounds)):
            at = made[a] + hops[j, a]
            if made[a] >= 0 and at < rounds[j]:
                speaks[j, at] = True
                payload[j] += size[a]


@compiled()
@no_type_check
def _mark_changes(hops, rounds, agents, changed, first, speaks):
    latest = np.empty(speaks.shape[1], dtype=np.int64)
    for j in range(len(rounds)):
        latest[: rounds[j]] = first
        for k in range(len(agents)):
            at = changed[k] + hops[j, agents[k]]
            if at < rounds[j]:
                latest[at] = max(latest[at], changed[k])
        known = first
        for at in range(rounds[j]):
            speaks[j, at] = latest[at] > known
            known = max(known, latest[at])


def count_census(graph: CommunicationGraph) -> Counts:
    """Count the messages of a census, and the bytes of the eccentricities in them.

    An agent passes on, in the round after it has heard of them, those at each distance up to its
    eccentricity e, and after round e + 1 the largest eccentricity that it knows.
    """
    live = np.flatnonzero(graph.alive)
    learned = graph.eccentricity[live] + 1  # rounds after which agents know their own
    rises = mark_changes(graph, 2 * (graph.diameter + 1), (live, learned), 0).sum(axis=1)
    messages = np.where(graph.alive, 1 + graph.eccentricity + rises, 0)
    return messages, ECCENTRICITY * messages
