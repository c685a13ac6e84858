"""One agent in synchronous rounds over a network that loses and delays messages [Awerbuch1985].

`SynchronousAgent` goes through the rounds of anything that acts on a message of each neighbor:
`Census`, `Flood`, a bidder, a whole decision. Each round of the network it sends one packet, the
same until it goes on, and acts once, on all packets that have arrived, of whatever round:

- It repeats its first message at first. Its neighbors are the agents whose first messages it hears
  within some rounds.
- It acts in a synchronous round once it has the messages of all neighbors of the round before.
  So neighbors are never more than one round apart.
- A packet has the messages of the last two rounds, since a neighbor may still be a round behind.

`Synchronizer` is the batched equivalent.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from dynamics.doors import checked
from sato.scenario.definition import Count


@checked
class Packet(NamedTuple):
    """All that an agent sends in a round of the network."""

    sender: Count
    instant: Count  # at which what is decided began
    round: Count  # last synchronous round in which the sender has acted; 0 before the first
    contents: tuple[Any, ...]  # message of that round, and of the one before


class SynchronousAgent(NamedTuple):
    """Memory of one agent in synchronous rounds."""

    number: int
    instant: int
    stage: Any  # has a `message`, and `is_finished` once it acts no more by `update(inbox)`
    discovery_rounds: int  # of the network, in which it listens for neighbors; 1 at least
    last_network_round: int  # in which it may act, of those since it began
    network_round: int = 0
    round: int = 0
    previous: tuple[Any, ...] = ()  # message of the round before; empty in the first
    heard: Mapping[tuple[int, int], Any] = {}  # messages by round, from the own on, and sender
    neighbors: frozenset[int] = frozenset()  # heard so far

    @property
    def packet(self) -> Packet:
        """Packet to send in this round of the network."""
        return Packet(self.number, self.instant, self.round, (self.stage.message, *self.previous))

    @property
    def is_finished(self) -> bool:
        """True once the agent has acted in the last synchronous round."""
        return bool(self.stage.is_finished)

    @property
    def has_expired(self) -> bool:
        """True where it has no time left to act."""
        return self.network_round >= self.last_network_round

    def update(self, inbox: Sequence[Packet]) -> "SynchronousAgent":
        """Take in the packets that have arrived, and act once if that is possible.

        Packets of other instants, and of agents that are no neighbors, are ignored.
        """
        if self.has_expired:
            return self
        agent = self._take_in(inbox)._replace(network_round=self.network_round + 1)
        is_discovering = agent.network_round < agent.discovery_rounds
        waits = any((agent.round, sender) not in agent.heard for sender in agent.neighbors)
        return agent if agent.is_finished or is_discovering or waits else agent._act()

    def _take_in(self, inbox: Sequence[Packet]) -> "SynchronousAgent":
        heard, neighbors = dict(self.heard), self.neighbors
        for sender, instant, round, contents in inbox:
            if instant != self.instant:
                continue
            sent = {round - n: content for n, content in enumerate(contents)}
            if 0 in sent and self.network_round < self.discovery_rounds:
                neighbors |= {sender}
            if sender in neighbors:
                heard |= {(v, sender): sent[v] for v in sent if v >= self.round}
        return self._replace(heard=heard, neighbors=neighbors)

    def _act(self) -> "SynchronousAgent":
        """Act on the messages of all neighbors, by the number of the sender."""
        inbox = [self.heard[self.round, sender] for sender in sorted(self.neighbors)]
        return self._replace(
            stage=self.stage.update(inbox),
            round=self.round + 1,
            previous=(self.stage.message,),
            heard={place: sent for place, sent in self.heard.items() if place[0] > self.round},
        )
