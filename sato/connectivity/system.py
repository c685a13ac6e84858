"""What recording, checking, drawing and the command line know of this system."""

from typing import TYPE_CHECKING

from sato.connectivity.check import check_run
from sato.connectivity.loop import ConnectivityFrame, simulate
from sato.connectivity.mission import Connectivity
from sato.connectivity.record import VARIABLES, run_attributes, stack_variables
from sato.interfaces import FigureFactories, MissionProgress, System

if TYPE_CHECKING:
    import xarray


def describe_progress(mission: Connectivity, frame: ConnectivityFrame) -> MissionProgress:
    """How much time has passed, and λ₂."""
    done, total = round(frame.time / mission.step), round(mission.duration / mission.step)
    stage = "the swarm is together" if frame.component.max() == 0 else "the swarm has split"
    return MissionProgress(stage, done, total, f"λ₂ = {frame.lambda2:.3g}")


def _load_figures(data: "xarray.Dataset", mission: Connectivity) -> FigureFactories:
    from sato.connectivity.figures import make_figures

    return make_figures(data, mission)


SYSTEM = System(
    name="connectivity",
    simulate=simulate,
    stop_errors=(),
    variable_definitions=VARIABLES,
    stack_variables=stack_variables,
    attributes=run_attributes,
    check=check_run,
    progress=describe_progress,
    figures=_load_figures,
)
