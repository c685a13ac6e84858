"""Collision avoidance of one agent: turn the velocity command, or stop.

An agent senses those around it, relative to itself. Each of them forbids a sector of
directions; of the directions that remain the closest is taken, if it is at most 90° from the
command [Lusk2020, eq. 11].
"""

from math import acos, asin, atan2, cos, pi, sin, sqrt

import numba
import numpy as np


@numba.njit(cache=True)
def avoid_collisions(u, others, count, keep_out, rules, center, half):
    """Turn a velocity, or stop it, so that it approaches no other agent too fast.

    Args:
        u: Velocity, (3,), changed in place; its vertical part is left alone [m/s].
        others: Relative positions of the others in the plane, (≥ count, 2) [m].
        count: Number of others.
        keep_out: Least distance of two agents [m].
        rules: Numbers of the avoidance, a `CollisionAvoidance`.
        center: Buffer for the centers of the sectors, (≥ count,).
        half: Buffer for their half-angles, (≥ count,).

    Returns:
        True where the velocity was changed.
    """
    speed = sqrt(u[0] ** 2 + u[1] ** 2)
    sectors = _forbidden_sectors(others, count, speed, keep_out, rules, center, half)
    heading = atan2(u[1], u[0])
    if not _is_forbidden(heading, center, half, sectors):
        return False
    turn = _smallest_turn(heading, center, half, sectors, rules)
    if abs(turn) <= pi / 2 + 1e-9 and speed > 0:
        u[0], u[1] = speed * cos(heading + turn), speed * sin(heading + turn)
        return True
    if rules.legacy:
        u[:] = 0.0
    else:
        limit_approach(u, others, count, keep_out, rules)
    return True


@numba.njit(cache=True)
def max_approach_speed(distance, keep_out, rules):
    """Return the largest speed of one of two agents towards the other [m/s].

    Each has half of the gap to stop in: v = √(2 b · gap/2). With both braking at b, the gap
    closes as the speeds do. Agents that are too close separate at a rate that grows with
    what is missing.
    """
    gap = distance - keep_out - rules.margin
    return sqrt(rules.braking * gap) if gap > 0 else 2 * gap


@numba.njit(cache=True)
def _forbidden_sectors(others, count, speed, keep_out, rules, center, half):
    # Directions in which this speed approaches another agent faster than it can brake. In
    # [Lusk2020]'s code: directions that pass within the keep-out distance of a body at rest.
    sectors = 0
    for k in range(count):
        d = sqrt(others[k, 0] ** 2 + others[k, 1] ** 2)
        allowed = max_approach_speed(d, keep_out, rules)
        if d >= rules.avoidance_range or (allowed >= speed and not rules.legacy):
            continue
        center[sectors] = atan2(others[k, 1], others[k, 0])
        if rules.legacy:
            half[sectors] = asin(min(1.0, keep_out / d)) if d > 0 else pi / 2
        else:
            # A speed too small to separate as fast as required is forbidden in all directions.
            half[sectors] = acos(allowed / speed) if allowed > -speed else 2 * pi
        sectors += 1
    return sectors


@numba.njit(cache=True)
def _wrap_angle(angle):
    return (angle + pi) % (2 * pi) - pi


@numba.njit(cache=True)
def _is_forbidden(heading, center, half, sectors):
    for k in range(sectors):
        if abs(_wrap_angle(heading - center[k])) < half[k] - 1e-9:
            return True
    return False


@numba.njit(cache=True)
def _smallest_turn(heading, center, half, sectors, rules):
    # Candidates are the edges of sectors that lie in no other sector; 2π where there is none.
    best, least = 2 * pi, np.inf
    for k in range(sectors):
        for side in (-1, 1):
            edge = _wrap_angle(center[k] + side * half[k])
            turn = _wrap_angle(edge - heading)
            too_far = not rules.legacy and abs(turn) > pi / 2
            if too_far or _is_forbidden(edge, center, half, sectors):
                continue
            effort = abs(edge - heading) if rules.unwrapped_angles else abs(turn)
            if not rules.legacy and turn > 0:
                effort += rules.right_turn_bias
            if effort < least:
                best, least = turn, effort
    return best


@numba.njit(cache=True)
def limit_approach(u, others, count, keep_out, rules):
    """Project a velocity onto those that approach no other agent too fast.

    Each of the others bounds the speed towards it, which makes a half-plane of velocities; the
    closest velocity in all of them is taken. Standing still is one of them, except where some
    agents are too close already. Where no velocity separates from all of these, one that
    approaches none of them is taken.

    Args:
        u: Velocity, (≥ 2,), changed in place; its vertical part is left alone [m/s].
        others: Relative positions of the others in the plane, (≥ count, 2) [m].
        count: Number of others.
        keep_out: Least distance of two agents [m].
        rules: Numbers of the avoidance, a `CollisionAvoidance`.

    Returns:
        True where the velocity was changed.
    """
    x, y, found = _project_velocity(u[0], u[1], others, count, keep_out, rules, -np.inf)
    if not found:
        x, y, _ = _project_velocity(u[0], u[1], others, count, keep_out, rules, 0.0)
    changed = x != u[0] or y != u[1]
    u[0], u[1] = x, y
    return changed


@numba.njit(cache=True)
def _project_velocity(u_x, u_y, others, count, keep_out, rules, least):
    # Returns the closest velocity in the half-planes, and whether there is one. Half-planes
    # are added one by one: where the closest velocity so far is outside the next one, the new
    # closest lies on its edge, in the interval that the earlier ones leave there.
    x, y = u_x, u_y
    for k in range(count):
        n_x, n_y, bound = _approach_half_plane(others[k], keep_out, rules, least)
        if x * n_x + y * n_y <= bound:
            continue
        low, high = -np.inf, np.inf
        for i in range(k):
            m_x, m_y, limit = _approach_half_plane(others[i], keep_out, rules, least)
            across = m_y * n_x - m_x * n_y
            room = limit - bound * (m_x * n_x + m_y * n_y)
            if across > 1e-12:
                high = min(high, room / across)
            elif across < -1e-12:
                low = max(low, room / across)
            elif room < -1e-12:
                return u_x, u_y, False
        if low > high + 1e-12:
            return u_x, u_y, False
        along = min(max(u_y * n_x - u_x * n_y, low), high)
        x, y = bound * n_x - along * n_y, bound * n_y + along * n_x
    return x, y, True


@numba.njit(cache=True)
def _approach_half_plane(other, keep_out, rules, least):
    # Direction towards another agent, and the largest speed in it.
    d = sqrt(other[0] ** 2 + other[1] ** 2)
    if not 0 < d < rules.avoidance_range:
        return 1.0, 0.0, np.inf
    return other[0] / d, other[1] / d, max(least, max_approach_speed(d, keep_out, rules))
