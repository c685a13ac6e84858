"""Collision avoidance as printed: turn the velocity command out of sectors, or stop.

Each of the others forbids a sector of directions; of the directions that remain the closest is
taken, if it is at most 90° from the command [Lusk2020, eq. 11].
"""

from math import asin, atan2, cos, pi, sin, sqrt

import numpy as np

from problems.kernels import compiled


@compiled()
def turn_out_of_sectors(u, others, start, keep_out, rules, changed):
    """Turn the velocities of all agents, by `leave_sectors`.

    Args:
        u: Velocities, (agents, 3), changed in place [m/s].
        others: Relative positions of the others, (pairs, 2) [m].
        start: First pair of each agent, (agents + 1,).
        keep_out: Least distance of two agents [m].
        rules: Numbers of the avoidance, a `CollisionAvoidance`.
        changed: Written: True where the velocity was changed.
    """
    buffer = np.empty((len(u), 2))
    for i in range(len(u)):
        near, count = others[start[i] : start[i + 1]], start[i + 1] - start[i]
        changed[i] = leave_sectors(u[i], near, count, keep_out, rules, buffer)


@compiled()
def leave_sectors(u, others, count, keep_out, rules, buffer):
    """Turn a velocity, or stop it, so that it points at no other agent.

    Args:
        u: Velocity, (3,), changed in place; where it turns, its vertical part is left alone [m/s].
        others: Relative positions of the others in the plane, (≥ count, ≥ 2) [m].
        count: Number of others.
        keep_out: Least distance of two agents [m].
        rules: Numbers of the avoidance, a `CollisionAvoidance`.
        buffer: Buffer for the centers and half-angles of the sectors, (≥ count, ≥ 2).

    Returns:
        True where the velocity was changed.
    """
    speed = sqrt(u[0] ** 2 + u[1] ** 2)
    center, half = buffer[:, 0], buffer[:, 1]
    sectors = _forbidden_sectors(others, count, keep_out, rules, center, half)
    heading = atan2(u[1], u[0])
    if not _is_forbidden(heading, center, half, sectors):
        return False
    turn = _smallest_turn(heading, center, half, sectors, rules)
    if abs(turn) <= pi / 2 + 1e-9 and speed > 0:
        u[0], u[1] = speed * cos(heading + turn), speed * sin(heading + turn)
    else:
        u[0] = u[1] = u[2] = 0.0
    return True


@compiled()
def _forbidden_sectors(others, count, keep_out, rules, center, half):
    # Directions that pass within the keep-out distance of a body at rest.
    sectors = 0
    for k in range(count):
        d = sqrt(others[k, 0] ** 2 + others[k, 1] ** 2)
        if d < rules.avoidance_range:
            center[sectors] = atan2(others[k, 1], others[k, 0])
            half[sectors] = asin(min(1.0, keep_out / d)) if d > 0 else pi / 2
            sectors += 1
    return sectors


@compiled()
def _wrap_angle(angle):
    return (angle + pi) % (2 * pi) - pi


@compiled()
def _is_forbidden(heading, center, half, sectors):
    for k in range(sectors):
        if abs(_wrap_angle(heading - center[k])) < half[k] - 1e-9:
            return True
    return False


@compiled()
def _smallest_turn(heading, center, half, sectors, rules):
    # Candidates are the edges of sectors that lie in no other sector; 2π where there is none.
    best, least = 2 * pi, np.inf
    for k in range(sectors):
        for side in (-1, 1):
            edge = _wrap_angle(center[k] + side * half[k])
            if _is_forbidden(edge, center, half, sectors):
                continue
            turn = _wrap_angle(edge - heading)
            effort = abs(edge - heading) if rules.unwrapped_angles else abs(turn)
            if effort < least:
                best, least = turn, effort
    return best
