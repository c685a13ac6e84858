"""Estimator of relative yaw, of one agent for another [Bernard2023, Sec. IV].

A camera measures the position of another agent but not its yaw. Where two agents see each
other, their two bearings give it. Where only one sees, it compares the motion that it observes
with the velocity that the other sends.
"""

from math import atan2, cos, exp, pi, sin, sqrt
from typing import Annotated, NamedTuple, no_type_check

import numba

from dynamics.units import Key, Speed
from problems.interaction_graph import cosine_ramp
from sato.scenario.definition import NotNegative, Positive


class YawTracking(NamedTuple):
    """Gains and speeds of the estimator."""

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
    """Wrap an angle to [−π, π)."""
    return (angle + pi) % (2 * pi) - pi


@no_type_check
@numba.njit
def update_velocity_observer(p, previous_p, is_new, v, w, twist, observer, tracking, dt):
    """Advance the observer of another agent's velocity [Bernard2023, eq. 15–17].

    e is ⁱR_j v_j through a filter of first order; exact where p_ij moves on a straight line.

    Args:
        p: p_ij as measured now, (3,) [m].
        previous_p: p_ij as measured a step ago, (3,) [m].
        is_new: True where it was not visible then, so that the observer starts again.
        v: Own velocity in the step, body frame, (3,) [m/s].
        w: Own yaw rate in the step [rad/s].
        twist: Velocity of the other in its body frame, and its yaw rate, as received, (4,).
        observer: e, v_j through the same filter, and the time since the start [s], (7,);
            changed in place.
        tracking: Gains.
        dt: Step [s].
    """
    if is_new:
        observer[:] = 0.0
        return
    x, y = (p[0] + previous_p[0]) / 2, (p[1] + previous_p[1]) / 2
    transport = (-w * y, w * x, 0.0)
    if not tracking.as_printed:
        # Both body frames turn in the step, and the filtered vectors are fixed in space.
        rotate_about_z(observer, -w * dt, observer)
        rotate_about_z(observer[3:], -twist[3] * dt, observer[3:])
    keep = exp(-tracking.k1 * dt)
    for a in range(3):
        measured = (p[a] - previous_p[a]) / dt + v[a] + transport[a]
        observer[a] = keep * observer[a] + (1 - keep) * measured
        observer[3 + a] = keep * observer[3 + a] + (1 - keep) * twist[a]
    observer[6] += dt


@no_type_check
@numba.njit
def rotate_about_z(v, angle, rotated):
    """Rotate a vector about the vertical; input and output may be the same array."""
    c, s = cos(angle), sin(angle)
    rotated[0], rotated[1], rotated[2] = c * v[0] - s * v[1], s * v[0] + c * v[1], v[2]


@no_type_check
@numba.njit
def yaw_from_motion(observer, twist, tracking):
    """Compute ψ̂_ij from observed and received velocity, and its weight from 0 to 1.

    Only horizontal motion tells yaw, and the observer settles for the first 3/k₁.
    """
    v_x, v_y = (twist[0], twist[1]) if tracking.as_printed else (observer[3], observer[4])
    observed = sqrt(observer[0] ** 2 + observer[1] ** 2)
    received = sqrt(v_x * v_x + v_y * v_y)
    speed = sqrt(twist[0] ** 2 + twist[1] ** 2 + twist[2] ** 2)
    if not tracking.as_printed:
        speed = min(received, observed) if observer[6] >= 3 / tracking.k1 else 0.0
    trust = cosine_ramp(speed, tracking.min_speed, tracking.max_speed)[0]
    return wrap_angle(atan2(observer[1], observer[0]) - atan2(v_y, v_x)), trust


@no_type_check
@numba.njit
def yaw_from_bearings(p, p_back):
    """Compute ψ_ij of two agents that see each other: R_z(ψ_ij) p_ji = −p_ij."""
    return wrap_angle(atan2(-p[1], -p[0]) - atan2(p_back[1], p_back[0]))


@no_type_check
@numba.njit
def update_yaw_estimate(psi, rate, mutual, psi_bearings, psi_motion, trust, tracking, dt):
    """Advance ψ̃_ij by a step [Bernard2023, eq. 19].

    Args:
        psi: ψ̃_ij [rad].
        rate: w_j − w_i [rad/s].
        mutual: f*_ij f*_ji.
        psi_bearings: ψ_ij from two bearings, where mutual is not zero [rad].
        psi_motion: ψ̂_ij from motion [rad].
        trust: Weight of ψ̂_ij, from 0 to 1.
        tracking: Gains.
        dt: Step [s].
    """
    rate = rate + tracking.k2 * trust * (1 - mutual) * sin(psi_motion - psi)
    if mutual > 0:
        rate += tracking.k3 * mutual * sin(psi_bearings - psi)
    return wrap_angle(psi + dt * rate)


@no_type_check
@numba.njit
def circular_mean(one, other):
    """Compute the mean of two angles on the circle [rad]."""
    return atan2(sin(one) + sin(other), cos(one) + cos(other))
