"""Controller of one agent: relative yaw, edges with their gradients, and the command.

Functions are given the index of an agent and read its rows alone: of its measurements, its
messages and its estimates, all in its own body frame.
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

MAX_MESSAGE_AGE = 0.2  # time for which a neighbor's last message is used [s]


class CommandLimits(NamedTuple):
    """Limits of what a robot commands, beside the operator's command to the leader."""

    speed: Annotated[Speed, Positive, "largest speed"] = 3.0
    yaw_rate: Annotated[AngularRate, Key("turn"), Positive, "largest yaw rate"] = 1.5


@no_type_check
@numba.njit
def estimate_edges(i, measurements, messages, estimates, parameters, time):
    """Estimate the relative yaw of the neighbors of agent i, its edges and their gradients."""
    bearing, bearing_back = np.zeros(3), np.zeros(3)
    link, n = parameters.link, len(estimates.relative_yaw)
    delay_steps = (link.delay_messages + 1) * link.period_steps - 1
    oldest = time - MAX_MESSAGE_AGE - delay_steps * parameters.step
    for j in range(n):
        if j == i:
            continue
        has_message = messages.received_time[i, j] >= oldest
        sees = measurements.visibility[i, j]
        is_seen = has_message and messages.received_visibility[i, j]
        estimates.weight[i, j] = 0.0
        estimates.weight_gradient[i, j, :] = 0.0
        estimates.is_mutual[i, j] = sees and is_seen
        if sees and has_message:
            _update_relative_yaw(i, j, is_seen, measurements, messages, estimates, parameters, time)
        elif is_seen:
            estimates.relative_yaw[i, j] = _yaw_from_message(
                i, j, measurements, messages, parameters, time
            )
        if sees or is_seen:
            psi = estimates.relative_yaw[i, j]
            p = measurements.relative_position[i, j]
            p_back = messages.received_relative_position[i, j]
            d = _mutual_bearings(p, p_back, sees, is_seen, psi, bearing, bearing_back)
            estimates.weight[i, j], _, _ = edge_weight(
                d, bearing, bearing_back, psi, sees, is_seen, parameters.assumed_camera,
                estimates.weight_gradient[i, j],
            )  # fmt: skip
    if parameters.tracking.closure_gain > 0 and not parameters.tracking.as_printed:
        _close_triangles(i, measurements, messages, estimates, parameters, oldest)
    estimates.adjacency_rows[i, i] = estimates.weight[i]
    estimates.row_time[i, i] = time


@no_type_check
@numba.njit
def _mutual_bearings(p, p_back, sees, is_seen, psi, bearing, bearing_back):
    # Returns the distance. An agent that does not see rotates the other's measurement
    # [Bernard2023, Sec. III-C, where the rotation is printed in the wrong sense].
    c, s = cos(psi), sin(psi)
    d = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    d_back = sqrt(p_back[0] * p_back[0] + p_back[1] * p_back[1] + p_back[2] * p_back[2])
    for a in range(3):
        bearing[a], bearing_back[a] = p[a] / d, p_back[a] / d_back
    if not sees:
        bearing[0] = -(c * bearing_back[0] - s * bearing_back[1])
        bearing[1] = -(s * bearing_back[0] + c * bearing_back[1])
        bearing[2] = -bearing_back[2]
    if not is_seen:
        bearing_back[0] = -(c * bearing[0] + s * bearing[1])
        bearing_back[1] = -(c * bearing[1] - s * bearing[0])
        bearing_back[2] = -bearing[2]
    return d if sees else d_back


