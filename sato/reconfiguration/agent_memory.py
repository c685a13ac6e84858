"""Memory of one agent between two calls."""

from typing import NamedTuple

from jaxtyping import Float, Int
from numpy import ndarray as Array

from sato.reconfiguration import estimator
from sato.reconfiguration.agent_decision import Decision
from sato.reconfiguration.agent_network import NetworkDecision
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.plan import Plans
from sato.reconfiguration.state import AgentMemory, Event
from sato.reconfiguration.stopping import Commitments


class FlightMemory(NamedTuple):
    """All that an agent remembers between two calls, besides its mission and its number."""

    leg: Leg  # under way
    believed: Int[Array, " rows"]  # number of agents it believes in
    memory: AgentMemory  # the row of its number counts
    plans: Plans  # empty, or its own
    committed: Commitments  # empty, or its own
    estimate: estimator.Estimate  # of its state
    leg_start: int | None = None  # instant at which the leg began; None before
    instant: int | None = None  # last control instant; None before the first
    spent: float = 0.0  # fuel [m/s], or energy [m²/s³]
    control: Float[Array, " d"] | None = None  # held now [m/s²]
    decision: Decision | None = None  # of the last instant, where messages are never lost
    under_way: NetworkDecision | None = None  # decision over other networks
    is_calling: bool = False  # for an auction, when it decides next
    next_leg: Leg | None = None  # that begins with the next decision
    events: tuple[Event, ...] = ()  # of the decision that it took up last
    seen_count: int = 0  # things that it has seen
    decided_count: int = 0  # and those before its last decision began
    mission: int = 0  # checksum
    heard: frozenset[int] | None = None  # agents in the last round of an instant; None in the first

    @property
    def last_decision(self) -> Decision | None:
        """The decision under way, or made last."""
        return self.under_way.decision if self.under_way else self.decision

    def take_up(self, decision: Decision) -> "FlightMemory":
        """Take up what the agent has decided."""
        return self._replace(
            memory=decision.context.memory,
            plans=decision.plans,
            committed=decision.committed,
            events=decision.events,
        )
