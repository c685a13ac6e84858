"""The words of the summary: success, shape error, path and the rest."""

from typing import Any

import numpy as np

from sato.check.common import common_summary, incomplete_reason
from sato.formation.check.evidence import FormationRecord
from sato.formation.check.replay import FormationLegRecord
from sato.formation.shape_error import ShapeError, compute_shape_error
from sato.formation.supervisor import Phase


def summarize(evidence: FormationRecord) -> dict[str, Any]:
    """Everything that the summary says of a run, from its data; what it lacks is absent."""
    mission, sample = evidence.mission, evidence.mission.frame_period
    legs = [summarize_leg(evidence, stretch) for stretch in evidence.replay.legs]
    done = len(legs) == len(mission.gains) and not incomplete_reason(evidence.attributes)
    stuck = sum(phase is Phase.GRIDLOCKED for phase in evidence.replay.phase[:-1])
    said = common_summary(evidence.attributes, evidence.alive) | {
        "success": done and all(leg["success"] for leg in legs),
        "shape_error_m": max(
            (leg["shape_error_m"] for leg in legs if "shape_error_m" in leg), default=np.nan
        ),
        "path_m": sum(leg["path_m"] for leg in legs),
        "time_s": sum(leg["time_s"] for leg in legs),
        "reassignments": sum(leg["reassignments"] for leg in legs),
        "gridlocked_s": stuck * sample,
        "bytes_per_vehicle_s": received_bit_rate(evidence) / 8,
        "longest_auction_s": longest_auction_rounds(evidence) / mission.radio.message_rate,
        "min_separation_m": evidence.closest_approach.distance,
        "keep_out_m": mission.avoidance.keep_out,
        "gains_rate": min_convergence_rate(evidence),
        "legs": legs,
    }
    return _drop_nonfinite(said)


def summarize_leg(evidence: FormationRecord, stretch: FormationLegRecord) -> dict[str, Any]:
    """What one leg came to.

    Its way and time are from the first assignment until it is taken up or given up, the way
    in the plane and the mean of all vehicles, as [Lusk2020] has them. How well the shape is
    taken up is measured when it has been held for a while: at the last instant before the next.
    """
    mission = evidence.mission
    k = np.arange(stretch.first_instant, stretch.end_instant + 1)
    k = k[[evidence.replay.phase[i] is not Phase.WAITING for i in k]]
    flown = np.linalg.norm((evidence.position[k] - evidence.position[k - 1])[..., :2], axis=2)
    taken = [i for i, _ in evidence.events.of_kind("assignment")]
    said: dict[str, Any] = {
        "success": False,
        "time_s": len(k) * mission.frame_period,
        "path_m": float(flown.mean(axis=1).sum()),
        "reassignments": sum(stretch.first_instant <= i <= stretch.end_instant for i in taken),
    }
    like = leg_shape_error(evidence, stretch)
    if like is None:
        return said
    off = like.upright if mission.control_law.upright else min(like)
    right = off <= mission.supervision.shape_tolerance
    said["success"] = stretch.completed and right
    return _drop_nonfinite(said | {"shape_error_m": like.error, "inverted": like.inverted})


def leg_shape_error(evidence: FormationRecord, stretch: FormationLegRecord) -> ShapeError | None:
    """How well a shape is taken up; nothing where two vehicles hold one point."""
    point, shape = evidence.assignment[stretch.last_instant], evidence.mission.gains[stretch.leg]
    if not np.array_equal(np.sort(point), np.arange(len(point))):
        return None
    return compute_shape_error(
        evidence.position[stretch.last_instant, np.argsort(point)], shape.formation.points
    )


def received_bit_rate(evidence: FormationRecord) -> float:
    """Bits a second that a vehicle receives, mean of all over the whole flight."""
    mission, radio = evidence.mission, evidence.mission.radio
    degree = [float(gains.formation.graph.sum(axis=1).mean()) for gains in mission.gains]
    bits = 0.0
    for leg in evidence.leg[1:]:
        bits += degree[leg] * radio.localization_rate * mission.frame_period
    for _, event in evidence.events.of_kind("auction"):
        bits += degree[event["leg"]] * radio.count_auction_bits(
            mission.agents, int(event["rounds"])
        )
    time = (len(evidence.time) - 1) * mission.frame_period
    return bits / time if time > 0 else np.nan


def longest_auction_rounds(evidence: FormationRecord) -> int:
    """Rounds of messages of the longest auction; they are sent as often as positions are."""
    return max((int(e["rounds"]) for _, e in evidence.events.of_kind("auction")), default=0)


def min_convergence_rate(evidence: FormationRecord) -> float:
    """The least rate of the gains on file [1/s]; none where they are none."""
    try:
        return min(
            evidence.load_gains(leg).convergence_rate for leg in range(len(evidence.mission.gains))
        )
    except ValueError:
        return np.nan


def _drop_nonfinite(said: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in said.items() if not (isinstance(v, float) and not np.isfinite(v))}
