"""Summary of a formation flight: success, shape error, path length, time and messages."""

from typing import Any

import numpy as np

from problems.alignment import compute_shape_error
from sato.check.common import common_summary, incomplete_reason
from sato.formation.check.recorded import FormationLegRecord, FormationRecord
from sato.formation.supervisor import Phase


def summarize(record: FormationRecord) -> dict[str, Any]:
    """Summarize a run; entries that it does not have are absent."""
    return common_summary(record.attributes, record.frames.alive) | summarize_flight(record)


def summarize_flight(record: FormationRecord) -> dict[str, Any]:
    """Summarize a flight, without the entries that the runs of every system have."""
    mission = record.mission
    legs = [summarize_leg(record, leg) for leg in record.replay.legs]
    is_over = len(legs) == len(mission.legs) and not incomplete_reason(record.attributes)
    gridlocked = record.replay.phase[:-1].count(Phase.GRIDLOCKED)
    errors = [leg["shape_error_m"] for leg in legs if "shape_error_m" in leg]
    return _drop_nonfinite(
        {
            "success": is_over and all(leg["success"] for leg in legs),
            "shape_error_m": max(errors, default=np.nan),
            **{key: sum(leg[key] for leg in legs) for key in ("path_m", "time_s", "reassignments")},
            "gridlocked_s": gridlocked * mission.frame_period,
            "bytes_per_vehicle_s": received_bit_rate(record) / 8,
            "longest_auction_s": max(record.auction_rounds, default=0) / mission.radio.message_rate,
            "min_separation_m": record.closest_approach.distance,
            "keep_out_m": mission.keep_out,
            "gains_rate": min_convergence_rate(record),
            "legs": legs,
        }
    )


def summarize_leg(record: FormationRecord, leg: FormationLegRecord) -> dict[str, Any]:
    """Summarize one leg.

    Path and time count from the first assignment until the formation is taken up or given up;
    the path is in the plane, the mean of all vehicles, as in [Lusk2020]. The shape error is
    measured after hovering in the formation, at the last instant before the next leg.
    """
    mission = record.mission
    k = np.arange(leg.first_instant, leg.end_instant + 1)
    k = k[[record.replay.phase[i] is not Phase.WAITING for i in k]]
    steps = record.frames.position[k] - record.frames.position[k - 1]
    flown = np.linalg.norm(steps[..., :2], axis=2)
    assigned = [i for i, _ in record.events.of_kind("assignment")]
    summary: dict[str, Any] = {
        "success": False,
        "time_s": len(k) * mission.frame_period,
        "path_m": float(flown.mean(axis=1).sum()),
        "reassignments": sum(leg.first_instant <= i <= leg.end_instant for i in assigned),
    }
    held = record.frames.point_index[leg.last_instant]
    if np.array_equal(np.sort(held), np.arange(len(held))):  # no two vehicles hold one point
        points = mission.gains[leg.leg].formation.points
        position = record.frames.position[leg.last_instant, np.argsort(held)]
        shape = compute_shape_error(position, points)
        error = shape.upright if mission.control_law.upright else min(shape)
        summary["success"] = leg.completed and error <= mission.supervision.shape_tolerance
        summary |= {"shape_error_m": shape.error, "inverted": shape.inverted}
    return _drop_nonfinite(summary)


def received_bit_rate(record: FormationRecord) -> float:
    """Return the bits a second that a vehicle receives, mean of all over the whole flight."""
    mission, radio = record.mission, record.mission.radio
    degree = [float(gains.formation.graph.sum(axis=1).mean()) for gains in mission.gains]
    bits = 0.0
    for leg in record.leg_index[1:]:
        bits += degree[leg] * radio.localization_rate * mission.frame_period
    for _, event in record.events.of_kind("auction"):
        rounds = int(event["rounds"])
        bits += degree[event["leg"]] * radio.count_auction_bits(mission.agents, rounds)
    time = (len(record.time) - 1) * mission.frame_period
    return bits / time if time > 0 else np.nan


def min_convergence_rate(record: FormationRecord) -> float:
    """Return the least rate of the recorded gains [1/s]; NaN where they are not stable."""
    try:
        legs = range(len(record.mission.legs))
        return min(record.load_gains(leg).convergence_rate for leg in legs)
    except ValueError:
        return np.nan


def _drop_nonfinite(summary: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in summary.items() if not (isinstance(v, float) and not np.isfinite(v))}
