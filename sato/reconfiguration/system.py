"""What recording, checking, drawing and the command line know of this system."""

from typing import TYPE_CHECKING

from problems.conic import Unsolved
from sato.reconfiguration.check import examine
from sato.reconfiguration.flight import fly
from sato.reconfiguration.frame import Frame
from sato.reconfiguration.log import MEANING, attributes, variables
from sato.reconfiguration.mission import Reconfiguration
from sato.system import Figures, Passage, Scene, System
from sato.vsdaa import OutOfTargets

if TYPE_CHECKING:
    import xarray


def passage(mission: Reconfiguration, frame: Frame) -> Passage:
    """The leg under way, and the steps of all; resets make them more."""
    steps = [leg.steps for leg in mission.legs]
    done = round(frame.time / mission.step)
    total = max(sum(steps), done + sum(steps[frame.leg + 1 :]))
    return Passage(f"leg {frame.leg + 1} of {len(steps)}", done, total)


def _figures(data: "xarray.Dataset", mission: Reconfiguration) -> Figures:
    from sato.reconfiguration.plots import figures

    return figures(data, mission)


def _scene(data: "xarray.Dataset", mission: Reconfiguration) -> Scene:
    from sato.reconfiguration.check import Evidence
    from sato.reconfiguration.plots.film import Film

    return Film(Evidence.of(data, mission))


SYSTEM = System(
    name="reconfiguration",
    fly=fly,
    outcomes=(Unsolved, OutOfTargets),
    meaning=MEANING,
    variables=variables,
    attributes=attributes,
    judge=examine,
    passage=passage,
    figures=_figures,
    scene=_scene,
)
