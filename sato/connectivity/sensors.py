"""Cameras and range sensors: the only readers of the truth."""

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
def simulate_cameras(truth, measurements, parameters, rng):
    """Measure with every camera, and compute the true weights."""
    n, camera = len(truth.position), parameters.camera
    bearing, bearing_back = np.zeros(3), np.zeros(3)
    level_axis, axis = np.array(camera.optical_axis), np.zeros((n, 3))
    for i in range(n):
        axis[i] = level_axis
        if parameters.is_quadrotor:
            rotate_to_heading_frame(level_axis, truth.acceleration[i], truth.yaw[i], axis[i])
    measurements.previous_visibility[:] = measurements.visibility
    measurements.previous_relative_position[:] = measurements.relative_position
    measurements.visibility[:] = False
    truth.weight[:] = 0.0
    for i in range(n):
        for j in range(i):
            if not (truth.alive[i] and truth.alive[j]):
                continue
            d = bearings(truth.position, truth.yaw, i, j, bearing, bearing_back)
            if not camera.d_min < d < camera.d_max:
                continue
            if parameters.occlusion and is_occluded(
                i, j, truth.position, truth.alive, parameters.body_radius, parameters.obstacles
            ):
                continue
            f = _simulate_camera(i, j, d, bearing, axis[i], measurements, parameters, rng)
            g = _simulate_camera(j, i, d, bearing_back, axis[j], measurements, parameters, rng)
            gamma, _ = range_weight(d, camera)
            truth.weight[i, j] = truth.weight[j, i] = gamma * (f + g - f * g)


@no_type_check
@numba.njit
def _simulate_camera(i, j, d, bearing, axis, measurements, parameters, rng):
    # Returns the true f*.
    cosine = axis[0] * bearing[0] + axis[1] * bearing[1] + axis[2] * bearing[2]
    if cosine > parameters.assumed_camera.a_min:
        measurements.visibility[i, j] = True
        for k in range(3):
            measurements.relative_position[i, j, k] = d * bearing[k]
            if parameters.camera_noise > 0:
                noise = parameters.camera_noise * rng.standard_normal()
                measurements.relative_position[i, j, k] += noise
    return cosine_ramp(cosine, parameters.camera.a_min, parameters.camera.a_max)[0]


@no_type_check
@numba.njit
def is_occluded(i, j, position, alive, body_radius, obstacles):
    """Tell whether a live agent or an obstacle blocks the line of sight of two agents."""
    for k in range(len(position)):
        if k not in (i, j) and alive[k]:
            if segment_hits_sphere(position[i], position[j], position[k], body_radius):
                return True
    return blocks_line_of_sight(position[i], position[j], obstacles)


@no_type_check
@numba.njit
def simulate_range_sensors(truth, measurements, parameters):
    """Measure the nearest points of all agents and obstacles in range, without telling which."""
    n, obstacles, point = len(truth.position), parameters.obstacles, np.zeros(3)
    total = len(obstacles.spheres) + len(obstacles.boxes) + len(obstacles.planes)
    for i in range(n):
        measurements.range_point_count[i] = 0
        if not truth.alive[i]:
            continue
        p, c, s = truth.position[i], cos(truth.yaw[i]), sin(truth.yaw[i])
        for k in range(n + total):
            if k < n:
                if k == i or not truth.alive[k]:
                    continue
                point[:] = truth.position[k]
                d = sqrt((point[0] - p[0]) ** 2 + (point[1] - p[1]) ** 2 + (point[2] - p[2]) ** 2)
            else:
                d = nearest_point(k - n, p, obstacles, point)
            if d < parameters.repulsion.max_distance:
                x, y = point[0] - p[0], point[1] - p[1]
                found = measurements.range_points[i, measurements.range_point_count[i]]
                found[0], found[1], found[2] = c * x + s * y, c * y - s * x, point[2] - p[2]
                measurements.range_point_count[i] += 1
