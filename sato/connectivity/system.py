"""Parts of this system that recording, checking, figures and the command line use."""

from sato.connectivity.check import check_run
from sato.connectivity.loop import ConnectivityFrame, simulate
from sato.connectivity.mission import Connectivity
from sato.connectivity.record import ConnectivityVariables, collect_variables, run_attributes
from sato.interfaces import MissionProgress, System, lazy


def describe_progress(mission: Connectivity, frame: ConnectivityFrame) -> MissionProgress:
    """How much time has passed, and λ₂."""
    done, total = round(frame.time / mission.step), round(mission.duration / mission.step)
    stage = "the swarm is together" if frame.component.max() == 0 else "the swarm has split"
    return MissionProgress(stage, done, total, f"λ₂ = {frame.lambda2:.3g}")


SYSTEM = System(
    name="connectivity",
    frame=ConnectivityFrame,
    run_variables=ConnectivityVariables,
    simulate=simulate,
    collect=collect_variables,
    attributes=run_attributes,
    check=check_run,
    progress=describe_progress,
    figures=lazy("sato.connectivity.figures:make_figures"),
)
