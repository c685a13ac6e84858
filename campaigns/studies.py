"""Columns and scenarios of the campaigns in this folder that no key of a scenario gives."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
from numpy import ndarray as Array

import sato
from problems.alignment import compute_shape_error
from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.loop import simulate as simulate_connectivity
from sato.connectivity.obstacles import obstacle_distances
from sato.formation.check.recorded import FormationRecord, summarize_flight
from sato.formation.leg import FormationLeg
from sato.formation.loop import simulate as simulate_formation
from sato.formation.system import SYSTEM as FORMATION
from sato.record import collect_run_data
from sato.scenario.file import read_data
from sato.scene import nearest_distances
from sato.shapes import Points

GAP_WINDOW = 1.0  # time before a loss of connectivity in which λ₃ − λ₂ is looked at [s]
IDLE_TIME = 1.0  # time after which an isolated agent must hold [s]
DISTANCE_TOLERANCE = 1e-9  # beyond the distance at which repulsion begins [m]
SHAPE_TOLERANCE = 0.1  # error of a shape that has been taken up [m]
SHAPES = {
    "pyramid": "Pentagonal Pyramid", "prism": "Triangular Prism", "plane": "Slanted Plane"
}  # fmt: skip
REPETITIONS = 2  # through all of them
ROWS_OF_THREE = np.array([[0, 0], [2, 0], [4, 0], [0, 2], [2, 2], [4, 2]], dtype=float)  # [m]
START_NOISE = 0.1  # standard deviation of how far they start off these [m]


def judge_letters(run: sato.Run) -> dict[str, Any]:
    """Judge a flight of the letters, a loss before the third leg."""
    summary, legs = run.summary, run.summary["legs"]
    lost = sum(len(event["agents"]) for event in run.events("loss"))
    share, least = run.mission.legs[2].losses[0].share, run.mission.start.min_components
    holes = [0, 0, 123 - (summary["agents"] - lost), 0]
    good = {
        "scattered at the start": legs[0]["components_at_start"] >= least,
        "split by the loss": share < 0.25 or legs[2]["components_at_start"] >= min(2, least),
        "reached": all(leg["reached"] and not leg["duplicates"] for leg in legs),
        "holes": [leg["holes"] for leg in legs] == holes,
        "gap": legs[3]["gap"] <= 1.5,
        "separated": summary["min_separation_m"] >= summary["collision_radius_m"],
        "kept": not summary["broken"] and not summary["slack_used"],
    }
    return {
        "good": all(good.values()),
        "violated": ", ".join(name for name, is_met in good.items() if not is_met),
        "components": legs[0]["components_at_start"],
        "holes_after_loss": legs[2]["holes"],
        "gap": legs[3]["gap"],
        "steps": legs[0]["steps"],
        "collided": not good["separated"],
        "unsettled": not good["reached"],
        "resets": sum(leg["resets"] for leg in legs),
    }


def judge_formations(run: sato.Run) -> dict[str, Any]:
    """Tell whether all formations settled and were formed; path and time of flights that settled.

    Ours must be upright, as printed they may be mirror images.
    """
    mission, summary = run.drawn_mission, run.summary
    legs = FormationRecord.from_data(run.recorded, mission).replay.legs
    settled = len(legs) == len(mission.legs) and all(leg.completed for leg in legs)
    inverted = any(leg.get("inverted", False) for leg in summary["legs"])
    is_close = settled and summary["shape_error_m"] <= SHAPE_TOLERANCE
    cells = {
        "settled": settled,
        "formed": is_close and not (mission.control_law.upright and inverted),
    }
    if settled:
        names = {"path_m": "path_m", "time_s": "time_s", "reassignments": "assignments"}
        names["shape_error_m"] = "shape_m"
        cells |= {f"settled_{ours}": summary[name] for name, ours in names.items()}
    return cells


def rows_of_three(rng: np.random.Generator) -> dict[str, Any]:
    """Draw six vehicles in two rows of three, a little off, that go to the first shape."""
    flat = ROWS_OF_THREE + rng.normal(0, START_NOISE, ROWS_OF_THREE.shape)
    start = np.column_stack([flat, np.ones(6)])
    first, *_ = SHAPES.values()
    return {
        "system": "formation",
        "name": "rows_of_three",
        "swarm": {"start": {"kind": "points", "positions_m": start.tolist()}},
        "assignment": {"period_s": 1.2},
        "leg": [{"formation": {"kind": "library", "name": first}}],
    }


def judge_transitions(run: sato.Run) -> dict[str, Any]:
    """Fly all other transitions, and count those that settled; path and time are of these."""
    settled: dict[str, list[bool]] = {name: [] for name in SHAPES}
    formed, paths, times, separations = [], [], [], []
    for name, record in _transitions(run):
        leg, summary = record.replay.legs[0], summarize_flight(record)
        settled[name].append(leg.completed)
        separations.append(summary["min_separation_m"])
        last = record.frames.position[-1][np.argsort(record.frames.point_index[-1])]
        points = record.mission.gains[0].formation.points
        error = compute_shape_error(last, points).error
        formed.append(leg.completed and error <= SHAPE_TOLERANCE)
        if leg.completed:
            paths.append(summary["path_m"])
            times.append(summary["time_s"])
    cells = {f"settled_{name}": np.mean(each) for name, each in settled.items()}
    cells |= {"settled": np.mean([*settled.values()]), "formed": np.mean(formed)}
    if paths:
        cells |= {"settled_path_m": np.mean(paths), "settled_time_s": np.mean(times)}
    return {**cells, "least_separation_m": min(separations)}


def _transitions(run: sato.Run) -> Iterator[tuple[str, FormationRecord]]:
    drawn = run.drawn_mission
    record = FormationRecord.from_data(run.recorded, drawn)
    rng = np.random.default_rng([int(run.data.attrs["seed"]), 1])
    for number, (name, shape) in enumerate([*SHAPES.items()] * REPETITIONS):
        if number:
            # The start is not drawn: vehicles that failed may be closer than is allowed.
            start = Points(record.frames.position[-1], keep_order=True)
            leg = FormationLeg(shape, run.mission.legs[0].graph).draw(6, 0.0, rng)
            mission = replace(drawn, start=start, legs=(leg,))
            frames = list(simulate_formation(mission, rng))
            data = collect_run_data(FORMATION, frames, mission)
            record = FormationRecord.from_data(data, mission)
        yield name, record


def short_flight(rng: np.random.Generator) -> dict[str, Any]:
    """Return the built-in scenario of connectivity, with near waypoints from the start, for 60 s.

    The same keys in all flights: other seeds draw other waypoints.
    """
    data = read_data("connectivity")
    data["stick"] |= {"count": 4, "spacing_m": 6.0, "speed_m_s": 2.0}
    data["stick"] |= {"start_s": 0.0, "on_s": 9.0, "off_s": 3.0}
    data["run"]["duration_s"] = 60.0
    return data


def judge_connectivity(run: sato.Run) -> dict[str, Any]:
    """Tell whether the robots stayed connected, and what led to a split or followed a loss."""
    mission = run.drawn_mission
    record = ConnectivityRecord.from_data(run.recorded, mission)
    frames, cells = record.frames, {}
    below = frames.lambda2 <= mission.potential.lambda2_min
    if below.any():
        first = int(np.argmax(below))
        since = max(0, first - round(GAP_WINDOW / mission.step))
        cells["disconnection_s"] = first * mission.step
        cells["eigenvalue_gap"] = (frames.lambda3 - frames.lambda2)[since : first + 1].min()
    if mission.losses:
        cells |= {"forget_s": _forget_time(run), "idle_command": _idle_command(record)}
    return {"stayed_connected": not below.any(), **cells}


def _forget_time(run: sato.Run) -> float:
    """Return the longest time for which a lost agent was counted on [s], from another flight."""
    rng = np.random.default_rng(int(run.data.attrs["seed"]))
    mission = run.mission.draw(rng)
    frames, longest = list(simulate_connectivity(mission, rng)), 0.0
    time, alive, known = (
        np.array([getattr(frame, name) for frame in frames])
        for name in ("time", "alive", "known_agents")
    )
    for loss in mission.losses:
        is_known = (known[..., loss.agent] & alive).any(axis=1)
        times = time[is_known & ~alive[:, loss.agent]]
        longest = max(longest, float((times - loss.time).max(initial=0.0)))
    return longest


def _idle_command(record: ConnectivityRecord) -> float:
    """Return the largest command of isolated agents with nothing near [m/s, rad/s]."""
    frames, mission = record.frames, record.mission
    position = np.where(frames.alive[..., None], frames.position, np.nan)
    distance = np.nan_to_num(nearest_distances(position, frames.alive), nan=np.inf)
    for walls in np.moveaxis(obstacle_distances(position, mission.obstacle_arrays), -1, 0):
        distance = np.fmin(distance, walls)
    is_isolated = ~frames.edge_weight.any(axis=2) & frames.alive
    idle = _durations(is_isolated, mission.step) > IDLE_TIME
    idle &= distance > mission.repulsion.max_distance + DISTANCE_TOLERANCE
    command = np.maximum(np.abs(frames.velocity_command).max(axis=2), np.abs(frames.yaw_rate))
    return float(command[idle].max(initial=0.0))


def _durations(holds: Array, step: float) -> Array:
    """Return the time for which a condition has held without a break."""
    found, time = np.zeros(holds.shape), np.zeros(holds.shape[1])
    for k, now in enumerate(holds):
        found[k] = time = np.where(now, time + step, 0.0)
    return found
