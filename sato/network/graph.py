"""The communication graph of a swarm at one instant."""

from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, no_type_check

import numpy as np
import scipy
from annotated_types import Gt
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.doors import MAY_BE_INFINITE, MAY_BE_NAN, checked
from dynamics.inputs import InputError
from problems.kernels import compiled

ROUNDING = 1e-9  # relative, of the radius in which neighbors are looked for
FAR = 2**30  # hops between two components
WORD = 64  # bits

Pairs = tuple[Int[Array, " pairs"], Int[Array, " pairs"]]  # both of each


@checked
@dataclass(frozen=True, eq=False)
class CommunicationGraph:
    """Undirected graph of the agents that exchange messages.

    Raises:
        ValueError: The graph is directed, has an edge from an agent to itself or to one that is
            not alive, or not as many rows and columns as there are agents.
    """

    adjacency: Bool[Array, "agents agents"]
    alive: Bool[Array, " agents"]

    def __post_init__(self) -> None:
        i, j = self.edges
        is_directed, is_lost = self.adjacency[j, i] == 0, self.alive[i] == 0
        if is_directed.any():
            k = is_directed.argmax()
            raise ValueError(f"agent {i[k]} hears agent {j[k]} but not the other way round")
        if (i == j).any():
            raise ValueError(f"agent {i[i == j][0]} is its own neighbor")
        if is_lost.any():
            raise ValueError(f"agent {i[is_lost][0]} is not alive but has neighbors")

    @property
    def array_sizes(self) -> dict[str, int]:
        """Sizes of the axes of arrays, by name."""
        return {"agents": len(self.alive)}

    @classmethod
    def from_positions(
        cls,
        position: Annotated[Float[Array, "agents d"], MAY_BE_NAN],
        radius: Annotated[float, Gt(0), MAY_BE_INFINITE],
        alive: Bool[Array, " agents"],
    ) -> "CommunicationGraph":
        """Connect all live agents that are at most a radius apart, by their positions [m].

        One whose position is not finite is near to none.
        """
        adjacency = np.zeros((len(alive), len(alive)), dtype=bool)
        live = np.flatnonzero(alive & np.isfinite(position).all(axis=1))
        tree = scipy.spatial.cKDTree(position[live])
        i, j = live[tree.query_pairs(radius * (1 + ROUNDING), output_type="ndarray")].T
        in_range = ((position[i] - position[j]) ** 2).sum(axis=1) <= radius**2
        i, j = i[in_range], j[in_range]
        adjacency[i, j] = adjacency[j, i] = True
        return cls(adjacency, alive.copy())

    def subgraph(self, members: Bool[Array, " agents"]) -> "CommunicationGraph":
        """Keep these agents alone; all others count as not alive."""
        kept = self.alive & members
        if np.array_equal(kept, self.alive):
            return self
        return CommunicationGraph(self.adjacency & kept & kept[:, None], kept)

    @cached_property
    def relayed(self) -> "CommunicationGraph":
        """Graph in which all of a component exchange messages, as others pass them on."""
        beside = self.alive & (self.component[:, None] == self.component)
        return CommunicationGraph(beside & ~np.eye(len(beside), dtype=bool), self.alive)

    @cached_property
    def neighbors(self) -> tuple[Int[Array, " _"], ...]:
        """Neighbors of each agent, in ascending order."""
        return tuple(np.flatnonzero(row) for row in self.adjacency)

    @cached_property
    def edges(self) -> tuple[Int[Array, " edges"], Int[Array, " edges"]]:
        """Both agents of each edge, in order; an edge each way."""
        i, j = np.nonzero(self.adjacency)
        return i, j

    @cached_property
    def pairs(self) -> Pairs:
        """Both agents of each pair of neighbors, the one of lower number first, in order."""
        i, j = self.edges
        return i[i < j], j[i < j]

    def pairs_among(self, agents: Int[Array, " some"]) -> Pairs:
        """Return the pairs of neighbors among some agents, by their places in the list."""
        most = len(self.alive) - 1
        if len(agents) and not 0 <= np.min(agents) <= np.max(agents) <= most:
            raise InputError("agents", f"must be from 0 to {most}, got {np.unique(agents)}")
        place = np.full(len(self.alive), -1)
        place[agents] = np.arange(len(agents))
        i, j = (place[each] for each in self.pairs)
        is_among = (i >= 0) & (j >= 0)
        i, j = np.sort([i[is_among], j[is_among]], axis=0)
        order = np.lexsort((j, i))
        return i[order], j[order]

    @cached_property
    def component(self) -> Int[Array, " agents"]:
        """Component of each agent, numbered by its lowest member; −1 where not alive."""
        return label_components(self.adjacency, self.alive)

    @cached_property
    def component_sizes(self) -> Int[Array, " agents"]:
        """Number of agents in each agent's component; 0 where not alive."""
        size = np.bincount(self.component[self.alive], minlength=1)
        return np.where(self.alive, size[self.component], 0)

    @cached_property
    def hops(self) -> Int[Array, "agents agents"]:
        """Length of a shortest path between two agents; FAR between components."""
        hops = np.full(self.adjacency.shape, FAR, dtype=np.int32)
        np.fill_diagonal(hops, 0)
        i, neighbor = self.edges
        first = np.searchsorted(i, np.arange(len(hops) + 1))  # of each agent, in the list of all
        _count_hops(first, neighbor, self.alive, hops)
        return hops

    @cached_property
    def eccentricity(self) -> Int[Array, " agents"]:
        """Hops to the farthest agent of each one's component; 0 where not alive."""
        near = np.where(self.hops < FAR, self.hops, 0)
        return np.asarray(near.max(axis=1, initial=0), dtype=np.int64)

    @cached_property
    def diameter(self) -> Int[Array, " agents"]:
        """Diameter of each agent's component; 0 for an agent alone.

        The batched equivalent of `Census` in `network.flooding`.
        """
        return self.component_max(self.eccentricity)

    def component_max(self, values: Int[Array, "agents ..."]) -> Int[Array, "agents ..."]:
        """Take the largest value in each agent's component; agents not alive keep their own.

        The batched equivalent of a flood with `max`.
        """
        result = values.copy()
        largest = np.full(values.shape, np.iinfo(np.int64).min)
        np.maximum.at(largest, self.component[self.alive], values[self.alive])
        result[self.alive] = largest[self.component[self.alive]]
        return result

    def component_any(self, is_true: Bool[Array, "agents ..."]) -> Bool[Array, "agents ..."]:
        """Return True for all agents in whose components one is; agents not alive keep their own.

        The batched equivalent of a flood with `or`.
        """
        return self.component_max(is_true.astype(np.int64)).astype(bool)


