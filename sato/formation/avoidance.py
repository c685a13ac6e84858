"""Collision avoidance of one agent: the closest velocity that lets all pass and stop in time.

An agent senses those around it, relative to itself. Each of them makes two half-planes of its
velocities. In one, it approaches no faster than both can brake, which keeps them apart. In the
other, it does half of what keeps both clear for some time if they fly on, which lets them pass
[vandenBerg2011].
"""

from math import atan2, cos, pi, sin, sqrt

import numpy as np

from problems.kernels import compiled

SPEED_SIDES = 8  # of the polygon of speeds
HALVINGS = 3  # of the time for which others are to be passed


@compiled()
def avoid_all(u, v, others, start, keep_out, rules, max_speed, most, planes, changed):
    """Let every agent avoid those that it tracks, also while its velocity still changes.

    Args:
        u: Wanted velocities, (agents, ≥ 2), changed in place [m/s].
        v: Velocities flown, (agents, 2) [m/s].
        others: Relative positions and velocities of the others, (pairs, 4) [m, m/s].
        start: First pair of each agent, (agents + 1,).
        keep_out: Least distance of two agents [m].
        rules: Numbers of the avoidance, a `CollisionAvoidance`.
        max_speed: Largest speed [m/s].
        most: Largest change of a velocity in a step [m/s].
        planes: Buffer for half-planes, (≥ 2 agents + 8, 3).
        changed: Written: True where the velocity was changed.
    """
    w = np.empty(2)
    for i in range(len(u)):
        near, count = others[start[i] : start[i + 1]], start[i + 1] - start[i]
        changed[i] = avoid_collisions(u[i], v[i], near, count, keep_out, rules, max_speed, planes)
        # While the velocity turns, others must not be approached too fast either.
        x, y = u[i, 0] - v[i, 0], u[i, 1] - v[i, 1]
        change = sqrt(x * x + y * y)
        share = most / change if change > most else 1.0
        w[0], w[1] = v[i, 0] + share * x, v[i, 1] + share * y
        if limit_approach(w, near, count, keep_out, rules, planes):
            u[i, 0], u[i, 1] = w[0], w[1]


@compiled()
def avoid_collisions(u, v, others, count, keep_out, rules, max_speed, planes):
    """Replace a velocity by the closest one with which the agent passes all others.

    Where others leave no such velocity, they are to be passed for a shorter time; where none is
    left at all, the agent comes as near to standing still as it may. A command that has to change
    is turned to the right first, so that two that meet head-on pass.

    Args:
        u: Wanted velocity, (≥ 2,), changed in place; its vertical part is left alone [m/s].
        v: Velocity flown, (2,) [m/s].
        others: Relative positions and velocities of the others, (≥ count, 4) [m, m/s].
        count: Number of others.
        keep_out: Least distance of two agents [m].
        rules: Numbers of the avoidance, a `CollisionAvoidance`.
        max_speed: Largest speed [m/s].
        planes: Buffer for half-planes n·u ≤ b, (≥ 2 count + 8, 3).

    Returns:
        True where the velocity was changed.
    """
    if count == 0:
        return False
    _bound_approach(others, count, keep_out, rules, -np.inf, planes)
    rows = 2 * count + SPEED_SIDES
    horizon, bias = rules.horizon, rules.right_turn_bias
    x, y = u[0], u[1]
    heading = atan2(y, x) if x != 0 or y != 0 else atan2(others[0, 1], others[0, 0])
    for k in range(SPEED_SIDES):
        angle = heading + 2 * pi * k / SPEED_SIDES
        plane = planes[rows - 1 - k]
        plane[0], plane[1], plane[2] = cos(angle), sin(angle), max_speed
    for halved in range(HALVINGS + 1):
        for k in range(count):
            _share_avoidance(v, others[k], keep_out + rules.margin, horizon, planes[count + k])
        if halved == 0:
            if _holds(x, y, planes, rows):
                return False
            x, y = x * cos(bias) + y * sin(bias), y * cos(bias) - x * sin(bias)
        u[0], u[1], found = _project(x, y, planes, rows)
        if found:
            return True
        horizon /= 2
    u[0] = u[1] = 0.0
    limit_approach(u, others, count, keep_out, rules, planes)
    return True


