"""How one vehicle keeps away from others: by turning what it wants, or by stopping.

A vehicle sees those around it from itself. Every one of them forbids a sector of directions;
of those that remain it takes the nearest, if that turns it by 90° at most [Lusk2020, eq. 11].
"""

from math import acos, asin, atan2, cos, pi, sin, sqrt
from typing import NamedTuple, no_type_check

import numba
import numpy as np


class CollisionAvoidance(NamedTuple):
    """The numbers of the avoidance."""

    keep_out: float = 1.2  # least distance of two vehicles in the plane [m]
    avoidance_range: float = 3.0  # farthest at which others are heeded [m]
    margin: float = 0.05  # kept on top, for what measurements are wrong [m]
    braking: float = 0.25  # deceleration that a vehicle counts on to stop in time [m/s²]
    right_turn_bias: float = 0.35  # how much farther it turns right rather than left [rad]
    blocked_time: float = 3.0  # for which a vehicle lets others stop it [s],
    wander_time: float = 2.0  # before it goes anywhere, so long [s]
    legacy: bool = False  # sectors as in the paper's code: by the distance alone
    unwrapped_angles: bool = False  # with its angles that do not wrap around, too


@no_type_check
@numba.njit(cache=True)
def avoid_collisions(u, others, count, rules, centre, half):
    """Turn a velocity, or stop it, so that it leads towards nobody who is too near.

    Args:
        u: The velocity, (3,), changed in place; its height is left alone [m/s].
        others: Where the others are from here, in the plane, (≥ count, 2) [m].
        count: How many there are.
        rules: The numbers of the avoidance.
        centre: Room for the sectors' centres, (≥ count,).
        half: Room for their half-angles, (≥ count,).

    Returns:
        Whether anything was changed.
    """
    speed = sqrt(u[0] ** 2 + u[1] ** 2)
    if rules.legacy:
        sectors = _sectors_by_distance(others, count, rules, centre, half)
    else:
        sectors = _sectors_by_braking(others, count, speed, rules, centre, half)
    heading = atan2(u[1], u[0])
    if not _is_forbidden(heading, centre, half, sectors):
        return False
    turn = _smallest_turn(heading, centre, half, sectors, rules)
    if abs(turn) <= pi / 2 + 1e-9 and speed > 0:
        u[0], u[1] = speed * cos(heading + turn), speed * sin(heading + turn)
        return True
    if rules.legacy:
        u[:] = 0.0
    else:
        limit_approach(u, others, count, rules)
    return True


@no_type_check
@numba.njit(cache=True)
def max_approach_speed(distance, rules):
    """Fastest that one of two may move towards the other [m/s].

    Each has half of the gap to stop in: v = √(2 b · gap/2). Both braking at b, the gap
    closes as the speeds do. Those too near already part at a rate that grows with what
    is lacking.
    """
    gap = distance - rules.keep_out - rules.margin
    return sqrt(rules.braking * gap) if gap > 0 else 2 * gap


@no_type_check
@numba.njit(cache=True)
def _sectors_by_distance(others, count, rules, centre, half):
    # [Lusk2020]'s code: the directions that pass within the keep-out of a body at rest.
    sectors = 0
    for k in range(count):
        d = sqrt(others[k, 0] ** 2 + others[k, 1] ** 2)
        if d < rules.avoidance_range:
            centre[sectors] = atan2(others[k, 1], others[k, 0])
            half[sectors] = asin(min(1.0, rules.keep_out / d)) if d > 0 else pi / 2
            sectors += 1
    return sectors


@no_type_check
@numba.njit(cache=True)
def _sectors_by_braking(others, count, speed, rules, centre, half):
    # The directions in which this speed comes nearer faster than can be braked.
    sectors = 0
    for k in range(count):
        d = sqrt(others[k, 0] ** 2 + others[k, 1] ** 2)
        allowed = max_approach_speed(d, rules)
        if d < rules.avoidance_range and allowed < speed:
            centre[sectors] = atan2(others[k, 1], others[k, 0])
            # Where it is too slow to part as fast as it must, every direction is forbidden.
            half[sectors] = acos(allowed / speed) if allowed > -speed else 2 * pi
            sectors += 1
    return sectors


@no_type_check
@numba.njit(cache=True)
def _wrap_angle(angle):
    return (angle + pi) % (2 * pi) - pi


@no_type_check
@numba.njit(cache=True)
def _is_forbidden(heading, centre, half, sectors):
    for k in range(sectors):
        if abs(_wrap_angle(heading - centre[k])) < half[k] - 1e-9:
            return True
    return False


@no_type_check
@numba.njit(cache=True)
def _smallest_turn(heading, centre, half, sectors, rules):
    # The edges of the sectors that lie in no other; 2π where there is none.
    best, least = 2 * pi, np.inf
    for k in range(sectors):
        for side in (-1, 1):
            edge = _wrap_angle(centre[k] + side * half[k])
            turn = _wrap_angle(edge - heading)
            too_far = not rules.legacy and abs(turn) > pi / 2
            if too_far or _is_forbidden(edge, centre, half, sectors):
                continue
            effort = abs(edge - heading) if rules.unwrapped_angles else abs(turn)
            if not rules.legacy and turn > 0:
                effort += rules.right_turn_bias
            if effort < least:
                best, least = turn, effort
    return best


@no_type_check
@numba.njit(cache=True)
def limit_approach(u, others, count, rules):
    """Take from a velocity what approaches others too fast.

    Each of the others bounds the speed towards it, a half-plane of velocities; the nearest
    velocity in all of them is taken. To stand still is among them, except where some are too
    near already; between such, where no velocity parts from all of them, it is enough to
    approach none.

    Args:
        u: The velocity, (≥ 2,), changed in place; its height is left alone [m/s].
        others: Where the others are from here, in the plane, (≥ count, 2) [m].
        count: How many there are.
        rules: The numbers of the avoidance.

    Returns:
        Whether anything was changed.
    """
    x, y, found = _project_velocity(u[0], u[1], others, count, rules, -np.inf)
    if not found:
        x, y, _ = _project_velocity(u[0], u[1], others, count, rules, 0.0)
    changed = x != u[0] or y != u[1]
    u[0], u[1] = x, y
    return changed


@no_type_check
@numba.njit(cache=True)
def _project_velocity(u_x, u_y, others, count, rules, least):
    # The nearest velocity in the first half-planes, and whether there is one. Where it is not
    # in the next, the nearest in that too lies on its edge, where the others leave an interval.
    x, y = u_x, u_y
    for k in range(count):
        n_x, n_y, bound = _approach_half_plane(others[k], rules, least)
        if x * n_x + y * n_y <= bound:
            continue
        low, high = -np.inf, np.inf
        for i in range(k):
            m_x, m_y, limit = _approach_half_plane(others[i], rules, least)
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


@no_type_check
@numba.njit(cache=True)
def _approach_half_plane(other, rules, least):
    # The direction towards another, and the fastest in it.
    d = sqrt(other[0] ** 2 + other[1] ** 2)
    if not 0 < d < rules.avoidance_range:
        return 1.0, 0.0, np.inf
    return other[0] / d, other[1] / d, max(least, max_approach_speed(d, rules))
