"""What a run of this system leaves behind, beyond what every run does."""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.connectivity.loop import ConnectivityFrame
from sato.connectivity.mission import Connectivity
from sato.interfaces import Recorded

_PER_AXIS, _PER_PAIR = ("time", "agent", "axis"), ("time", "agent", "other")


class ConnectivityVariables(NamedTuple):
    """Variables of a run that are computed from its frames."""

    velocity: Annotated[
        Float[Array, "instants agents 3"], Recorded(_PER_AXIS, "m/s", "true velocity")
    ]
    velocity_command: Annotated[
        Float[Array, "instants agents 3"],
        Recorded(
            _PER_AXIS, "m/s", "velocity that the agent commands, in its body frame, without stick"
        ),
    ]
    yaw_rate: Annotated[
        Float[Array, "instants agents"],
        Recorded(("time", "agent"), "rad/s", "yaw rate that the agent commands"),
    ]
    yaw_estimate_error: Annotated[
        Float[Array, "instants agents agents"],
        Recorded(_PER_PAIR, "rad", "error of the estimated relative yaw"),
    ]


def run_attributes(mission: Connectivity) -> dict[str, float]:
    """The radii and limits that a run file says in its attributes."""
    return {
        "lambda2_min": mission.potential.lambda2_min,
        "lambda2_max": mission.potential.lambda2_max,
        "range_m": mission.camera.d_max,
        "nearest_m": mission.repulsion.min_distance,
        "max_speed_m_s": mission.limits.speed,
        "max_turn_rad_s": mission.limits.yaw_rate,
    }


def collect_variables(
    frames: Sequence[ConnectivityFrame], mission: Connectivity
) -> ConnectivityVariables:
    """Collect velocities in the world frame, commands, and errors of yaw estimates."""
    command = np.array([f.command for f in frames])
    yaw = np.array([f.yaw for f in frames])
    turned = np.array([f.relative_yaw_estimate for f in frames])
    off = turned - (yaw[:, None, :] - yaw[:, :, None])
    return ConnectivityVariables(
        velocity=rotate_by_yaw(np.array([f.velocity for f in frames]), yaw),
        velocity_command=command[..., :3],
        yaw_rate=command[..., 3],
        yaw_estimate_error=(off + np.pi) % (2 * np.pi) - np.pi,
    )


def rotate_by_yaw(vectors: Float[Array, "*k 3"], yaw: Float[Array, "*k"]) -> Float[Array, "*k 3"]:
    """R_z(ψ) v: from body frames to the world frame."""
    c, s, (x, y, z) = np.cos(yaw), np.sin(yaw), np.moveaxis(vectors, -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)