def label_components(adjacency: Bool[Array, "n n"], alive: Bool[Array, " n"]) -> Int[Array, " n"]:
    """Label the connected components in order of their lowest member; −1 where not alive.

    A breadth-first search reads each row once, which for a few agents takes a tenth of the time
    that SciPy needs to make a sparse matrix.
    """
    labels = np.full(len(alive), -1)
    component = 0
    for lowest in np.flatnonzero(alive):
        if labels[lowest] >= 0:
            continue
        reached = np.array([lowest])
        while len(reached):
            labels[reached] = component
            reached = np.flatnonzero(adjacency[reached].any(axis=0) & alive & (labels < 0))
        component += 1
    return labels


def canonicalize_labels(labels: Int[Array, " n"]) -> Int[Array, " n"]:
    """Renumber labels in order of their first occurrence; negative ones become −1."""
    numbers = np.full(len(labels), -1)
    live = labels >= 0
    if live.any():
        _, first, inverse = np.unique(labels[live], return_index=True, return_inverse=True)
        numbers[live] = np.argsort(np.argsort(first))[inverse]
    return numbers


@compiled()
@no_type_check
def _count_hops(first, neighbor, alive, hops):
    # In each round all agents pass on, as bits, the numbers of those that they have heard of last.
    agents = len(alive)
    words = (agents + WORD - 1) // WORD
    place = np.zeros(67, dtype=np.int64)  # of a bit, by its value modulo 67
    for k in range(WORD):
        place[(np.uint64(1) << np.uint64(k)) % np.uint64(67)] = k
    known = np.zeros((agents, words), dtype=np.uint64)
    for i in range(agents):
        if alive[i]:
            known[i, i // WORD] |= np.uint64(1) << np.uint64(i % WORD)
    last, heard = known.copy(), np.zeros_like(known)
    is_new, round = alive.copy(), 0
    while is_new.any():
        round += 1
        heard[:] = 0
        for i in range(agents):
            for k in range(first[i], first[i + 1]):
                if is_new[neighbor[k]]:
                    for w in range(words):
                        heard[i, w] |= last[neighbor[k], w]
        for i in range(agents):
            is_new[i] = False
            for w in range(words):
                bits = heard[i, w] & ~known[i, w]
                last[i, w] = bits
                known[i, w] |= bits
                is_new[i] |= bits != 0
                while bits:
                    rest = bits & (bits - np.uint64(1))
                    hops[i, w * WORD + place[(bits ^ rest) % np.uint64(67)]] = round
                    bits = rest
