"""Parts of this system that recording, checking, figures and the command line use."""

from sato.connectivity.check.promises import PROMISES, check_run
from sato.connectivity.loop import simulate
from sato.connectivity.mission import Connectivity
from sato.connectivity.record import ConnectivityFrame, run_attributes
from sato.interfaces import MissionProgress, System, lazy


def describe_progress(mission: Connectivity, frame: ConnectivityFrame) -> MissionProgress:
    """Describe the time that has passed, and λ₂."""
    done, total = round(frame.time / mission.step), round(mission.duration / mission.step)
    stage = "connected" if frame.component.max() == 0 else "disconnected"
    return MissionProgress(stage, done, total, f"λ₂ = {frame.lambda2:.3g}")


SYSTEM = System(
    name="connectivity",
    frame=ConnectivityFrame,
    simulate=simulate,
    attributes=run_attributes,
    check=check_run,
    progress=describe_progress,
    figures=lazy("sato.connectivity.figures:make_figures"),
    promises=PROMISES,
    scene=lazy("sato.connectivity.scene:make_scene"),
)
