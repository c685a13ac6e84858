"""A run once more, from what was asked: how quadrotors fly, and who has whom in sight."""

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
from sato.connectivity.obstacle_geometry import blocks_line_of_sight, segment_hits_sphere


class QuadrotorReplay(NamedTuple):
    """What quadrotors make of commands."""

    position: Float[Array, "instants agents 3"]  # [m]
    velocity: Float[Array, "instants agents 3"]  # in the world frame [m/s]
    yaw: Float[Array, "instants agents"]  # [rad]
    acceleration: Float[Array, "instants agents 3"]  # acceleration that they tilt for [m/s²]


class CameraViews(NamedTuple):
    """Who has whom in sight, and what that is worth."""

    weight: Float[Array, "instants agents agents"]  # A_ij
    view_cosine: Float[
        Array, "instants agents agents"
    ]  # cosine of j off i's optical axis; −∞ unseen


def replay_quadrotors(
    start: Float[Array, "agents 3"],
    yaw: Float[Array, " agents"],
    asked: Float[Array, "instants agents 3"],
    turn: Float[Array, "instants agents"],
    alive: Bool[Array, "instants agents"],
    plant: Quadrotor,
    step: float,
) -> QuadrotorReplay:
    """Fly quadrotors from rest; the lost stay where they are.

    Args:
        start: Where they begin [m].
        yaw: How they are turned there [rad].
        asked: Velocity asked for, in the body frame [m/s].
        turn: Yaw rate asked for [rad/s].
        alive: Who flies.
        plant: What they are.
        step: Of control [s].
    """
    still = np.zeros_like(asked)
    found = QuadrotorReplay(still, still.copy(), np.zeros_like(turn), still.copy())
    found.position[0], found.yaw[0] = start, yaw
    _replay(found, asked, turn, alive, plant, step)
    return found


def compute_views(
    position: Float[Array, "instants agents 3"],
    yaw: Float[Array, "instants agents"],
    push: Float[Array, "instants agents 3"],
    alive: Bool[Array, "instants agents"],
    mission: Connectivity,
) -> CameraViews:
    """Look through every camera.

    Args:
        position: In the world frame [m].
        yaw: Of the body frames [rad].
        push: Acceleration that robots tilt for, zero for those that do not [m/s²].
        alive: Who sees, is seen and hides others.
        mission: Its cameras, obstacles and what hides whom.
    """
    pairs = (*yaw.shape, yaw.shape[1])
    found = CameraViews(np.zeros(pairs), np.full(pairs, -np.inf))
    covers = (mission.occlusion, mission.body_radius, mission.obstacle_arrays)
    _compute_views(position, yaw, push, alive, mission.camera, *covers, found)
    return found


@no_type_check
@numba.njit
def is_occluded(i, j, position, alive, body, obstacles):
    for other in range(len(position)):
        if other not in (i, j) and alive[other]:
            if segment_hits_sphere(position[i], position[j], position[other], body):
                return True
    return blocks_line_of_sight(position[i], position[j], obstacles)


def _compile_kernels(stamp: int) -> tuple[Any, Any]:
    # Compiled anew when the stamp changes: numba's cache does not see changes in other files.
    @no_type_check
    @numba.njit(cache=True)
    def advance(found, asked, turn, alive, plant, step):
        rate = np.zeros(turn.shape[1]) if stamp >= 0 else np.empty(0)
        for k in range(len(turn) - 1):
            for part in (found.position, found.velocity, found.acceleration):
                part[k + 1] = part[k]
            found.yaw[k + 1] = found.yaw[k]
            for i in np.flatnonzero(alive[k]):
                found.yaw[k + 1, i], rate[i] = step_quadrotor(
                    found.position[k + 1, i], found.yaw[k, i], found.velocity[k + 1, i], rate[i],
                    found.acceleration[k + 1, i], asked[k, i], turn[k, i], plant, step,
                )  # fmt: skip

    @no_type_check
    @numba.njit(cache=True)
    def look(position, yaw, push, alive, camera, occlusion, body, obstacles, found):
        n = position.shape[1] if stamp >= 0 else 0
        mine, theirs, upright = np.zeros(3), np.zeros(3), np.array(camera.optical_axis)
        axis = np.zeros((n, 3))
        for k in range(len(position)):
            for i in range(n):
                rotate_to_heading_frame(upright, push[k, i], yaw[k, i], axis[i])
            for i in range(n):
                for j in range(i):
                    d = bearings(position[k], yaw[k], i, j, mine, theirs)
                    if not (alive[k, i] and alive[k, j] and camera.d_min < d < camera.d_max):
                        continue
                    if occlusion and is_occluded(i, j, position[k], alive[k], body, obstacles):
                        continue
                    a, b = (axis[i] * mine).sum(), (axis[j] * theirs).sum()
                    found.view_cosine[k, i, j], found.view_cosine[k, j, i] = a, b
                    f = cosine_ramp(a, camera.a_min, camera.a_max)
                    g = cosine_ramp(b, camera.a_min, camera.a_max)
                    weight = range_weight(d, camera)[0] * (f + g - f * g)
                    found.weight[k, i, j] = found.weight[k, j, i] = weight

    return advance, look


_replay, _compute_views = _compile_kernels(
    crc32(b"".join(file.read_bytes() for file in KERNEL_FILES))
)
