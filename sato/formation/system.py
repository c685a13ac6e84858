"""Parts of this system that recording, checking, figures and the command line use."""

from sato.formation.check.promises import PROMISES, check_run
from sato.formation.loop import FormationFrame, simulate
from sato.formation.mission import Formation
from sato.formation.record import FormationVariables, collect_attributes, collect_variables
from sato.interfaces import MissionProgress, System, lazy


def make_progress(mission: Formation, frame: FormationFrame) -> MissionProgress:
    """Count the frames until the time limit; a flight may end earlier."""
    done = round(frame.time / mission.frame_period)
    total = max(done, round(mission.supervision.time_limit / mission.frame_period))
    stage = f"leg {frame.leg_index + 1} of {len(mission.legs)}"
    return MissionProgress(stage, done, total, frame.phase.value)


SYSTEM = System(
    name="formation",
    frame=FormationFrame,
    run_variables=FormationVariables,
    simulate=simulate,
    collect=collect_variables,
    attributes=collect_attributes,
    check=check_run,
    progress=make_progress,
    figures=lazy("sato.formation.figures:make_figures"),
    promises=PROMISES,
    scene=lazy("sato.formation.scene:make_scene"),
)
