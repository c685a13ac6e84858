"""A run once more, from what was asked: how quadrotors fly, and who has whom in sight."""

from typing import Any, NamedTuple, no_type_check
from zlib import crc32

import numba
import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.quadrotor import Quadrotor, fly, tilted
from problems.graph import bearings, range_weight, rise
from sato.connectivity.mission import ConnectivityFlight
from sato.connectivity.obstacles import hidden, passes
from sato.connectivity.swarm import FILES


class Flown(NamedTuple):
    """What quadrotors make of commands."""

    position: Float[Array, "instants agents 3"]  # [m]
    velocity: Float[Array, "instants agents 3"]  # in the world frame [m/s]
    yaw: Float[Array, "instants agents"]  # [rad]
    push: Float[Array, "instants agents 3"]  # acceleration that they tilt for [m/s²]


class Views(NamedTuple):
    """Who has whom in sight, and what that is worth."""

    weight: Float[Array, "instants agents agents"]  # A_ij
    facing: Float[Array, "instants agents agents"]  # cosine of j off i's optical axis; −∞ unseen


def flown(
    start: Float[Array, "agents 3"],
    yaw: Float[Array, " agents"],
    asked: Float[Array, "instants agents 3"],
    turn: Float[Array, "instants agents"],
    alive: Bool[Array, "instants agents"],
    plant: Quadrotor,
    step: float,
) -> Flown:
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
    found = Flown(still, still.copy(), np.zeros_like(turn), still.copy())
    found.position[0], found.yaw[0] = start, yaw
    _fly(found, asked, turn, alive, plant, step)
    return found


def views(
    position: Float[Array, "instants agents 3"],
    yaw: Float[Array, "instants agents"],
    push: Float[Array, "instants agents 3"],
    alive: Bool[Array, "instants agents"],
    mission: ConnectivityFlight,
) -> Views:
    """Look through every camera.

    Args:
        position: In the world frame [m].
        yaw: Of the body frames [rad].
        push: Acceleration that robots tilt for, zero for those that do not [m/s²].
        alive: Who sees, is seen and hides others.
        mission: Its cameras, obstacles and what hides whom.
    """
    pairs = (*yaw.shape, yaw.shape[1])
    found = Views(np.zeros(pairs), np.full(pairs, -np.inf))
    covers = (mission.occlusion, mission.body, mission.obstacles)
    _look(position, yaw, push, alive, mission.camera, *covers, found)
    return found


@no_type_check
@numba.njit
def _covered(i, j, position, alive, body, obstacles):
    for other in range(len(position)):
        if other not in (i, j) and alive[other]:
            if passes(position[i], position[j], position[other], body):
                return True
    return hidden(position[i], position[j], obstacles)


def _kernels(stamp: int) -> tuple[Any, Any]:
    # Compiled anew when the stamp changes: numba's cache does not see changes in other files.
    @no_type_check
    @numba.njit(cache=True)
    def advance(found, asked, turn, alive, plant, step):
        rate = np.zeros(turn.shape[1]) if stamp >= 0 else np.empty(0)
        for k in range(len(turn) - 1):
            for part in (found.position, found.velocity, found.push):
                part[k + 1] = part[k]
            found.yaw[k + 1] = found.yaw[k]
            for i in np.flatnonzero(alive[k]):
                found.yaw[k + 1, i], rate[i] = fly(
                    found.position[k + 1, i], found.yaw[k, i], found.velocity[k + 1, i], rate[i],
                    found.push[k + 1, i], asked[k, i], turn[k, i], plant, step,
                )  # fmt: skip

    @no_type_check
    @numba.njit(cache=True)
    def look(position, yaw, push, alive, camera, occlusion, body, obstacles, found):
        n = position.shape[1] if stamp >= 0 else 0
        mine, theirs, upright = np.zeros(3), np.zeros(3), np.array(camera.axis)
        axis = np.zeros((n, 3))
        for k in range(len(position)):
            for i in range(n):
                tilted(upright, push[k, i], yaw[k, i], axis[i])
            for i in range(n):
                for j in range(i):
                    d = bearings(position[k], yaw[k], i, j, mine, theirs)
                    if not (alive[k, i] and alive[k, j] and camera.d_min < d < camera.d_max):
                        continue
                    if occlusion and _covered(i, j, position[k], alive[k], body, obstacles):
                        continue
                    a, b = (axis[i] * mine).sum(), (axis[j] * theirs).sum()
                    found.facing[k, i, j], found.facing[k, j, i] = a, b
                    f = rise(a, camera.a_min, camera.a_max)
                    g = rise(b, camera.a_min, camera.a_max)
                    weight = range_weight(d, camera)[0] * (f + g - f * g)
                    found.weight[k, i, j] = found.weight[k, j, i] = weight

    return advance, look


_fly, _look = _kernels(crc32(b"".join(file.read_bytes() for file in FILES)))
