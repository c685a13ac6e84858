"""A quadrotor that is told how fast to go, and tilts to get there."""

from math import cos, exp, sin, sqrt, tan
from typing import NamedTuple, no_type_check

import numba

STANDARD_GRAVITY = 9.80665  # standard [m/s²]


class Quadrotor(NamedTuple):
    """ṗ = v, v̇ = a, where thrust and gravity make a, and the thrust is along the body's z.

    A velocity loop asks for an acceleration, an attitude loop turns the thrust that way, as
    systems of first order; rotors and angular inertia are taken to be faster than both. Yaw is
    turned by itself.
    """

    velocity_time_constant: float = 0.4  # time constant of the velocity loop [s]
    attitude_time_constant: float = (
        0.08  # time constant of the attitude loop, and of the yaw rate [s]
    )
    max_tilt: float = 0.5  # largest angle from the vertical [rad]
    max_vertical_acceleration: float = (
        4.0  # largest vertical acceleration, less than gravity [m/s²]
    )


@no_type_check
@numba.njit
def step_quadrotor(position, yaw, velocity, rate, push, command, turn, plant, dt):
    """Fly for a step.

    Args:
        position: In the world frame, (3,), changed in place [m].
        yaw: Of the heading frame [rad].
        velocity: In the world frame, (3,), changed in place [m/s].
        rate: Of yaw [rad/s].
        push: Acceleration, of thrust less gravity, in the world frame, (3,), changed in
            place [m/s²].
        command: Velocity asked for, in the heading frame, (3,) [m/s].
        turn: Yaw rate asked for [rad/s].
        plant: The quadrotor.
        dt: Step [s].

    Returns:
        Yaw and yaw rate at the end of the step.
    """
    keep = exp(-dt / plant.attitude_time_constant)
    c, s = cos(yaw), sin(yaw)
    wish = (c * command[0] - s * command[1], s * command[0] + c * command[1], command[2])
    asked = [(wish[a] - velocity[a]) / plant.velocity_time_constant for a in range(3)]
    asked[2] = min(max(asked[2], -plant.max_vertical_acceleration), plant.max_vertical_acceleration)
    flat, most = (
        sqrt(asked[0] ** 2 + asked[1] ** 2),
        (STANDARD_GRAVITY + asked[2]) * tan(plant.max_tilt),
    )
    if flat > most:
        asked[0], asked[1] = asked[0] * most / flat, asked[1] * most / flat
    for a in range(3):
        former = push[a]
        push[a] = asked[a] + (push[a] - asked[a]) * keep
        mean = (former + push[a]) / 2
        position[a] += dt * (velocity[a] + dt * mean / 2)
        velocity[a] += dt * mean
    former = rate
    rate = turn + (rate - turn) * keep
    return yaw + dt * (former + rate) / 2, rate


@no_type_check
@numba.njit
def rotate_to_heading_frame(axis, push, yaw, turned):
    """A direction fixed to the body, in the heading frame.

    The body is turned from the heading frame by the least turn that takes the vertical to
    the thrust.

    Args:
        axis: The direction in the body frame, (3,).
        push: Acceleration, of thrust less gravity, in the world frame, (3,) [m/s²].
        yaw: Of the heading frame [rad].
        turned: Where the direction goes, (3,).
    """
    c, s = cos(yaw), sin(yaw)
    x, y, z = c * push[0] + s * push[1], c * push[1] - s * push[0], push[2] + STANDARD_GRAVITY
    size = sqrt(x * x + y * y + z * z)
    x, y, z = x / size, y / size, z / size
    # Rodrigues' formula about e_z × t = (−y, x, 0), whose cosine is z.
    k_x, k_y = -y, x
    a = (k_y * axis[2], -k_x * axis[2], k_x * axis[1] - k_y * axis[0])
    b = (k_y * a[2], -k_x * a[2], k_x * a[1] - k_y * a[0])
    for i in range(3):
        turned[i] = axis[i] + a[i] + b[i] / (1 + z)
