"""Scene of a reconfiguration, as viewers show it."""

import numpy as np

from sato import scene
from sato.reconfiguration.check.fuel import compute_step_fuel
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.mission import Reconfiguration
from sato.run_data import RunData


def make_scene(data: RunData, mission: Reconfiguration) -> scene.SwarmScene:
    """Make the scene of a run; fuel is that of the commanded controls."""
    record = ReconfigurationRecord.from_data(data, mission)
    frames, alive = record.frames, record.frames.alive
    fuel = np.cumsum(np.pad(compute_step_fuel(record), ((1, 0), (0, 0))), axis=0)
    place = np.full_like(record.variables.target_position, np.nan)
    for row, used in zip(place, record.used_targets, strict=True):
        row[: len(used)] = used[:, : place.shape[2]]
    targets = scene.Targets("target", place, record.leg_index, frames.target_index)
    nearest = scene.nearest_distances(frames.position, alive | record.is_adrift)
    starts = [(record.time[leg.start_index], leg.leg_index) for leg in record.leg_records]
    return scene.SwarmScene(
        time=record.time,
        position=frames.position,
        velocity=frames.velocity,
        status=np.where(alive, scene.ALIVE, np.where(record.is_adrift, scene.LOST, scene.ABSENT)),
        diameter=mission.radii,
        links=scene.Links("within communication radius", mission.comm_radius),
        targets=targets,
        colorings=(
            scene.color_by_component(frames.component),
            scene.color_by_target(targets),
            scene.Coloring("fuel so far", np.where(alive, fuel, np.nan), "m/s"),
            scene.Coloring("separation", np.where(alive, nearest, np.nan), "m"),
            scene.color_by_speed(frames.velocity, alive),
        ),
        series=(_measure_separation(record),),
        stages=tuple((float(t), f"leg {k + 1}, {record.leg_names[k]}") for t, k in starts),
        events=frames.events,
        obstacles=tuple(map(scene.enclose_obstacle, mission.obstacles)),
        viewpoint=scene.GROUND if record.variables.chief is None else scene.ORBIT,
    )


def _measure_separation(record: ReconfigurationRecord) -> scene.Series:
    """Find the least separation along the trajectories of each step."""
    mission = record.mission
    if mission.has_equal_radii and mission.ellipsoid is None:
        separations, limit, unit = record.separations[0], mission.largest_separation, "m"
        names = "least separation in each step", "collision radius"
    else:
        separations, limit, unit = record.relative_separations[0], 1.0, ""
        names = "least separation in each step, over the required one", "required"
    steps = separations.distance.reshape(-1, record.pieces_per_step).min(axis=1)
    values = np.append(np.where(np.isfinite(steps), steps, np.nan), np.nan)
    return scene.Series(names[0], unit, values, limit, names[1], is_held=True)
