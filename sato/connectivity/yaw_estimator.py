"""How one robot keeps track of how another one is turned [Bernard2023, Sec. IV].

A camera tells where the other robot is and not how it is turned. Where both see each other,
the two bearings settle it. Where only one sees, it compares how it sees the other one move
with the velocity that the other one says it has.
"""

from math import atan2, cos, exp, pi, sin, sqrt
from typing import Annotated, NamedTuple, no_type_check

import numba

from dynamics.units import Key, Speed
from problems.interaction_graph import cosine_ramp
from sato.scenario.definition import NotNegative, Positive


class YawTracking(NamedTuple):
    """The numbers of the estimator."""

    k1: Annotated[float, Positive, "gain of the velocity observer [1/s]"] = 10.0
    k2: Annotated[float, NotNegative, "gain of the correction by motion [1/s]"] = 10.0
    k3: Annotated[float, NotNegative, "gain of the correction by mutual bearings [1/s]"] = 10.0
    min_speed: Annotated[
        Speed, Key("slow"), NotNegative, "horizontal speed v_min below which motion is not used"
    ] = 0.1
    max_speed: Annotated[
        Speed, Key("fast"), Positive, "horizontal speed v_max above which motion counts fully"
    ] = 0.3
    closure_gain: Annotated[
        float, Key("closure"), NotNegative, "gain of the correction around triangles [1/s]"
    ] = 5.0
    as_printed: Annotated[
        bool, Key("printed"), "estimator as printed, without compensation of the observer's lag"
    ] = False


@no_type_check
@numba.njit
def wrap_angle(angle):
    """The same angle in [−π, π)."""
    return (angle + pi) % (2 * pi) - pi


@no_type_check
@numba.njit
def update_velocity_observer(p, before, fresh, v, w, other, watch, track, dt):
    """One step of the observer of another's velocity [Bernard2023, eq. 15–17].

    e is ⁱR_j v_j through a filter of first order. The step is exact where p_ij goes straight.

    Args:
        p: p_ij as seen now, (3,) [m].
        before: p_ij as seen a step ago, (3,) [m].
        fresh: Whether it was not seen then, so that all begins anew.
        v: Own velocity since, in the own frame, (3,) [m/s].
        w: Own yaw rate since [rad/s].
        other: The other's velocity in its frame, and its yaw rate, as it says, (4,).
        watch: The observer, changed in place: e, v_j through the same filter, and for how long
            the other one has been in sight [s], (7,).
        track: The numbers of the estimator.
        dt: Step [s].
    """
    if fresh:
        watch[:] = 0.0
        return
    x, y = (p[0] + before[0]) / 2, (p[1] + before[1]) / 2
    across = (-w * y, w * x, 0.0)
    if not track.as_printed:
        # Both frames turn meanwhile, and what has been filtered rests in space.
        rotate_about_z(watch, -w * dt, watch)
        rotate_about_z(watch[3:], -other[3] * dt, watch[3:])
    keep = exp(-track.k1 * dt)
    for a in range(3):
        seen = (p[a] - before[a]) / dt + v[a] + across[a]
        watch[a] = keep * watch[a] + (1 - keep) * seen
        watch[3 + a] = keep * watch[3 + a] + (1 - keep) * other[a]
    watch[6] += dt


@no_type_check
@numba.njit
def rotate_about_z(v, angle, turned):
    """Turn a vector about the vertical; into itself, if that is asked."""
    c, s = cos(angle), sin(angle)
    turned[0], turned[1], turned[2] = c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]


@no_type_check
@numba.njit
def yaw_from_motion(watch, v_other, track):
    """ψ̂_ij, from how the other one is seen to move, and how far to trust it.

    Only the horizontal parts tell of yaw; and in the first 3/k₁ the observer knows little.
    """
    v_x, v_y = (v_other[0], v_other[1]) if track.as_printed else (watch[3], watch[4])
    seen = sqrt(watch[0] ** 2 + watch[1] ** 2)
    said = sqrt(v_x * v_x + v_y * v_y)
    speed = sqrt(v_other[0] ** 2 + v_other[1] ** 2 + v_other[2] ** 2)
    if not track.as_printed:
        speed = min(said, seen) if watch[6] >= 3 / track.k1 else 0.0
    trust = cosine_ramp(speed, track.min_speed, track.max_speed)
    return wrap_angle(atan2(watch[1], watch[0]) - atan2(v_y, v_x)), trust


@no_type_check
@numba.njit
def yaw_from_bearings(p, p_other):
    """ψ_ij where both see each other: R_z(ψ_ij) p_ji = −p_ij."""
    return wrap_angle(atan2(-p[1], -p[0]) - atan2(p_other[1], p_other[0]))


@no_type_check
@numba.njit
def update_yaw_estimate(yaw, turn, mutual, measured, guessed, trust, track, dt):
    """One step of ψ̃_ij [Bernard2023, eq. 19].

    Args:
        yaw: ψ̃_ij [rad].
        turn: w_j − w_i [rad/s].
        mutual: f*_ij f*_ji.
        measured: ψ_ij from two bearings, where mutual is not zero [rad].
        guessed: ψ̂_ij, from motion [rad].
        trust: How far to trust that, from 0 to 1.
        track: The numbers of the estimator.
        dt: Step [s].
    """
    rate = turn + track.k2 * trust * (1 - mutual) * sin(guessed - yaw)
    if mutual > 0:
        rate += track.k3 * mutual * sin(measured - yaw)
    return wrap_angle(yaw + dt * rate)


@no_type_check
@numba.njit
def circular_mean(mine, theirs):
    """The mean of ψ̃_ij and −ψ̃_ji on the circle [rad]."""
    return atan2(sin(mine) + sin(-theirs), cos(mine) + cos(-theirs))
