"""Messages between neighbors in rounds of which some are lost or late, drawn beforehand."""

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray as Array

from sato.network.graph import CommunicationGraph
from sato.network.link import Link

NEVER = 2**30  # round of what does not happen
BLOCK = 128  # rounds that are drawn at once


class Outages:
    """Outages of several links, round by round.

    An outage takes 1 to `outage_rounds` rounds, all equally likely; the times between two are
    geometrically distributed.
    """

    def __init__(self, link: Link, count: int, rng: np.random.Generator) -> None:
        """Draw which links are down at first; the generator draws all later rounds too."""
        self._rng, self._most, self._left = rng, link.outage_rounds, np.zeros(count, dtype=int)
        if link.outage_share:
            self._start = 1 / link.mean_up_rounds
            # At a random time a longer outage is more likely to be met.
            lengths = np.arange(1, self._most + 1)
            first = rng.choice(lengths, count, p=lengths / lengths.sum())
            is_down = rng.random(count) < link.outage_share
            self._left = np.where(is_down, rng.integers(1, first + 1), 0)

    def draw(self, rounds: int) -> Bool[Array, "links rounds"]:
        """Return which links are down in the next rounds."""
        shape = rounds, len(self._left)
        is_down = np.zeros(shape, dtype=bool)
        if self._most:
            begins = self._rng.random(shape, dtype=np.float32) < self._start
            length = self._rng.integers(1, self._most + 1, shape, dtype=np.int32)
            for k in range(rounds):
                is_down[k] = self._left > 0
                begun = np.where(begins[k], length[k], 0)
                self._left = np.where(is_down[k], self._left - 1, begun)
        return is_down.T


class Channel:
    """Rounds in which the messages of neighbors arrive.

    Edges are listed by sender, then receiver. A message that is sent in round s is heard before
    the receiver acts in round `by_round[s, edge]`, s + 1 at the soonest; NEVER where it is lost.
    Losses and delays are of each message and receiver; outages of a link, in both directions.
    """

    def __init__(self, link: Link, graph: CommunicationGraph, rng: np.random.Generator) -> None:
        """Prepare to draw, with nothing drawn yet, from a generator of this channel alone."""
        self._link, self._rng = link, rng
        self.sender, self.receiver = np.nonzero(graph.adjacency)
        self.by_round: Int[Array, "rounds edges"] = np.zeros((0, len(self.sender)), dtype=np.int32)
        i, j = graph.pairs
        place = np.full(graph.adjacency.shape, -1)
        place[i, j] = place[j, i] = np.arange(len(i))
        self._pair = place[self.sender, self.receiver]
        self._outages = Outages(link, len(i), rng)

    def extend(self, rounds: int) -> None:
        """Draw so many rounds, or more."""
        blocks, link = [self.by_round], self._link
        loss = np.float32(link.loss_probability)
        share = np.float32((link.late + 1) / (1 - link.loss_probability))
        for first in range(len(self.by_round), rounds, BLOCK):
            block = np.empty((BLOCK, len(self.sender)), dtype=np.int32)
            block[:] = np.arange(first + 1, first + BLOCK + 1)[:, None]
            if link.late or link.loss_probability:
                drawn = self._rng.random(block.shape, dtype=np.float32)
                is_lost = drawn < loss
                if link.late:
                    drawn -= loss
                    drawn *= share
                    block += np.minimum(drawn.astype(np.int32), link.late)
                block[is_lost] = NEVER
            if link.outage_share:
                block[self._outages.draw(BLOCK).T[:, self._pair]] = NEVER
            blocks.append(block)
        if len(blocks) > 1:
            self.by_round = np.vstack(blocks)
