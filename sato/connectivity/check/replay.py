"""Replay of a run: the flight of quadrotors from their commands, and the views of cameras."""

from typing import Any, NamedTuple, no_type_check
from zlib import crc32

import numba
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.quadrotor import Quadrotor, rotate_to_heading_frame, step_quadrotor
from problems.interaction_graph import bearings, cosine_ramp, range_weight
from sato.connectivity.kernel import KERNEL_FILES
from sato.connectivity.mission import Connectivity
from sato.connectivity.sensors import is_occluded


class QuadrotorReplay(NamedTuple):
    """Flight of quadrotors under recorded commands."""

    position: Float[Array, "instants agents 3"]  # [m]
    velocity: Float[Array, "instants agents 3"]  # in the world frame [m/s]
    yaw: Float[Array, "instants agents"]  # [rad]
    acceleration: Float[Array, "instants agents 3"]  # that they tilt for [m/s²]


class CameraViews(NamedTuple):
    """Views of all cameras, and the weights of edges."""

    weight: Float[Array, "instants agents agents"]  # A_ij
    view_cosine: Float[Array, "instants agents agents"]  # of j to the axis of i; −∞ out of view


def replay_quadrotors(
    start: Float[Array, "agents 3"],
    yaw: Float[Array, " agents"],
    command: Float[Array, "instants agents 3"],
    yaw_rate: Float[Array, "instants agents"],
    alive: Bool[Array, "instants agents"],
    plant: Quadrotor,
    step: float,
) -> QuadrotorReplay:
    """Simulate quadrotors from rest; lost ones stay where they are.

    Args:
        start: Initial positions [m].
        yaw: Initial yaw [rad].
        command: Commanded velocity, body frame [m/s].
        yaw_rate: Commanded yaw rate [rad/s].
        alive: True for agents that fly.
        plant: Quadrotor.
        step: Control step [s].
    """
    still = np.zeros_like(command)
    found = QuadrotorReplay(still, still.copy(), np.zeros_like(yaw_rate), still.copy())
    found.position[0], found.yaw[0] = start, yaw
    _replay(found, command, yaw_rate, alive, plant, step)
    return found


def compute_views(
    position: Float[Array, "instants agents 3"],
    yaw: Float[Array, "instants agents"],
    acceleration: Float[Array, "instants agents 3"],
    alive: Bool[Array, "instants agents"],
    mission: Connectivity,
) -> CameraViews:
    """Compute the view of every camera.

    Args:
        position: Positions [m].
        yaw: Yaw of each agent [rad].
        acceleration: Acceleration that agents tilt for, zero for those that do not [m/s²].
        alive: True for agents that see, are seen and block the line of sight.
        mission: Drawn mission.
    """
    pairs = (*yaw.shape, yaw.shape[1])
    found = CameraViews(np.zeros(pairs), np.full(pairs, -np.inf))
    covers = (mission.occlusion, mission.body_radius, mission.obstacle_arrays)
    _compute_views(position, yaw, acceleration, alive, mission.camera, *covers, found)
    return found


def _compile_kernels(stamp: int) -> tuple[Any, Any]:
    # The stamp compiles these anew when other files change, which the cache of numba does not see.
    @no_type_check
    @numba.njit(cache=True)
    def advance(found, command, yaw_rate, alive, plant, step):
        rate = np.zeros(yaw_rate.shape[1]) if stamp >= 0 else np.empty(0)
        for k in range(len(yaw_rate) - 1):
            for part in (found.position, found.velocity, found.acceleration):
                part[k + 1] = part[k]
            found.yaw[k + 1] = found.yaw[k]
            for i in np.flatnonzero(alive[k]):
                found.yaw[k + 1, i], rate[i] = step_quadrotor(
                    found.position[k + 1, i], found.yaw[k, i], found.velocity[k + 1, i], rate[i],
                    found.acceleration[k + 1, i], command[k, i], yaw_rate[k, i], plant, step,
                )  # fmt: skip

    @no_type_check
    @numba.njit(cache=True)
    def look(position, yaw, acceleration, alive, camera, occlusion, body, obstacles, found):
        n = position.shape[1] if stamp >= 0 else 0
        bearing, bearing_back, level_axis = np.zeros(3), np.zeros(3), np.array(camera.optical_axis)
        axis = np.zeros((n, 3))
        for k in range(len(position)):
            for i in range(n):
                rotate_to_heading_frame(level_axis, acceleration[k, i], yaw[k, i], axis[i])
            for i in range(n):
                for j in range(i):
                    d = bearings(position[k], yaw[k], i, j, bearing, bearing_back)
                    if not (alive[k, i] and alive[k, j] and camera.d_min < d < camera.d_max):
                        continue
                    if occlusion and is_occluded(i, j, position[k], alive[k], body, obstacles):
                        continue
                    a, b = (axis[i] * bearing).sum(), (axis[j] * bearing_back).sum()
                    found.view_cosine[k, i, j], found.view_cosine[k, j, i] = a, b
                    f = cosine_ramp(a, camera.a_min, camera.a_max)[0]
                    g = cosine_ramp(b, camera.a_min, camera.a_max)[0]
                    weight = range_weight(d, camera)[0] * (f + g - f * g)
                    found.weight[k, i, j] = found.weight[k, j, i] = weight

    return advance, look


_replay, _compute_views = _compile_kernels(
    crc32(b"".join(file.read_bytes() for file in KERNEL_FILES))
)
