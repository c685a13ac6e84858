"""What cameras and range sensors tell: the only place where the truth is looked at."""

from math import cos, sin, sqrt
from typing import no_type_check

import numba
import numpy as np

from dynamics.quadrotor import tilted
from problems.graph import bearings, range_weight, rise
from sato.connectivity.obstacles import hidden, nearest, passes


@no_type_check
@numba.njit
def look(world, senses, team, rng):
    """What every camera sees; and the true weights, for who watches from outside."""
    n = len(world.position)
    mine, theirs, upright = np.zeros(3), np.zeros(3), np.array(team.camera.axis)
    axis = np.zeros((n, 3))
    for i in range(n):
        axis[i] = upright
        if team.tilts:
            tilted(upright, world.push[i], world.yaw[i], axis[i])
    senses.saw[:] = senses.sees
    senses.p_before[:] = senses.p
    for i in range(n):
        for j in range(i):
            senses.sees[i, j] = senses.sees[j, i] = False
            world.weight[i, j] = world.weight[j, i] = 0.0
            if not (world.alive[i] and world.alive[j]):
                continue
            d = bearings(world.position, world.yaw, i, j, mine, theirs)
            world.robot[i], world.robot[j] = min(world.robot[i], d), min(world.robot[j], d)
            if not team.camera.d_min < d < team.camera.d_max:
                continue
            if team.occlusion and _hidden(i, j, world, team):
                continue
            f = _sight(i, j, d, mine, axis[i], senses, team, rng)
            g = _sight(j, i, d, theirs, axis[j], senses, team, rng)
            gamma, _ = range_weight(d, team.camera)
            world.weight[i, j] = world.weight[j, i] = gamma * (f + g - f * g)


@no_type_check
@numba.njit
def _sight(i, j, d, bearing, axis, senses, team, rng):
    # One camera: whether it has the other robot, and where; returns the true f*.
    facing = axis[0] * bearing[0] + axis[1] * bearing[1] + axis[2] * bearing[2]
    if facing > team.sight.a_min:
        senses.sees[i, j] = True
        for k in range(3):
            senses.p[i, j, k] = d * bearing[k]
            if team.noise > 0:
                senses.p[i, j, k] += team.noise * rng.standard_normal()
    return rise(facing, team.camera.a_min, team.camera.a_max)


@no_type_check
@numba.njit
def _hidden(i, j, world, team):
    p, q = world.position[i], world.position[j]
    for k in range(len(world.position)):
        if k not in (i, j) and world.alive[k]:
            if passes(p, q, world.position[k], team.body):
                return True
    return hidden(p, q, team.obstacles)


@no_type_check
@numba.njit
def feel(world, senses, team):
    """What every range sensor finds: where something is, not what; robots and obstacles alike."""
    point, n, far = np.zeros(3), len(world.position), team.repulsion.farthest
    o = team.obstacles
    others = len(o.spheres) + len(o.boxes) + len(o.planes)
    for i in range(n):
        senses.around[i] = 0
        if not world.alive[i]:
            continue
        p, c, s = world.position[i], cos(world.yaw[i]), sin(world.yaw[i])
        for k in range(n + others):
            if k < n:
                if k == i or not world.alive[k]:
                    continue
                point[:] = world.position[k]
                d = sqrt((point[0] - p[0]) ** 2 + (point[1] - p[1]) ** 2 + (point[2] - p[2]) ** 2)
            else:
                d = nearest(k - n, p, o, point)
                world.obstacle[i] = min(world.obstacle[i], d)
            if d < far:
                x, y = point[0] - p[0], point[1] - p[1]
                found = senses.points[i, senses.around[i]]
                found[0], found[1], found[2] = c * x + s * y, c * y - s * x, point[2] - p[2]
                senses.around[i] += 1
