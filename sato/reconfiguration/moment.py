"""What there is to decide with at an instant."""

from typing import NamedTuple

from jaxtyping import Float
from numpy import ndarray as Array

from dynamics import DiscreteModel, discretize_zoh
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.mission import Leg, Reconfiguration


class DecisionContext(NamedTuple):
    """An instant of a leg, for those networks that decide at it."""

    mission: Reconfiguration
    leg: Leg
    graph: CommunicationGraph  # of those who decide: nobody else is alive in it
    state: Float[Array, "agents n"]  # what each agent knows of its own
    step_index: int  # since the start of the leg
    time: float  # since the start of the flight [s]

    def remaining_model(self, clock: int) -> DiscreteModel:
        """The steps that remain on a clock."""
        return discretize_zoh(
            self.mission.linear_model, self.mission.step, self.leg.steps - clock, self.time
        )
