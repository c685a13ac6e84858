"""What recording, checking, drawing and the command line know of this system."""

from typing import TYPE_CHECKING

from sato.connectivity.check import examine
from sato.connectivity.flight import Frame, fly
from sato.connectivity.log import MEANING, attributes, variables
from sato.connectivity.mission import ConnectivityFlight
from sato.system import Figures, Passage, System

if TYPE_CHECKING:
    import xarray


def passage(mission: ConnectivityFlight, frame: Frame) -> Passage:
    """How much time has passed, and λ₂."""
    done, total = round(frame.time / mission.step), round(mission.duration / mission.step)
    stage = "the swarm is together" if frame.component.max() == 0 else "the swarm has split"
    return Passage(stage, done, total, f"λ₂ = {frame.lambda2:.3g}")


def _figures(data: "xarray.Dataset", mission: ConnectivityFlight) -> Figures:
    from sato.connectivity.plots import figures

    return figures(data, mission)


SYSTEM = System(
    name="connectivity",
    fly=fly,
    outcomes=(),
    meaning=MEANING,
    variables=variables,
    attributes=attributes,
    judge=examine,
    passage=passage,
    figures=_figures,
)