@compiled()
def max_approach_speed(distance, keep_out, rules):
    """Return the largest speed of one of two agents towards the other [m/s].

    Each has half of the gap to stop in: v = √(2 b · gap/2). With both braking at b, the gap
    closes as the speeds do. Agents that are too close separate at a rate that grows with
    what is missing.
    """
    gap = distance - keep_out - rules.margin
    return sqrt(rules.braking * gap) if gap > 0 else 2 * gap


@compiled()
def limit_approach(u, others, count, keep_out, rules, planes):
    """Project a velocity onto those that approach no other agent too fast.

    Each of the others bounds the speed towards it, which makes a half-plane of velocities; the
    closest velocity in all of them is taken. Standing still is one of them, except where some
    agents are too close already. Where no velocity separates from all of these, one that
    approaches none of them is taken.

    Args:
        u: Velocity, (≥ 2,), changed in place; its vertical part is left alone [m/s].
        others: Relative positions of the others in the plane, (≥ count, ≥ 2) [m].
        count: Number of others.
        keep_out: Least distance of two agents [m].
        rules: Numbers of the avoidance, a `CollisionAvoidance`.
        planes: Buffer for half-planes, (≥ count, 3).

    Returns:
        True where the velocity was changed.
    """
    _bound_approach(others, count, keep_out, rules, -np.inf, planes)
    x, y, found = _project(u[0], u[1], planes, count)
    if not found:
        _bound_approach(others, count, keep_out, rules, 0.0, planes)
        x, y, _ = _project(u[0], u[1], planes, count)
    changed = x != u[0] or y != u[1]
    u[0], u[1] = x, y
    return changed


@compiled()
def _bound_approach(others, count, keep_out, rules, least, planes):
    # Directions towards the others, and the largest speed in each.
    for k in range(count):
        x, y, plane = others[k, 0], others[k, 1], planes[k]
        d = sqrt(x**2 + y**2)
        plane[0], plane[1], plane[2] = 1.0, 0.0, np.inf
        if 0 < d < rules.avoidance_range:
            most = max(least, max_approach_speed(d, keep_out, rules))
            plane[0], plane[1], plane[2] = x / d, y / d, most


@compiled()
def _share_avoidance(v, other, radius, horizon, plane):
    """Make the half-plane of velocities that do half of what avoids another in some time.

    Relative velocities that lead within the radius make a cone, cut off by the circle of those
    that only do so later. The nearest point of its boundary says how the relative velocity has to
    change, and each of the two changes by half.
    """
    x, y = other[0], other[1]
    w_x, w_y = v[0] - other[2], v[1] - other[3]  # relative velocity of approach
    c_x, c_y = w_x - x / horizon, w_y - y / horizon
    square, size = x**2 + y**2, sqrt(c_x**2 + c_y**2)
    along = c_x * x + c_y * y
    if square <= radius**2:  # too near to pass: braking alone counts
        plane[0], plane[1], plane[2] = 1.0, 0.0, np.inf
        return
    if along < 0 and along**2 > (radius * size) ** 2:
        n_x, n_y = c_x / size, c_y / size
        change = radius / horizon - size
    else:
        leg = sqrt(square - radius**2)
        side = 1.0 if x * c_y - y * c_x > 0 else -1.0
        n_x = -side * (y * leg + side * x * radius) / square
        n_y = side * (x * leg - side * y * radius) / square
        change = -(w_x * n_x + w_y * n_y)
    plane[0], plane[1] = -n_x, -n_y
    plane[2] = -(n_x * v[0] + n_y * v[1] + change / 2)


@compiled()
def _holds(x, y, planes, rows):
    for k in range(rows):
        if planes[k, 0] * x + planes[k, 1] * y > planes[k, 2] + 1e-12:
            return False
    return True


@compiled()
def _project(u_x, u_y, planes, rows):
    # Returns the closest velocity in the half-planes, and whether there is one. Half-planes
    # are added one by one: where the closest velocity so far is outside the next one, the new
    # closest lies on its edge, in the interval that the earlier ones leave there.
    x, y = u_x, u_y
    for k in range(rows):
        n_x, n_y, bound = planes[k, 0], planes[k, 1], planes[k, 2]
        if x * n_x + y * n_y <= bound:
            continue
        low, high = -np.inf, np.inf
        for i in range(k):
            m_x, m_y, limit = planes[i, 0], planes[i, 1], planes[i, 2]
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
