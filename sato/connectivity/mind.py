"""What one robot makes of what it senses and is told, and what it does about it.

Each function is given the number of a robot and reads its rows alone: of its senses, its mail
and its mind. Nothing here is in any frame but the robot's own.
"""

from math import cos, sin, sqrt
from typing import no_type_check

import numba
import numpy as np

from problems.graph import edge, rise
from sato.connectivity.potential import push, steepness
from sato.connectivity.yaw import by_bearings, by_motion, correct, middle, observe, wrapped

MEMORY = 0.2  # for which what a neighbour said is used when nothing new comes [s]


@no_type_check
@numba.njit
def reckon(i, senses, mail, mind, team, time):
    """Robot i: how its neighbours are turned, its own edges and their gradients."""
    mine, theirs = np.zeros(3), np.zeros(3)
    link = team.link
    since = time - MEMORY - ((link.late + 1) * link.every - 1) * team.step
    for j in range(len(mind.turned)):
        if j == i:
            continue
        known = mail.when[i, j] >= since
        sees, seen = senses.sees[i, j], known and mail.his_sees[i, j]
        mind.weight[i, j] = 0.0
        for a in range(4):
            mind.motion[i, j, a] = 0.0
        mind.close[i, j] = sees and seen
        if sees and known:
            _track(i, j, seen, senses, mail, mind, team, time)
        elif seen:
            mind.turned[i, j] = _as_told(i, j, senses, mail, team, time)
        if sees or seen:
            turn = mind.turned[i, j]
            d = _bearings(senses.p[i, j], mail.his_p[i, j], sees, seen, turn, mine, theirs)
            mind.weight[i, j], _, _ = edge(
                d, mine, theirs, turn, sees, seen, team.sight, mind.motion[i, j]
            )
    if team.tracking.closure > 0 and not team.tracking.printed:
        _close_triangles(i, senses, mail, mind, team, since)
    for j in range(len(mind.turned)):
        mind.rows[i, i, j] = mind.weight[i, j]
    mind.stamp[i, i] = time


@no_type_check
@numba.njit
def _bearings(p, q, sees, seen, turn, mine, theirs):
    # Own and other's bearing, and the distance; who sees nothing turns what the other one sees
    # [Bernard2023, Sec. III-C, where the turn is printed the wrong way round].
    c, s = cos(turn), sin(turn)
    own = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    his = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2])
    for a in range(3):
        mine[a], theirs[a] = p[a] / own, q[a] / his
    if not sees:
        mine[0], mine[1] = -(c * theirs[0] - s * theirs[1]), -(s * theirs[0] + c * theirs[1])
        mine[2] = -theirs[2]
    if not seen:
        theirs[0], theirs[1] = -(c * mine[0] + s * mine[1]), -(c * mine[1] - s * mine[0])
        theirs[2] = -mine[2]
    return own if sees else his


@no_type_check
@numba.njit
def _track(i, j, seen, senses, mail, mind, team, time):
    dt, track, v = team.step, team.tracking, mail.his_motion[i, j]
    watch, p, q = mind.watch[i, j], senses.p[i, j], mail.his_p[i, j]
    observe(
        p, senses.p_before[i, j], not senses.saw[i, j], senses.velocity[i], senses.rate[i],
        v, watch, track, dt,
    )  # fmt: skip
    guessed, trust = by_motion(watch, v, track)
    turn, yaw = v[3] - senses.rate[i], mind.turned[i, j]
    mutual = _view(p, team.sight) * _view(q, team.sight) if seen else 0.0
    # Bearings belong together if they are of one time; without news there are none.
    both = seen and mail.news[i, j] and not np.isnan(mail.p_then[i, j, 0])
    measured = yaw
    if both:
        measured = by_bearings(mail.p_then[i, j], q) + (time - mail.when[i, j]) * turn
    yaw = correct(yaw, turn, mutual, measured, guessed, trust, track, dt)
    if both:
        yaw = middle(yaw, -_as_told(i, j, senses, mail, team, time))
    mind.turned[i, j] = yaw


@no_type_check
@numba.njit
def _as_told(i, j, senses, mail, team, time):
    # ψ̃_ij by what j reckoned a step before it told, and how both have turned since.
    since = time - mail.when[i, j] + team.step
    turn = mail.his_motion[i, j, 3] - senses.rate[i]
    return wrapped(since * turn - mail.his_turned[i, j, i])


@no_type_check
@numba.njit
def _view(p, sight):
    d = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    facing = (sight.axis[0] * p[0] + sight.axis[1] * p[1] + sight.axis[2] * p[2]) / d
    return rise(facing, sight.a_min, sight.a_max)


@no_type_check
@numba.njit
def _close_triangles(i, senses, mail, mind, team, since):
    # Where only one of i and j sees the other, somebody in sight of both knows more.
    n, gain = len(mind.turned), team.step * team.tracking.closure
    for j in range(n):
        if j == i or mind.close[i, j] or not senses.sees[i, j]:
            continue
        off, count = 0.0, 0
        for k in range(n):
            if k == i or k == j or mail.when[i, k] < since:
                continue
            if mind.close[i, k] and mail.his_close[i, k, j]:
                off += sin(mind.turned[i, k] + mail.his_turned[i, k, j] - mind.turned[i, j])
                count += 1
        if count > 0:
            mind.turned[i, j] = wrapped(mind.turned[i, j] + gain * off / count)


@no_type_check
@numba.njit
def decide(i, senses, mind, team):
    """Robot i: velocity and yaw rate, but for what an operator adds [Bernard2023, eq. 5].

    A robot without an edge, or that does not know λ₂, keeps away from what is near and holds.
    """
    u, n = mind.command[i], len(mind.turned)
    linked = False
    for a in range(4):
        u[a] = 0.0
    for j in range(n):
        linked = linked or mind.weight[i, j] > 0
    if linked and not np.isnan(mind.lambda2[i]):
        steep = steepness(mind.lambda2[i], team.potential)
        for j in range(n):
            for a in range(4):
                u[a] += steep * mind.felt[i, j] * mind.motion[i, j, a]
    for k in range(senses.around[i]):
        o = senses.points[i, k]
        away = push(sqrt(o[0] * o[0] + o[1] * o[1] + o[2] * o[2]), team.repulsion)
        for a in range(3):
            u[a] -= away * o[a]
    speed = sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    if speed > team.limits.speed:
        for a in range(3):
            u[a] *= team.limits.speed / speed
    u[3] = min(max(u[3], -team.limits.turn), team.limits.turn)
