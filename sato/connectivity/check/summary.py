"""The words of the summary: success, λ₂, errors of estimates and the rest."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.check.common import common_summary, incomplete_reason
from sato.connectivity.check.evidence import ConnectivityRecord


def summarize(evidence: ConnectivityRecord) -> dict[str, Any]:
    """Everything that the summary says of a run, from its data; what it lacks is absent.

    Connectivity is what a run is for: it is a success if λ₂ stays above λ₂^min throughout.
    """
    least = float(evidence.lambda2.min())
    sees, other = evidence.visibility, evidence.visibility.transpose(0, 2, 1)
    kept = least > evidence.mission.potential.lambda2_min
    off = np.abs(evidence.lambda2_estimate - evidence.lambda2[:, None])
    edges = np.triu(evidence.edge_weight > 0).sum(axis=(1, 2))
    said = common_summary(evidence.attributes, evidence.alive) | {
        "success": kept and not incomplete_reason(evidence.attributes),
        "lambda2_min": least,
        "lambda2_error_mean": _masked_mean(off, evidence.alive & np.isfinite(off)),
        "yaw_error_mutual": mean_yaw_error(evidence, sees & other),
        "yaw_error_one_sided": mean_yaw_error(evidence, sees & ~other),
        "min_separation_m": evidence.min_separation,
        "min_obstacle_distance_m": evidence.min_obstacle_distance,
        "edges_mean": float(edges.mean()),
        "waypoints_reached": evidence.waypoints_reached,
        "waypoints": len(evidence.mission.stick.waypoints),
    }
    return {k: v for k, v in said.items() if not (isinstance(v, float) and not np.isfinite(v))}


def mean_yaw_error(
    evidence: ConnectivityRecord, which: Bool[Array, "instants agents agents"]
) -> float:
    """Mean of |sin(Δψ/2)| over some pairs, as [Bernard2023, Fig. 7] has it; NaN without any."""
    return _masked_mean(np.abs(np.sin(evidence.yaw_estimate_error / 2)), which)


def _masked_mean(values: Float[Array, "*k"], which: Bool[Array, "*k"]) -> float:
    return float(values[which].mean()) if which.any() else np.nan
