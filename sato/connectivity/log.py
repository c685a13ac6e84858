"""What a run of this system leaves behind, beyond what every run does."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.connectivity.flight import Frame
from sato.connectivity.mission import ConnectivityFlight
from sato.system import Variable

_VECTOR, _EACH, _PAIRS = ("time", "agent", "axis"), ("time", "agent"), ("time", "agent", "other")
MEANING = {
    "velocity_command": Variable(
        _VECTOR, "m/s", "velocity that the agent asks of itself, in its body frame, without stick"
    ),
    "yaw_rate": Variable(_EACH, "rad/s", "yaw rate that the agent asks of itself"),
    "yaw": Variable(_EACH, "rad", "of the body frame, not wrapped"),
    "lambda2": Variable(("time",), "1", "connectivity eigenvalue of the live agents, true"),
    "lambda3": Variable(("time",), "1", "the eigenvalue after it, infinite for two agents, true"),
    "lambda2_estimate": Variable(_EACH, "1", "lambda2 as the agent has it, NaN unknown"),
    "edge_weight": Variable(_PAIRS, "1", "weight of the edge, true"),
    "yaw_estimate_error": Variable(
        _PAIRS, "rad", "of how the other is turned, as the agent has it"
    ),
    "visibility": Variable(_PAIRS, "1", "whether the agent has the other in sight"),
    "stick": Variable(("time", "axis"), "m/s", "what is asked of agent 0, in the world frame"),
}


def attributes(mission: ConnectivityFlight) -> dict[str, float]:
    """The radii and limits that a run file says in its attributes."""
    return {
        "lambda2_min": mission.potential.least,
        "lambda2_max": mission.potential.most,
        "range_m": mission.camera.d_max,
        "nearest_m": mission.repulsion.nearest,
        "max_speed_m_s": mission.limits.speed,
        "max_turn_rad_s": mission.limits.turn,
    }


def variables(frames: Sequence[Frame], mission: ConnectivityFlight) -> dict[str, Array]:
    """The values of the variables that have a `MEANING`, and velocity in the world frame."""
    names = ("yaw", "lambda2", "lambda3", "lambda2_estimate", "edge_weight", "stick")
    found = {name: np.array([getattr(f, name) for f in frames]) for name in names}
    command = np.array([f.command for f in frames])
    yaw, turned = found["yaw"], np.array([f.turned for f in frames])
    off = turned - (yaw[:, None, :] - yaw[:, :, None])
    return found | {
        "velocity": rotated(np.array([f.velocity for f in frames]), yaw),
        "velocity_command": command[..., :3],
        "yaw_rate": command[..., 3],
        "yaw_estimate_error": (off + np.pi) % (2 * np.pi) - np.pi,
        "visibility": np.array([f.sees for f in frames]),
    }


def rotated(vectors: Float[Array, "*k 3"], yaw: Float[Array, "*k"]) -> Float[Array, "*k 3"]:
    """R_z(ψ) v: from body frames to the world frame."""
    c, s, (x, y, z) = np.cos(yaw), np.sin(yaw), np.moveaxis(vectors, -1, 0)
    return np.stack([c * x - s * y, s * x + c * y, z], axis=-1)
