"""Scene of a formation flight, as viewers show it."""

import numpy as np

from problems.alignment import align
from sato.figures.style import BLUE, ORANGE
from sato.formation.check.recorded import FormationRecord
from sato.formation.mission import Formation
from sato.run_data import RunData
from sato.scene import (
    ALIVE,
    Coloring,
    Links,
    Series,
    SwarmScene,
    Targets,
    color_by_component,
    color_by_speed,
    color_by_target,
    least_over_agents,
    nearest_distances,
)


def make_scene(data: RunData, mission: Formation) -> SwarmScene:
    """Make the scene of a run.

    The points of a formation are shown at each instant in the pose that is nearest to the
    vehicles that hold them; separation is that in the plane, which is kept.
    """
    record = FormationRecord.from_data(data, mission)
    frames, alive = record.frames, record.frames.alive
    targets = _align_points(record)
    nearest = nearest_distances(frames.position[..., :2], alive)
    least = least_over_agents(nearest)
    avoiding = np.where(alive, frames.avoiding, np.nan)
    names = [gains.formation.name.rpartition("/")[2] for gains in mission.gains]
    starts = [(e["time"], e["leg"]) for _, e in record.events.of_kind("leg_start")]
    return SwarmScene(
        time=record.time,
        position=frames.position,
        velocity=frames.velocity,
        status=np.where(alive, ALIVE, 0),
        diameter=np.full(alive.shape[1], mission.keep_out),
        links=_link_neighbors(record),
        targets=targets,
        colorings=(
            color_by_target(targets),
            Coloring("avoidance", avoiding, "", (("free", BLUE), ("avoiding", ORANGE))),
            Coloring("separation", nearest, "m"),
            color_by_speed(frames.velocity, alive),
            color_by_component(frames.component),
        ),
        series=(Series("least separation in the plane", "m", least, mission.keep_out, "keep-out"),),
        stages=tuple(
            (float(t), ", ".join(filter(None, (f"leg {k + 1}", names[k])))) for t, k in starts
        ),
        events=frames.events,
    )


def _align_points(record: FormationRecord) -> Targets:
    """Align the points at each instant from the first assignment of a leg to its end."""
    held, is_assigned = record.frames.point_index, np.zeros(len(record.time), dtype=bool)
    for k, event in record.events.of_kind("leg_start", "assignment"):
        is_assigned[k:] = event["kind"] == "assignment"
    points = record.variables.formation[record.leg_index]
    shape = np.take_along_axis(points, held[..., None], axis=1)
    placed = align(shape, record.frames.position).transform(points)
    return Targets(
        "formation point",
        np.where(is_assigned[:, None, None], placed, np.nan),
        np.arange(len(record.time)),
        np.where(is_assigned[:, None], held, -1),
    )


def _link_neighbors(record: FormationRecord) -> Links:
    """List the pairs that measure each other: neighbors in the graph hold its points."""
    held, leg = record.frames.point_index, record.leg_index
    changed = (np.diff(held, axis=0) != 0).any(axis=1) | (np.diff(leg) != 0)
    listed = []
    for k in (0, *(np.flatnonzero(changed) + 1).tolist()):
        graph = record.variables.graph[leg[k]][np.ix_(held[k], held[k])]
        listed.append((k, np.argwhere(np.triu(graph, 1))))
    return Links("neighbors in the graph", listed=tuple(listed))
