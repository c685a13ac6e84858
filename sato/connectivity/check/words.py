"""The words of the summary: success, λ₂, errors of estimates and the rest."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.check.common import cut_short, words
from sato.connectivity.check.evidence import Evidence


def summarise(evidence: Evidence) -> dict[str, Any]:
    """Everything that the summary says of a run, from its data; what it lacks is absent.

    Connectivity is what a run is for: it is a success if λ₂ stays above λ₂^min throughout.
    """
    least = float(evidence.lambda2.min())
    sees, other = evidence.sees, evidence.sees.transpose(0, 2, 1)
    kept = least > evidence.mission.potential.least
    off = np.abs(evidence.estimate - evidence.lambda2[:, None])
    edges = np.triu(evidence.weight > 0).sum(axis=(1, 2))
    said = words(evidence.attributes, evidence.alive) | {
        "success": kept and not cut_short(evidence.attributes),
        "lambda2_min": least,
        "lambda2_error_mean": _mean(off, evidence.alive & np.isfinite(off)),
        "yaw_error_mutual": yaw_error(evidence, sees & other),
        "yaw_error_one_sided": yaw_error(evidence, sees & ~other),
        "min_separation_m": evidence.to_robots,
        "min_obstacle_distance_m": evidence.to_obstacles,
        "edges_mean": float(edges.mean()),
        "waypoints_reached": evidence.waypoints,
        "waypoints": len(evidence.mission.stick.waypoints),
    }
    return {k: v for k, v in said.items() if not (isinstance(v, float) and not np.isfinite(v))}


def yaw_error(evidence: Evidence, which: Bool[Array, "instants agents agents"]) -> float:
    """Mean of |sin(Δψ/2)| over some pairs, as [Bernard2023, Fig. 7] has it; NaN without any."""
    return _mean(np.abs(np.sin(evidence.yaw_error / 2)), which)


def _mean(values: Float[Array, "*k"], which: Bool[Array, "*k"]) -> float:
    return float(values[which].mean()) if which.any() else np.nan
