"""Decisions of one agent over a network that takes time, loses and delays messages.

A decision goes through its synchronous rounds as far as messages get through. An agent that has
chosen commits once that is clear of all that its neighbors may go on flying, and tells them; those
that wait for it may follow. `network_decision` computes the same for all agents at once.
"""

from collections.abc import Sequence
from typing import NamedTuple

from sato.network.channel import NEVER
from sato.network.synchronous_agent import SynchronousAgent
from sato.reconfiguration.agent_decision import Decision
from sato.reconfiguration.agent_inputs import AgentPacket
from sato.reconfiguration.mission import Reconfiguration


class NetworkDecision(NamedTuple):
    """Memory of an agent while it decides over a network."""

    agent: SynchronousAgent
    committed: frozenset[int] = frozenset()  # agents that are known to commit

    @classmethod
    def begin(cls, mission: Reconfiguration, instant: int, decision: Decision) -> "NetworkDecision":
        """Begin, in round 0 of the network."""
        last = mission.decision_rounds - 1 if mission.lag_steps else NEVER
        rounds = mission.link.discovery_rounds, last
        return cls(SynchronousAgent(decision.number, instant, decision, *rounds))

    @property
    def decision(self) -> Decision:
        """The decision under way."""
        decision: Decision = self.agent.stage
        return decision

    @property
    def commits(self) -> bool:
        """True once the agent commits to what it has chosen."""
        return self.decision.has_decided and self.decision.waits <= self.committed

    @property
    def is_finished(self) -> bool:
        """True once the agent commits, or knows that nothing is due."""
        return self.commits or (self.decision.is_finished and not self.decision.has_decided)

    @property
    def message(self) -> AgentPacket:
        """Packet to send in this round."""
        return AgentPacket(self.agent.packet, self.commits)

    def update(self, inbox: Sequence[AgentPacket]) -> "NetworkDecision":
        """Act on all packets that have arrived in a round of the network."""
        if self.agent.has_expired:
            return self
        current = [each for each in inbox if each.packet.instant == self.agent.instant]
        committed = self.committed.union(each.sender for each in current if each.commits)
        return NetworkDecision(self.agent.update([each.packet for each in current]), committed)
