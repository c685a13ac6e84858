"""Estimator of relative yaw, of one agent for another [Bernard2023, Sec. IV].

A camera measures the position of another agent but not its yaw. Where two agents see each
other, their two bearings give it. Where only one sees, it compares the motion that it observes
with the velocity that the other sends.
"""

from math import exp, pi

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.vehicle import rotate_by_yaw, vector_lengths
from problems.interaction_graph import Camera, Numbers, cosine_ramp
from sato.connectivity.mission import Connectivity
from sato.connectivity.settings import YawTracking
from sato.connectivity.state import Knowledge

Vectors = Float[Array, "... 3"]


def estimate_relative_yaw(
    known: Knowledge, mission: Connectivity, time: float
) -> tuple[Float[Array, "n n"], Float[Array, "n n 7"]]:
    """Advance ψ̃_ij of every agent for every other, and the observers.

    Measurements and messages are those of now, estimates those of a step ago.
    """
    measurements, inbox, estimates = known
    tracking, camera, dt = mission.tracking, mission.assumed_camera, mission.step
    i, j = np.nonzero(measurements.visibility | inbox.is_seen)
    p, p_back = measurements.relative_position[i, j], inbox.relative_position[i, j]
    twist, psi, own_rate = inbox.twist[i, j], estimates.relative_yaw[i, j], measurements.yaw_rate[i]
    sees, is_seen = measurements.visibility[i, j], inbox.is_seen[i, j]
    has_message = np.isfinite(inbox.time[i, j])
    rate = twist[:, 3] - own_rate
    age = np.where(has_message, time - inbox.time[i, j], 0.0)
    # ψ̃_ij by the estimate of j, a step older than its message, and the turns of both since.
    from_message = wrap_angle((age + dt) * rate - inbox.relative_yaw[i, j, i])
    before = estimates.velocity_observer[i, j]
    previous_p, v = measurements.previous_relative_position[i, j], measurements.velocity[i]
    observer = update_velocity_observer(p, previous_p, v, own_rate, twist, before, tracking, dt)
    observer = np.where((sees & has_message)[:, None], observer, before)
    from_motion, trust = yaw_from_motion(observer, twist, tracking)
    mutual = np.where(is_seen, _view_weight(np.stack([p, p_back]), camera).prod(axis=0), 0.0)
    # Both bearings are of the time of the message, which corrects once: when it arrives.
    own_p = inbox.own_relative_position[i, j]
    has_both = is_seen & inbox.is_new[i, j] & ~np.isnan(own_p[:, 0])
    from_bearings = np.where(has_both, yaw_from_bearings(own_p, p_back) + age * rate, psi)
    found = update_yaw_estimate(psi, rate, mutual, from_bearings, from_motion, trust, tracking, dt)
    found = np.where(has_both, circular_mean(found, from_message), found)
    found = np.where(sees & has_message, found, np.where(is_seen, from_message, psi))
    all_psi, observers = estimates.relative_yaw.copy(), estimates.velocity_observer.copy()
    all_psi[i, j], observers[i, j] = found, observer
    if tracking.closure_gain > 0 and not tracking.as_printed:
        all_psi = _close_triangles(all_psi, known, dt * tracking.closure_gain)
    return all_psi, observers


def _close_triangles(
    psi: Float[Array, "n n"], known: Knowledge, gain: float
) -> Float[Array, "n n"]:
    # Where only i sees j, a third agent k in mutual view of both knows the angle better.
    sees, inbox = known.measurements.visibility, known.inbox
    is_mutual = sees & inbox.is_seen
    i, k = np.nonzero(is_mutual)
    which, j = np.nonzero(inbox.is_mutual[i, k] & (sees & ~is_mutual)[i])
    i, k = i[which], k[which]
    closure = np.sin(psi[i, k] + inbox.relative_yaw[i, k, j] - psi[i, j])
    edge, n = i * len(psi) + j, psi.size
    error, count = np.bincount(edge, closure, n), np.bincount(edge, minlength=n)
    mean = (error / np.maximum(count, 1)).reshape(psi.shape)
    return np.where(count.reshape(psi.shape) > 0, wrap_angle(psi + gain * mean), psi)


def _view_weight(p: Vectors, camera: Camera) -> Numbers:
    cosine = np.vecdot(p, np.array(camera.optical_axis)) / vector_lengths(p)
    return cosine_ramp(cosine, camera.a_min, camera.a_max)


