"""What recording, checking, drawing and the command line know of this system."""

from typing import TYPE_CHECKING

from sato.formation.check import examine
from sato.formation.flight import Frame, fly
from sato.formation.log import MEANING, attributes, variables
from sato.formation.mission import FormationFlight
from sato.system import Figures, Passage, System

if TYPE_CHECKING:
    import xarray


def passage(mission: FormationFlight, frame: Frame) -> Passage:
    """The leg under way, and the time that is left at most."""
    done = round(frame.time / mission.sample)
    total = max(done, round(mission.protocol.limit / mission.sample))
    stage = f"leg {frame.leg + 1} of {len(mission.shapes)}"
    return Passage(stage, done, total, frame.phase.value)


def _figures(data: "xarray.Dataset", mission: FormationFlight) -> Figures:
    from sato.formation.plots import figures

    return figures(data, mission)


SYSTEM = System(
    name="formation",
    fly=fly,
    outcomes=(),
    meaning=MEANING,
    variables=variables,
    attributes=attributes,
    judge=examine,
    passage=passage,
    figures=_figures,
)
