"""Messages between neighbors in rounds of which some are lost or late, drawn beforehand."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray as Array

from sato.network.graph import CommunicationGraph
from sato.network.link import Link

NEVER = 2**30  # round of what does not happen


@dataclass(frozen=True, eq=False)
class Channel:
    """Rounds in which the messages of neighbors arrive.

    Edges are listed by sender, then receiver. A message that is sent in round s is heard before
    the receiver acts in round `arrival[edge, s]`, s + 1 at the soonest; NEVER where it is lost.
    """

    sender: Int[Array, " edges"]
    receiver: Int[Array, " edges"]
    arrival: Int[Array, "edges rounds"]

    @classmethod
    def draw(
        cls, link: Link, graph: CommunicationGraph, rounds: int, rng: np.random.Generator
    ) -> "Channel":
        """Draw losses, delays and failures.

        A link fails in both directions, for 1 to `outage_rounds` rounds, all equally likely.
        Between two failures are geometrically distributed times. Losses and delays are of each
        message and receiver.

        Args:
            link: Probabilities.
            graph: Agents that hear each other.
            rounds: Number of rounds.
            rng: Generator.
        """
        sender, receiver = np.nonzero(graph.adjacency)
        shape = len(sender), rounds
        arrival = np.broadcast_to(np.arange(1, rounds + 1, dtype=np.int32), shape).copy()
        if link.late:
            arrival += rng.integers(0, link.late + 1, shape, dtype=np.int32)
        if link.loss_probability:
            arrival[rng.random(shape) < link.loss_probability] = NEVER
        if link.outage_share:
            i, j = graph.pairs
            place = np.full(graph.adjacency.shape, -1)
            place[i, j] = place[j, i] = np.arange(len(i))
            arrival[_draw_failures(link, len(i), rounds, rng)[place[sender, receiver]]] = NEVER
        return cls(sender, receiver, arrival)


def _draw_failures(
    link: Link, pairs: int, rounds: int, rng: np.random.Generator
) -> Bool[Array, "pairs rounds"]:
    """Draw in which rounds each pair hears nothing."""
    change = np.zeros((pairs, rounds + 1), dtype=np.int8)
    most, up = link.outage_rounds, link.mean_up_rounds
    # At a random time a link fails with the share; a longer failure is more likely to be met.
    lengths = np.arange(1, most + 1)
    first = rng.choice(lengths, pairs, p=lengths / lengths.sum())
    left = np.minimum(rng.integers(1, first + 1), rounds)
    fails = rng.random(pairs) < link.outage_share
    now = np.where(fails, left, 0)
    change[fails, 0] += 1
    change[np.flatnonzero(fails), now[fails]] -= 1
    while (now < rounds).any():
        begin = np.minimum(now + rng.geometric(1 / up, pairs), rounds)
        now = np.minimum(begin + rng.integers(1, most + 1, pairs), rounds)
        np.add.at(change, (np.arange(pairs), begin), 1)
        np.add.at(change, (np.arange(pairs), now), -1)
    return np.asarray(change[:, :rounds].cumsum(axis=1) > 0)
