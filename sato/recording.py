"""Recording of a run for the viewer Rerun, whose package is an extra."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from sato.atomic import replace_atomically
from sato.figures.style import BLUE, GRAY, LIGHT_GRAY
from sato.scene import ALIVE, LOST, SwarmScene, list_links, pad_to_space

TIMELINE = "time"


def write_recording(scene: SwarmScene, name: str, path: Path) -> Path:
    """Write vehicles, targets, links, obstacles, curves and events over time.

    Args:
        scene: Scene of the run.
        name: Name of the scenario.
        path: File to write, by custom with the ending .rrd.

    Returns:
        The path.
    """
    import rerun

    with replace_atomically(path) as new, rerun.RecordingStream(f"sato {name}") as recording:
        recording.save(new)
        for k, time in enumerate(scene.time):
            recording.set_time(TIMELINE, duration=float(time))
            _log_instant(rerun, recording, scene, k)
        for event in scene.events:
            recording.set_time(TIMELINE, duration=float(event["time"]))
            agents = ", ".join(map(str, event["agents"]))
            recording.log("events", rerun.TextLog(f"{event['kind']}: {agents}"))
        recording.flush()
    return path


def _log_instant(rerun: Any, recording: Any, scene: SwarmScene, k: int) -> None:
    place, status, targets = pad_to_space(scene.position[k]), scene.status[k], scene.targets
    for name, which, color in (("vehicles", ALIVE, BLUE), ("lost", LOST, GRAY)):
        there = np.flatnonzero(status == which)
        if which == ALIVE or (scene.status == which).any():
            look = {"radii": scene.diameter[there] / 2, "colors": _color(color)}
            labels = {"labels": there.astype(str), "show_labels": False}
            recording.log(name, rerun.Points3D(place[there], **look, **labels))
    ends = place[list_links(scene, k)]
    recording.log("links", rerun.LineStrips3D(ends, colors=_color(LIGHT_GRAY)))
    if k == 0 or targets.stage[k] != targets.stage[k - 1]:
        known = pad_to_space(targets.position[targets.stage[k]])
        known = known[np.isfinite(known).all(axis=1)]
        recording.log("targets", rerun.Points3D(known, colors=_color(LIGHT_GRAY)))
    for i, hull in enumerate(scene.obstacles):
        if k == 0 or hull.velocity.any():
            at = pad_to_space(hull.vertices + scene.time[k] * hull.velocity)
            mesh = rerun.Mesh3D(vertex_positions=at, triangle_indices=hull.triangles)
            recording.log(f"obstacles/{i}", mesh)
    for series in scene.series:
        if np.isfinite(series.values[k]):
            name = f"curves/{series.name.replace(' ', '_')}"
            recording.log(name, rerun.Scalars(float(series.values[k])))


def _color(name: str) -> tuple[int, int, int]:
    red, green, blue = (int(name[i:j], 16) for i, j in pairwise((1, 3, 5, 7)))
    return red, green, blue
