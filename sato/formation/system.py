"""What recording, checking, drawing and the command line know of this system."""

from typing import TYPE_CHECKING

from sato.formation.check import check_run
from sato.formation.loop import FormationFrame, simulate
from sato.formation.mission import Formation
from sato.formation.record import VARIABLES, run_attributes, stack_variables
from sato.interfaces import FigureFactories, MissionProgress, System

if TYPE_CHECKING:
    import xarray


def describe_progress(mission: Formation, frame: FormationFrame) -> MissionProgress:
    """The leg under way, and the time that is left at most."""
    done = round(frame.time / mission.frame_period)
    total = max(done, round(mission.supervision.time_limit / mission.frame_period))
    stage = f"leg {frame.leg + 1} of {len(mission.gains)}"
    return MissionProgress(stage, done, total, frame.phase.value)


def _load_figures(data: "xarray.Dataset", mission: Formation) -> FigureFactories:
    from sato.formation.figures import make_figures

    return make_figures(data, mission)


SYSTEM = System(
    name="formation",
    simulate=simulate,
    stop_errors=(),
    variable_definitions=VARIABLES,
    stack_variables=stack_variables,
    attributes=run_attributes,
    check=check_run,
    progress=describe_progress,
    figures=_load_figures,
)
