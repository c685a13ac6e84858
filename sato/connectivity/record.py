"""What a run of this system leaves behind, beyond what every run does."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.connectivity.loop import ConnectivityFrame
from sato.connectivity.mission import Connectivity
from sato.interfaces import Variable

_VECTOR, _PER_AGENT, _PER_PAIR = (
    ("time", "agent", "axis"),
    ("time", "agent"),
    ("time", "agent", "other"),
)
VARIABLES = {
    "velocity_command": Variable(
        _VECTOR, "m/s", "velocity that the agent asks of itself, in its body frame, without stick"
    ),
    "yaw_rate": Variable(_PER_AGENT, "rad/s", "yaw rate that the agent asks of itself"),
    "yaw": Variable(_PER_AGENT, "rad", "of the body frame, not wrapped"),
    "lambda2": Variable(("time",), "1", "connectivity eigenvalue of the live agents, true"),
    "lambda3": Variable(("time",), "1", "the eigenvalue after it, infinite for two agents, true"),
    "lambda2_estimate": Variable(_PER_AGENT, "1", "lambda2 as the agent has it, NaN unknown"),
    "edge_weight": Variable(_PER_PAIR, "1", "weight of the edge, true"),
    "yaw_estimate_error": Variable(
        _PER_PAIR, "rad", "of how the other is turned, as the agent has it"
    ),
    "visibility": Variable(_PER_PAIR, "1", "whether the agent has the other in sight"),
    "stick": Variable(("time", "axis"), "m/s", "what is asked of agent 0, in the world frame"),
}


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


def stack_variables(frames: Sequence[ConnectivityFrame], mission: Connectivity) -> dict[str, Array]:
    """The values of the variables that have a `MEANING`, and velocity in the world frame."""
    names = ("yaw", "lambda2", "lambda3", "lambda2_estimate", "edge_weight", "stick")
    found = {name: np.array([getattr(f, name) for f in frames]) for name in names}
    command = np.array([f.command for f in frames])
    yaw, turned = found["yaw"], np.array([f.relative_yaw_estimate for f in frames])
    off = turned - (yaw[:, None, :] - yaw[:, :, None])
    return found | {
        "velocity": rotate_by_yaw(np.array([f.velocity for f in frames]), yaw),
        "velocity_command": command[..., :3],
        "yaw_rate": command[..., 3],
        "yaw_estimate_error": (off + np.pi) % (2 * np.pi) - np.pi,
        "visibility": np.array([f.visibility for f in frames]),
    }


def rotate_by_yaw(vectors: Float[Array, "*k 3"], yaw: Float[Array, "*k"]) -> Float[Array, "*k 3"]:
    """R_z(ψ) v: from body frames to the world frame."""
    c, s, (x, y, z) = np.cos(yaw), np.sin(yaw), np.moveaxis(vectors, -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)
