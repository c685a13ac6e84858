"""What there is to decide with at an instant."""

from typing import NamedTuple

from jaxtyping import Float
from numpy import ndarray as Array

from dynamics import Steps, hold
from sato.network import Network
from sato.reconfiguration.mission import Leg, Reconfiguration


class Moment(NamedTuple):
    """An instant of a leg, for those networks that decide at it."""

    mission: Reconfiguration
    leg: Leg
    network: Network  # of those who decide: nobody else is alive in it
    state: Float[Array, "agents n"]  # what each agent knows of its own
    step: int  # since the start of the leg
    time: float  # since the start of the flight [s]

    def steps_left(self, clock: int) -> Steps:
        """The steps that remain on a clock."""
        return hold(self.mission.model, self.mission.step, self.leg.steps - clock, self.time)
