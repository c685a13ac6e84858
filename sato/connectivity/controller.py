"""What one robot makes of what it senses and is told, and what it does about it.

Each function is given the number of a robot and reads its rows alone: of its senses, its mail
and its mind. Nothing here is in any frame but the robot's own.
"""

from math import cos, sin, sqrt
from typing import Annotated, NamedTuple, no_type_check

import numba
import numpy as np

from dynamics.units import AngularRate, Key, Speed
from problems.interaction_graph import cosine_ramp, edge_weight
from sato.connectivity.potential import negative_slope, repulsion_gain
from sato.connectivity.yaw_estimator import (
    circular_mean,
    update_velocity_observer,
    update_yaw_estimate,
    wrap_angle,
    yaw_from_bearings,
    yaw_from_motion,
)
from sato.scenario.definition import Positive

MAX_MESSAGE_AGE = 0.2  # for which what a neighbour said is used when nothing new comes [s]


class CommandLimits(NamedTuple):
    """Limits of what a robot commands, beside the operator's command to the leader."""

    speed: Annotated[Speed, Positive, "largest speed"] = 3.0
    yaw_rate: Annotated[AngularRate, Key("turn"), Positive, "largest yaw rate"] = 1.5


@no_type_check
@numba.njit
def estimate_edges(i, senses, mail, mind, team, time):
    """Robot i: how its neighbours are turned, its own edges and their gradients."""
    mine, theirs = np.zeros(3), np.zeros(3)
    link = team.link
    since = time - MAX_MESSAGE_AGE - ((link.delay_messages + 1) * link.period_steps - 1) * team.step
    for j in range(len(mind.relative_yaw)):
        if j == i:
            continue
        known = mail.received_time[i, j] >= since
        sees, seen = senses.visibility[i, j], known and mail.received_visibility[i, j]
        mind.weight[i, j] = 0.0
        for a in range(4):
            mind.weight_gradient[i, j, a] = 0.0
        mind.is_mutual[i, j] = sees and seen
        if sees and known:
            _update_relative_yaw(i, j, seen, senses, mail, mind, team, time)
        elif seen:
            mind.relative_yaw[i, j] = _yaw_from_message(i, j, senses, mail, team, time)
        if sees or seen:
            turn = mind.relative_yaw[i, j]
            d = _mutual_bearings(
                senses.relative_position[i, j],
                mail.received_relative_position[i, j],
                sees,
                seen,
                turn,
                mine,
                theirs,
            )
            mind.weight[i, j], _, _ = edge_weight(
                d, mine, theirs, turn, sees, seen, team.assumed_camera, mind.weight_gradient[i, j]
            )
    if team.tracking.closure_gain > 0 and not team.tracking.as_printed:
        _close_triangles(i, senses, mail, mind, team, since)
    for j in range(len(mind.relative_yaw)):
        mind.adjacency_rows[i, i, j] = mind.weight[i, j]
    mind.row_time[i, i] = time


@no_type_check
@numba.njit
def _mutual_bearings(p, q, sees, seen, turn, mine, theirs):
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
def _update_relative_yaw(i, j, seen, senses, mail, mind, team, time):
    dt, track, v = team.step, team.tracking, mail.received_twist[i, j]
    watch, p, q = (
        mind.velocity_observer[i, j],
        senses.relative_position[i, j],
        mail.received_relative_position[i, j],
    )
    update_velocity_observer(
        p, senses.previous_relative_position[i, j], not senses.previous_visibility[i, j], senses.velocity[i], senses.yaw_rate[i],
        v, watch, track, dt,
    )  # fmt: skip
    guessed, trust = yaw_from_motion(watch, v, track)
    turn, yaw = v[3] - senses.yaw_rate[i], mind.relative_yaw[i, j]
    mutual = (
        _view_weight(p, team.assumed_camera) * _view_weight(q, team.assumed_camera) if seen else 0.0
    )
    # Bearings belong together if they are of one time; without news there are none.
    both = seen and mail.is_new[i, j] and not np.isnan(mail.relative_position_when_sent[i, j, 0])
    measured = yaw
    if both:
        measured = (
            yaw_from_bearings(mail.relative_position_when_sent[i, j], q)
            + (time - mail.received_time[i, j]) * turn
        )
    yaw = update_yaw_estimate(yaw, turn, mutual, measured, guessed, trust, track, dt)
    if both:
        yaw = circular_mean(yaw, -_yaw_from_message(i, j, senses, mail, team, time))
    mind.relative_yaw[i, j] = yaw


@no_type_check
@numba.njit
def _yaw_from_message(i, j, senses, mail, team, time):
    # ψ̃_ij by what j reckoned a step before it told, and how both have turned since.
    since = time - mail.received_time[i, j] + team.step
    turn = mail.received_twist[i, j, 3] - senses.yaw_rate[i]
    return wrap_angle(since * turn - mail.received_relative_yaw[i, j, i])


@no_type_check
@numba.njit
def _view_weight(p, sight):
    d = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    facing = (
        sight.optical_axis[0] * p[0] + sight.optical_axis[1] * p[1] + sight.optical_axis[2] * p[2]
    ) / d
    return cosine_ramp(facing, sight.a_min, sight.a_max)


@no_type_check
@numba.njit
def _close_triangles(i, senses, mail, mind, team, since):
    # Where only one of i and j sees the other, somebody in sight of both knows more.
    n, gain = len(mind.relative_yaw), team.step * team.tracking.closure_gain
    for j in range(n):
        if j == i or mind.is_mutual[i, j] or not senses.visibility[i, j]:
            continue
        off, count = 0.0, 0
        for k in range(n):
            if k == i or k == j or mail.received_time[i, k] < since:
                continue
            if mind.is_mutual[i, k] and mail.received_is_mutual[i, k, j]:
                off += sin(
                    mind.relative_yaw[i, k]
                    + mail.received_relative_yaw[i, k, j]
                    - mind.relative_yaw[i, j]
                )
                count += 1
        if count > 0:
            mind.relative_yaw[i, j] = wrap_angle(mind.relative_yaw[i, j] + gain * off / count)


@no_type_check
@numba.njit
def compute_command(i, senses, mind, team):
    """Robot i: velocity and yaw rate, but for what an operator adds [Bernard2023, eq. 5].

    A robot without an edge, or that does not know λ₂, keeps away from what is near and holds.
    """
    u, n = mind.command[i], len(mind.relative_yaw)
    linked = False
    for a in range(4):
        u[a] = 0.0
    for j in range(n):
        linked = linked or mind.weight[i, j] > 0
    if linked and not np.isnan(mind.lambda2[i]):
        steep = negative_slope(mind.lambda2[i], team.potential)
        for j in range(n):
            for a in range(4):
                u[a] += steep * mind.lambda2_gradient[i, j] * mind.weight_gradient[i, j, a]
    for k in range(senses.range_point_count[i]):
        o = senses.range_points[i, k]
        away = repulsion_gain(sqrt(o[0] * o[0] + o[1] * o[1] + o[2] * o[2]), team.repulsion)
        for a in range(3):
            u[a] -= away * o[a]
    speed = sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    if speed > team.limits.speed:
        for a in range(3):
            u[a] *= team.limits.speed / speed
    u[3] = min(max(u[3], -team.limits.yaw_rate), team.limits.yaw_rate)
