"""Runs of frames that a test made by hand."""

from sato.record import build_dataset, initial_summary
from sato.runs import Run


def record_run(system, frames, mission, definition=None, **attributes):
    """Record frames as `sato.run` does.

    Args:
        system: System of the frames.
        frames: Frames in the order of time.
        mission: Drawn mission that they are of.
        definition: Mission before it was drawn, where the test loads or checks the run.
        attributes: Attributes of the run other than those below.
    """
    about = {"name": "by hand", "seed": 3, "version": "0", "wall_s": 1.0, "peak_memory_mib": 1.0}
    text = "" if definition is None else definition.to_toml()
    data = build_dataset(system, list(frames), mission, scenario=text, **(about | attributes))
    return Run(data, initial_summary(data.attrs), definition)