@no_type_check
@numba.njit
def _update_relative_yaw(i, j, is_seen, measurements, messages, estimates, parameters, time):
    dt, tracking, camera = parameters.step, parameters.tracking, parameters.assumed_camera
    observer, twist = estimates.velocity_observer[i, j], messages.received_twist[i, j]
    p, p_back = measurements.relative_position[i, j], messages.received_relative_position[i, j]
    update_velocity_observer(
        p, measurements.previous_relative_position[i, j],
        not measurements.previous_visibility[i, j], measurements.velocity[i],
        measurements.yaw_rate[i], twist, observer, tracking, dt,
    )  # fmt: skip
    psi_motion, trust = yaw_from_motion(observer, twist, tracking)
    rate, psi = twist[3] - measurements.yaw_rate[i], estimates.relative_yaw[i, j]
    mutual = _view_weight(p, camera) * _view_weight(p_back, camera) if is_seen else 0.0
    # Two bearings belong together only if they are of one time, so a message must be new.
    p_then = messages.relative_position_when_sent[i, j]
    has_both = is_seen and messages.is_new[i, j] and not np.isnan(p_then[0])
    psi_bearings = psi
    if has_both:
        age = time - messages.received_time[i, j]
        psi_bearings = yaw_from_bearings(p_then, p_back) + age * rate
    psi = update_yaw_estimate(psi, rate, mutual, psi_bearings, psi_motion, trust, tracking, dt)
    if has_both:
        psi = circular_mean(psi, _yaw_from_message(i, j, measurements, messages, parameters, time))
    estimates.relative_yaw[i, j] = psi


@no_type_check
@numba.njit
def _yaw_from_message(i, j, measurements, messages, parameters, time):
    # ψ̃_ij by the estimate of j, a step older than its message, and the turns of both since.
    age = time - messages.received_time[i, j] + parameters.step
    rate = messages.received_twist[i, j, 3] - measurements.yaw_rate[i]
    return wrap_angle(age * rate - messages.received_relative_yaw[i, j, i])


@no_type_check
@numba.njit
def _view_weight(p, camera):
    d = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2])
    o_x, o_y, o_z = camera.optical_axis
    return cosine_ramp((o_x * p[0] + o_y * p[1] + o_z * p[2]) / d, camera.a_min, camera.a_max)[0]


@no_type_check
@numba.njit
def _close_triangles(i, measurements, messages, estimates, parameters, oldest):
    # Where only i sees j, a third agent in mutual view of both knows the angle better.
    psi, n = estimates.relative_yaw, len(estimates.relative_yaw)
    gain = parameters.step * parameters.tracking.closure_gain
    for j in range(n):
        if j == i or estimates.is_mutual[i, j] or not measurements.visibility[i, j]:
            continue
        error, count = 0.0, 0
        for k in range(n):
            if k == i or k == j or messages.received_time[i, k] < oldest:
                continue
            if estimates.is_mutual[i, k] and messages.received_is_mutual[i, k, j]:
                error += sin(psi[i, k] + messages.received_relative_yaw[i, k, j] - psi[i, j])
                count += 1
        if count > 0:
            psi[i, j] = wrap_angle(psi[i, j] + gain * error / count)


@no_type_check
@numba.njit
def compute_command(i, measurements, estimates, parameters):
    """Compute velocity and yaw rate of agent i, without the stick [Bernard2023, eq. 5].

    An agent without an edge, or without an estimate of λ₂, only keeps its distance.
    """
    u, limits = estimates.command[i], parameters.limits
    u[:] = 0.0
    if (estimates.weight[i] > 0).any() and not np.isnan(estimates.lambda2[i]):
        slope = negative_slope(estimates.lambda2[i], parameters.potential)
        for j in range(len(estimates.relative_yaw)):
            for a in range(4):
                u[a] += (
                    slope * estimates.lambda2_gradient[i, j] * estimates.weight_gradient[i, j, a]
                )
    for k in range(measurements.range_point_count[i]):
        p = measurements.range_points[i, k]
        gain = repulsion_gain(sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]), parameters.repulsion)
        for a in range(3):
            u[a] -= gain * p[a]
    speed = sqrt(u[0] * u[0] + u[1] * u[1] + u[2] * u[2])
    if speed > limits.speed:
        for a in range(3):
            u[a] *= limits.speed / speed
    u[3] = min(max(u[3], -limits.yaw_rate), limits.yaw_rate)
