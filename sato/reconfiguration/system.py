"""Parts of this system that recording, checking, figures and the command line use."""

from problems.conic import Unsolved
from sato.auctions import OutOfTargets
from sato.interfaces import MissionProgress, System, lazy
from sato.reconfiguration import record
from sato.reconfiguration.check.promises import PROMISES, check_run
from sato.reconfiguration.loop import simulate
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import ReconfigurationFrame


def make_progress(mission: Reconfiguration, frame: ReconfigurationFrame) -> MissionProgress:
    """Count the steps of all legs; resets lengthen them."""
    steps = [leg.steps for leg in mission.legs]
    done = round(frame.time / mission.step)
    total = max(sum(steps), done + sum(steps[frame.leg_index + 1 :]))
    return MissionProgress(f"leg {frame.leg_index + 1} of {len(steps)}", done, total)


SYSTEM = System(
    name="reconfiguration",
    frame=ReconfigurationFrame,
    run_variables=record.ReconfigurationVariables,
    simulate=simulate,
    collect=record.collect_variables,
    attributes=record.collect_attributes,
    check=check_run,
    progress=make_progress,
    figures=lazy("sato.reconfiguration.figures:make_figures"),
    scene=lazy("sato.reconfiguration.scene:make_scene"),
    promises=PROMISES,
    stop_errors=(Unsolved, OutOfTargets),
)
