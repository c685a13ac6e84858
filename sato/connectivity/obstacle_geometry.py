"""Compiled geometry of obstacles: nearest points and lines of sight."""

from typing import no_type_check

import numba
import numpy as np


@no_type_check
@numba.njit
def nearest_point(number, p, obstacles, point):
    """Find the nearest point of an obstacle; return its distance, negative inside [m].

    Args:
        number: Index of the obstacle: spheres first, then boxes, then planes.
        p: Position, (3,) [m].
        obstacles: Obstacles.
        point: Output, the nearest point of the surface, (3,) [m].
    """
    s, b = len(obstacles.spheres), len(obstacles.boxes)
    if number < s:
        return _nearest_on_sphere(p, obstacles.spheres[number], point)
    if number < s + b:
        return _nearest_on_box(p, obstacles.boxes[number - s], point)
    plane = obstacles.planes[number - s - b]
    d = plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] - plane[3]
    for a in range(3):
        point[a] = p[a] - d * plane[a]
    return d


@no_type_check
@numba.njit
def _nearest_on_sphere(p, sphere, point):
    square = 0.0
    for a in range(3):
        square += (p[a] - sphere[a]) ** 2
    far = np.sqrt(square)
    for a in range(3):
        outwards = (p[a] - sphere[a]) / far if far > 0 else (1.0 if a == 0 else 0.0)
        point[a] = sphere[a] + sphere[3] * outwards
    return far - sphere[3]


@no_type_check
@numba.njit
def _nearest_on_box(p, box, point):
    square, depth, side = 0.0, np.inf, 0
    for a in range(3):
        point[a] = min(max(p[a], box[a]), box[3 + a])
        square += (p[a] - point[a]) ** 2
        for end in (a, 3 + a):
            if abs(p[a] - box[end]) < depth:
                depth, side = abs(p[a] - box[end]), end
    if square > 0:
        return np.sqrt(square)
    point[side % 3] = box[side]
    return -depth


@no_type_check
@numba.njit
def blocks_line_of_sight(p, q, obstacles):
    """Tell whether an obstacle is between two positions."""
    for sphere in obstacles.spheres:
        if segment_hits_sphere(p, q, sphere[:3], sphere[3]):
            return True
    for box in obstacles.boxes:
        if _segment_hits_box(p, q, box):
            return True
    for plane in obstacles.planes:
        of_p = plane[0] * p[0] + plane[1] * p[1] + plane[2] * p[2] - plane[3]
        of_q = plane[0] * q[0] + plane[1] * q[1] + plane[2] * q[2] - plane[3]
        if min(of_p, of_q) < 0:
            return True
    return False


@no_type_check
@numba.njit
def segment_hits_sphere(p, q, center, radius):
    """Tell whether the segment between two positions meets a ball."""
    along, length = 0.0, 0.0
    for a in range(3):
        along += (center[a] - p[a]) * (q[a] - p[a])
        length += (q[a] - p[a]) ** 2
    t = min(max(along / length, 0.0), 1.0) if length > 0 else 0.0
    square = 0.0
    for a in range(3):
        square += (p[a] + t * (q[a] - p[a]) - center[a]) ** 2
    return square < radius * radius


@no_type_check
@numba.njit
def _segment_hits_box(p, q, box):
    enters, leaves = 0.0, 1.0
    for a in range(3):
        way = q[a] - p[a]
        if way == 0:
            if p[a] <= box[a] or p[a] >= box[3 + a]:
                return False
            continue
        first, second = (box[a] - p[a]) / way, (box[3 + a] - p[a]) / way
        enters, leaves = max(enters, min(first, second)), min(leaves, max(first, second))
    return enters < leaves
