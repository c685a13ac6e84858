"""What recording, checking, drawing and the command line know of this system."""

from typing import TYPE_CHECKING

from problems.conic import Unsolved
from sato.auctions.vsdaa_init import OutOfTargets
from sato.interfaces import Animation, FigureFactories, MissionProgress, System
from sato.reconfiguration.check import check_run
from sato.reconfiguration.frame import ReconfigurationFrame
from sato.reconfiguration.loop import fly
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.record import VARIABLES, collect_attributes, stack_variables

if TYPE_CHECKING:
    import xarray


def make_progress(mission: Reconfiguration, frame: ReconfigurationFrame) -> MissionProgress:
    """The leg under way, and the steps of all; resets make them more."""
    steps = [leg.steps for leg in mission.legs]
    done = round(frame.time / mission.step)
    total = max(sum(steps), done + sum(steps[frame.leg + 1 :]))
    return MissionProgress(f"leg {frame.leg + 1} of {len(steps)}", done, total)


def _make_figures(data: "xarray.Dataset", mission: Reconfiguration) -> FigureFactories:
    from sato.reconfiguration.figures import make_figures

    return make_figures(data, mission)


def _make_animation(data: "xarray.Dataset", mission: Reconfiguration) -> Animation:
    from sato.reconfiguration.check import ReconfigurationRecord
    from sato.reconfiguration.figures.animation import SwarmAnimation

    return SwarmAnimation(ReconfigurationRecord.from_dataset(data, mission))


SYSTEM = System(
    name="reconfiguration",
    simulate=fly,
    stop_errors=(Unsolved, OutOfTargets),
    variable_definitions=VARIABLES,
    stack_variables=stack_variables,
    attributes=collect_attributes,
    check=check_run,
    progress=make_progress,
    figures=_make_figures,
    animation=_make_animation,
)
