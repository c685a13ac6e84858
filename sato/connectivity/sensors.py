"""What cameras and range sensors tell: the only place where the truth is looked at."""

from math import cos, sin, sqrt
from typing import no_type_check

import numba
import numpy as np

from dynamics.quadrotor import rotate_to_heading_frame
from problems.interaction_graph import bearings, cosine_ramp, range_weight
from sato.connectivity.obstacle_geometry import (
    blocks_line_of_sight,
    nearest_point,
    segment_hits_sphere,
)


@no_type_check
@numba.njit
def simulate_cameras(world, senses, team, rng):
    """What every camera sees; and the true weights, for who watches from outside."""
    n = len(world.position)
    mine, theirs, upright = np.zeros(3), np.zeros(3), np.array(team.camera.optical_axis)
    axis = np.zeros((n, 3))
    for i in range(n):
        axis[i] = upright
        if team.is_quadrotor:
            rotate_to_heading_frame(upright, world.acceleration[i], world.yaw[i], axis[i])
    senses.previous_visibility[:] = senses.visibility
    senses.previous_relative_position[:] = senses.relative_position
    for i in range(n):
        for j in range(i):
            senses.visibility[i, j] = senses.visibility[j, i] = False
            world.weight[i, j] = world.weight[j, i] = 0.0
            if not (world.alive[i] and world.alive[j]):
                continue
            d = bearings(world.position, world.yaw, i, j, mine, theirs)
            world.min_separation[i], world.min_separation[j] = (
                min(world.min_separation[i], d),
                min(world.min_separation[j], d),
            )
            if not team.camera.d_min < d < team.camera.d_max:
                continue
            if team.occlusion and is_occluded(i, j, world, team):
                continue
            f = _simulate_camera(i, j, d, mine, axis[i], senses, team, rng)
            g = _simulate_camera(j, i, d, theirs, axis[j], senses, team, rng)
            gamma, _ = range_weight(d, team.camera)
            world.weight[i, j] = world.weight[j, i] = gamma * (f + g - f * g)


@no_type_check
@numba.njit
def _simulate_camera(i, j, d, bearing, axis, senses, team, rng):
    # One camera: whether it has the other robot, and where; returns the true f*.
    facing = axis[0] * bearing[0] + axis[1] * bearing[1] + axis[2] * bearing[2]
    if facing > team.assumed_camera.a_min:
        senses.visibility[i, j] = True
        for k in range(3):
            senses.relative_position[i, j, k] = d * bearing[k]
            if team.camera_noise > 0:
                senses.relative_position[i, j, k] += team.camera_noise * rng.standard_normal()
    return cosine_ramp(facing, team.camera.a_min, team.camera.a_max)


@no_type_check
@numba.njit
def is_occluded(i, j, world, team):
    p, q = world.position[i], world.position[j]
    for k in range(len(world.position)):
        if k not in (i, j) and world.alive[k]:
            if segment_hits_sphere(p, q, world.position[k], team.body_radius):
                return True
    return blocks_line_of_sight(p, q, team.obstacles)


@no_type_check
@numba.njit
def simulate_range_sensors(world, senses, team):
    """What every range sensor finds: where something is, not what; robots and obstacles alike."""
    point, n, far = np.zeros(3), len(world.position), team.repulsion.max_distance
    o = team.obstacles
    others = len(o.spheres) + len(o.boxes) + len(o.planes)
    for i in range(n):
        senses.range_point_count[i] = 0
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
                d = nearest_point(k - n, p, o, point)
                world.min_obstacle_distance[i] = min(world.min_obstacle_distance[i], d)
            if d < far:
                x, y = point[0] - p[0], point[1] - p[1]
                found = senses.range_points[i, senses.range_point_count[i]]
                found[0], found[1], found[2] = c * x + s * y, c * y - s * x, point[2] - p[2]
                senses.range_point_count[i] += 1
