"""Summary of a connectivity run."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.check.common import common_summary, incomplete_reason
from sato.connectivity.check.recorded import ConnectivityRecord


def summarize(record: ConnectivityRecord) -> dict[str, Any]:
    """Summarize a run; a success has λ₂ above λ₂^min throughout."""
    flight = summarize_flight(record)
    is_connected = flight["lambda2_min"] > record.mission.potential.lambda2_min
    success = is_connected and not incomplete_reason(record.attributes)
    common = common_summary(record.attributes, record.frames.alive)
    return common | {"success": success} | flight


def summarize_flight(record: ConnectivityRecord) -> dict[str, Any]:
    """Summarize the frames of a run; quantities without a value are absent."""
    frames = record.frames
    sees, is_seen = frames.visibility, frames.visibility.transpose(0, 2, 1)
    lambda2_error = np.abs(frames.lambda2_estimate - frames.lambda2[:, None])
    yaw_error = np.abs(np.sin(frames.yaw_estimate_error / 2))  # as in [Bernard2023, Fig. 7]
    summary = {
        "lambda2_min": float(frames.lambda2.min()),
        "lambda2_error_mean": _mean(lambda2_error, frames.alive & np.isfinite(lambda2_error)),
        "yaw_error_mutual": _mean(yaw_error, sees & is_seen),
        "yaw_error_one_sided": _mean(yaw_error, sees & ~is_seen),
        "min_separation_m": record.min_separation,
        "min_obstacle_distance_m": record.min_obstacle_distance,
        "edges_mean": float(np.triu(frames.edge_weight > 0).sum(axis=(1, 2)).mean()),
        "waypoints_reached": record.waypoints_reached,
        "waypoints": len(record.mission.stick.waypoints),
    }
    return {k: v for k, v in summary.items() if not isinstance(v, float) or np.isfinite(v)}


def _mean(values: Float[Array, "*k"], which: Bool[Array, "*k"]) -> float:
    return float(values[which].mean()) if which.any() else np.nan
