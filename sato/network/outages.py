"""Outages of the links between all agents of a small swarm, round by round."""

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from sato.network.channel import Outages
from sato.network.link import Link


class PairOutages:
    """Pairs of agents that do not hear each other, of all, in one round after another.

    Nothing is drawn where a link has no outages.
    """

    def __init__(self, link: Link, agents: int, rng: np.random.Generator) -> None:
        """Draw which pairs do not hear each other at first.

        The generator draws all later rounds too. A round takes the time that the link says.
        """
        self._pairs = np.triu_indices(agents, 1)
        self._outages = Outages(link, len(self._pairs[0]), rng)
        self._ahead = np.zeros((0, agents, agents), dtype=bool)  # drawn, and still to come

    def look_ahead(self, rounds: int) -> Bool[Array, "rounds n n"]:
        """Return which agents do not hear which in the next rounds."""
        missing = rounds - len(self._ahead)
        if missing > 0:
            i, j = self._pairs
            drawn = np.zeros((missing, *self._ahead.shape[1:]), dtype=bool)
            drawn[:, i, j] = drawn[:, j, i] = self._outages.draw(missing).T
            self._ahead = np.concatenate([self._ahead, drawn])
        return self._ahead[:rounds]

    def advance(self) -> Bool[Array, "n n"]:
        """Return the same of the next round, which is then over."""
        now, self._ahead = self.look_ahead(1), self._ahead[1:]
        return np.asarray(now[0])
