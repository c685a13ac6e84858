"""The words of the summary: success, shape error, path and the rest."""

from typing import Any

import numpy as np

from sato.check.common import cut_short, words
from sato.formation.check.evidence import Evidence
from sato.formation.check.replay import Stretch
from sato.formation.shape import Likeness, likeness
from sato.formation.supervisor import Phase


def summarise(evidence: Evidence) -> dict[str, Any]:
    """Everything that the summary says of a run, from its data; what it lacks is absent."""
    mission, sample = evidence.mission, evidence.mission.sample
    legs = [describe(evidence, stretch) for stretch in evidence.replay.stretches]
    done = len(legs) == len(mission.shapes) and not cut_short(evidence.attributes)
    stuck = sum(phase is Phase.GRIDLOCKED for phase in evidence.replay.phase[:-1])
    said = words(evidence.attributes, evidence.alive) | {
        "success": done and all(leg["success"] for leg in legs),
        "shape_error_m": max(
            (leg["shape_error_m"] for leg in legs if "shape_error_m" in leg), default=np.nan
        ),
        "path_m": sum(leg["path_m"] for leg in legs),
        "time_s": sum(leg["time_s"] for leg in legs),
        "reassignments": sum(leg["reassignments"] for leg in legs),
        "gridlocked_s": stuck * sample,
        "bytes_per_vehicle_s": received(evidence) / 8,
        "longest_auction_s": longest(evidence) / mission.radio.rate,
        "min_separation_m": evidence.closest.distance,
        "keep_out_m": mission.avoidance.keep_out,
        "gains_rate": slowest(evidence),
        "legs": legs,
    }
    return _finite(said)


def describe(evidence: Evidence, stretch: Stretch) -> dict[str, Any]:
    """What one leg came to.

    Its way and time are from the first assignment until it is taken up or given up, the way
    in the plane and the mean of all vehicles, as [Lusk2020] has them. How well the shape is
    taken up is measured when it has been held for a while: at the last instant before the next.
    """
    mission = evidence.mission
    k = np.arange(stretch.first, stretch.end + 1)
    k = k[[evidence.replay.phase[i] is not Phase.WAITING for i in k]]
    flown = np.linalg.norm((evidence.position[k] - evidence.position[k - 1])[..., :2], axis=2)
    taken = [i for i, _ in evidence.happened.told("assignment")]
    said: dict[str, Any] = {
        "success": False,
        "time_s": len(k) * mission.sample,
        "path_m": float(flown.mean(axis=1).sum()),
        "reassignments": sum(stretch.first <= i <= stretch.end for i in taken),
    }
    like = alike(evidence, stretch)
    if like is None:
        return said
    off = like.upright if mission.law.upright else min(like)
    right = off <= mission.protocol.shape
    said["success"] = stretch.settled and right
    return _finite(said | {"shape_error_m": like.error, "inverted": like.inverted})


def alike(evidence: Evidence, stretch: Stretch) -> Likeness | None:
    """How well a shape is taken up; nothing where two vehicles hold one point."""
    point, shape = evidence.point[stretch.last], evidence.mission.shapes[stretch.leg]
    if not np.array_equal(np.sort(point), np.arange(len(point))):
        return None
    return likeness(evidence.position[stretch.last, np.argsort(point)], shape.formation.points)


def received(evidence: Evidence) -> float:
    """Bits a second that a vehicle receives, mean of all over the whole flight."""
    mission, radio = evidence.mission, evidence.mission.radio
    degree = [float(gains.formation.graph.sum(axis=1).mean()) for gains in mission.shapes]
    bits = 0.0
    for leg in evidence.leg[1:]:
        bits += degree[leg] * radio.localisation * mission.sample
    for _, event in evidence.happened.told("auction"):
        bits += degree[event["leg"]] * radio.auction(mission.agents, int(event["rounds"]))
    time = (len(evidence.time) - 1) * mission.sample
    return bits / time if time > 0 else np.nan


def longest(evidence: Evidence) -> int:
    """Rounds of messages of the longest auction; they are sent as often as positions are."""
    return max((int(e["rounds"]) for _, e in evidence.happened.told("auction")), default=0)


def slowest(evidence: Evidence) -> float:
    """The least rate of the gains on file [1/s]; none where they are none."""
    try:
        return min(evidence.gains(leg).rate for leg in range(len(evidence.mission.shapes)))
    except ValueError:
        return np.nan


def _finite(said: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in said.items() if not (isinstance(v, float) and not np.isfinite(v))}