def wrap_angle(angle: Numbers) -> Numbers:
    """Wrap an angle to [−π, π)."""
    return (angle + pi) % (2 * pi) - pi


def update_velocity_observer(
    p: Vectors,  # p_ij as measured now [m]
    previous_p: Vectors,  # a step ago; NaN where the observer starts again [m]
    v: Vectors,  # own velocity in the step, body frame [m/s]
    w: Numbers,  # own yaw rate in the step [rad/s]
    twist: Float[Array, "... 4"],  # velocity of the other, its body frame, and yaw rate, received
    observer: Float[Array, "... 7"],  # e, v_j through the same filter, time since the start [s]
    tracking: YawTracking,
    dt: float,  # step [s]
) -> Float[Array, "... 7"]:
    """Advance the observer of another agent's velocity [Bernard2023, eq. 15–17].

    e is ⁱR_j v_j through a filter of first order; exact where p_ij moves on a straight line.

    Args:
        p: p_ij as measured now [m].
        previous_p: p_ij as measured a step ago; NaN where the observer starts again [m].
        v: Own velocity in the step, body frame [m/s].
        w: Own yaw rate in the step [rad/s].
        twist: Velocity of the other in its body frame, and its yaw rate, as received.
        observer: e, v_j through the same filter, and the time since the start [s].
        tracking: Gains.
        dt: Step [s].
    """
    observed, received, age = observer[..., :3], observer[..., 3:6], observer[..., 6:]
    middle = (p + previous_p) / 2
    transport = w[..., None] * middle[..., [1, 0, 2]] * np.array([-1.0, 1.0, 0.0])
    measured = (p - previous_p) / dt + v + transport
    if not tracking.as_printed:
        # Both body frames turn in the step, and the filtered vectors are fixed in space.
        observed = rotate_by_yaw(observed, -w * dt)
        received = rotate_by_yaw(received, -twist[..., 3] * dt)
    keep = exp(-tracking.k1 * dt)
    observed = keep * observed + (1 - keep) * measured
    received = keep * received + (1 - keep) * twist[..., :3]
    updated = np.concatenate([observed, received, age + dt], axis=-1)
    return np.where(np.isnan(previous_p[..., :1]), 0.0, updated)


def yaw_from_motion(
    observer: Float[Array, "... 7"], twist: Float[Array, "... 4"], tracking: YawTracking
) -> tuple[Numbers, Numbers]:
    """Compute ψ̂_ij from observed and received velocity, and its weight from 0 to 1.

    Only horizontal motion tells yaw, and the observer settles for the first 3/k₁.
    """
    observed = observer[..., :2]
    received = twist[..., :2] if tracking.as_printed else observer[..., 3:5]
    if tracking.as_printed:
        speed = vector_lengths(twist[..., :3])
    else:
        slower = np.minimum(vector_lengths(observed), vector_lengths(received))
        speed = np.where(observer[..., 6] >= 3 / tracking.k1, slower, 0.0)
    trust = cosine_ramp(speed, tracking.min_speed, tracking.max_speed)
    return wrap_angle(_direction(observed) - _direction(received)), trust


def yaw_from_bearings(p: Vectors, p_back: Vectors) -> Numbers:
    """Compute ψ_ij of two agents that see each other: R_z(ψ_ij) p_ji = −p_ij."""
    return wrap_angle(_direction(-p) - _direction(p_back))


def _direction(v: Float[Array, "... d"]) -> Numbers:
    return np.asarray(np.arctan2(v[..., 1], v[..., 0]))


def update_yaw_estimate(
    psi: Numbers,  # ψ̃_ij [rad]
    rate: Numbers,  # w_j − w_i [rad/s]
    mutual: Numbers,  # f*_ij f*_ji
    psi_bearings: Numbers,  # ψ_ij from two bearings, where mutual is not zero [rad]
    psi_motion: Numbers,  # ψ̂_ij from motion [rad]
    trust: Numbers,  # weight of ψ̂_ij, from 0 to 1
    tracking: YawTracking,
    dt: float,  # step [s]
) -> Numbers:
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
    rate = rate + tracking.k2 * trust * (1 - mutual) * np.sin(psi_motion - psi)
    rate = rate + tracking.k3 * mutual * np.sin(psi_bearings - psi)
    return wrap_angle(psi + dt * rate)


def circular_mean(one: Numbers, other: Numbers) -> Numbers:
    """Compute the mean of two angles on the circle [rad]."""
    return np.arctan2(np.sin(one) + np.sin(other), np.cos(one) + np.cos(other))
