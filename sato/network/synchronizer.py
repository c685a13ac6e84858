"""Synchronous rounds over a network that loses and delays messages [Awerbuch1985].

A decision is defined by synchronous rounds: in each, an agent acts on what all of its neighbors
sent in the round before. Where messages are lost or late, an agent repeats its last messages until
its neighbors have gone on, and acts in a round once it has all that were sent in the round before.
So it computes the same, only later. Every message says of which round it is, so that repeated ones
do no harm. One that waits for an agent that is lost waits until the time of the decision is over,
and keeps what it had.
"""

import numpy as np
from jaxtyping import Int
from numpy import ndarray as Array

from sato.network.channel import NEVER, Channel

Rounds = Int[Array, " agents"]


class Synchronizer:
    """Rounds of the network in which agents get through synchronous rounds."""

    def __init__(self, channel: Channel, stops: Rounds) -> None:
        """Begin; each agent stops in the round in which it falls silent, or its time is over."""
        self._channel, self._stops = channel, stops
        self._first_stop = int(stops.min(initial=NEVER))
        self._until = np.minimum(stops[channel.sender], stops[channel.receiver])
        self._edges = np.arange(len(channel.sender))
        self._place = np.full((len(stops), len(stops)), -1)
        self._place[channel.sender, channel.receiver] = self._edges
        self._heard = np.full((1, len(self._edges)), NEVER, dtype=np.int32)

    def _draw(self, rounds: int) -> None:
        """Find out when messages arrive that are repeated from a round on, up to so many rounds."""
        channel, known = self._channel, len(self._heard) - 1
        channel.extend(rounds)
        later = channel.by_round[known:]
        ahead = np.full((len(later) + 1, len(self._edges)), NEVER, dtype=np.int32)
        silent = self._stops[channel.sender]
        for k in range(len(later) - 1, -1, -1):
            np.minimum(later[k], ahead[k + 1], out=ahead[k])
            if known + k >= self._first_stop:
                ahead[k, silent <= known + k] = NEVER
        self._heard = np.vstack([np.minimum(self._heard[:-1], ahead[0]), ahead])

    def find_edges(self, sender: Int[Array, " k"], receiver: Int[Array, " k"]) -> Int[Array, " k"]:
        """Return the places of edges in the list."""
        return np.asarray(self._place[sender, receiver])

    def hear(self, sent: Rounds) -> Int[Array, " edges"]:
        """Return when each receiver has what its neighbor repeats from a round on."""
        asked = sent[self._channel.sender]
        while True:
            count = len(self._heard) - 1
            heard = self._heard[np.minimum(asked, count), self._edges]
            # A message that is repeated in a round that is not drawn yet may be heard sooner.
            is_open = (asked < self._until) & (heard > count) & (count < self._until)
            if not is_open.any():
                return np.asarray(heard)
            self._draw(count + 1)

    def advance(self, entered: Rounds, rounds: Int[Array, " agents"]) -> Rounds:
        """Return when each agent gets through so many synchronous rounds; NEVER if it does not.

        Each enters the first of them in a round of the network. All of a component have as many.
        """
        now = entered.copy()
        for count in range(int(rounds.max(initial=0))):
            after = now + 1
            np.maximum.at(after, self._channel.receiver, self.hear(now))
            after = np.where(after < self._stops, after, NEVER)
            now = np.where(count < rounds, after, now)
            if (now == NEVER).all():
                break
        return now
