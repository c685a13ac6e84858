"""Quadrotor, commanded by velocity in the heading frame and yaw rate."""

from math import cos, exp, sin, sqrt, tan
from typing import Annotated, NamedTuple, no_type_check

import numba
from annotated_types import Gt, Lt

from dynamics.units import Acceleration, Angle, Key, Time

STANDARD_GRAVITY = 9.80665  # [m/s²]


class Quadrotor(NamedTuple):
    """ṗ = v, v̇ = a, where a is thrust along the body's z axis plus gravity.

    A velocity loop demands an acceleration and an attitude loop tilts the thrust to it, both
    of first order; rotors and rotational inertia are taken to be faster than both. Yaw
    is independent of tilt.
    """

    velocity_time_constant: Annotated[
        Time, Key("response"), Gt(0), "time constant of the velocity loop"
    ] = 0.4
    attitude_time_constant: Annotated[
        Time, Key("attitude"), Gt(0), "time constant of the attitude loop and of the yaw rate"
    ] = 0.08
    max_tilt: Annotated[
        Angle, Key("tilt"), Gt(0), Lt(1.5), "largest angle of the thrust from the vertical"
    ] = 0.5
    max_vertical_acceleration: Annotated[
        Acceleration, Key("climb"), Gt(0), Lt(STANDARD_GRAVITY), "largest vertical acceleration"
    ] = 4.0


Quadrotor.kind = "quadrotor"  # type: ignore[attr-defined]  # name in scenario files


@no_type_check
@numba.njit
def step_quadrotor(
    position, yaw, velocity, yaw_rate, acceleration, command, yaw_command, plant, dt
):
    """Advance a quadrotor by a step.

    Args:
        position: In the world frame, (3,), changed in place [m].
        yaw: Of the heading frame [rad].
        velocity: In the world frame, (3,), changed in place [m/s].
        yaw_rate: [rad/s].
        acceleration: Of thrust and gravity together, in the world frame, (3,), changed in
            place [m/s²].
        command: Commanded velocity in the heading frame, (3,) [m/s].
        yaw_command: Commanded yaw rate [rad/s].
        plant: A `Quadrotor`.
        dt: Step [s].

    Returns:
        Yaw and yaw rate at the end of the step.
    """
    decay = exp(-dt / plant.attitude_time_constant)
    c, s = cos(yaw), sin(yaw)
    wanted = (c * command[0] - s * command[1], s * command[0] + c * command[1], command[2])
    demand = [(wanted[a] - velocity[a]) / plant.velocity_time_constant for a in range(3)]
    limit = plant.max_vertical_acceleration
    demand[2] = min(max(demand[2], -limit), limit)
    horizontal = sqrt(demand[0] ** 2 + demand[1] ** 2)
    most = (STANDARD_GRAVITY + demand[2]) * tan(plant.max_tilt)
    if horizontal > most:
        demand[0], demand[1] = demand[0] * most / horizontal, demand[1] * most / horizontal
    for a in range(3):
        before = acceleration[a]
        acceleration[a] = demand[a] + (acceleration[a] - demand[a]) * decay
        mean = (before + acceleration[a]) / 2
        position[a] += dt * (velocity[a] + dt * mean / 2)
        velocity[a] += dt * mean
    before = yaw_rate
    yaw_rate = yaw_command + (yaw_rate - yaw_command) * decay
    return yaw + dt * (before + yaw_rate) / 2, yaw_rate


@no_type_check
@numba.njit
def rotate_to_heading_frame(direction, acceleration, yaw, rotated):
    """Rotate a direction from the body frame of a quadrotor to its heading frame.

    The body frame is the heading frame after the smallest rotation that takes the vertical
    to the thrust.

    Args:
        direction: In the body frame, (3,).
        acceleration: Of thrust and gravity together, in the world frame, (3,) [m/s²].
        yaw: Of the heading frame [rad].
        rotated: Result, in the heading frame, (3,), changed in place.
    """
    c, s = cos(yaw), sin(yaw)
    x, y = c * acceleration[0] + s * acceleration[1], c * acceleration[1] - s * acceleration[0]
    z = acceleration[2] + STANDARD_GRAVITY
    size = sqrt(x * x + y * y + z * z)
    x, y, z = x / size, y / size, z / size
    # Rodrigues' formula about e_z × t = (−y, x, 0), whose cosine is z.
    k_x, k_y = -y, x
    a = (k_y * direction[2], -k_x * direction[2], k_x * direction[1] - k_y * direction[0])
    b = (k_y * a[2], -k_x * a[2], k_x * a[1] - k_y * a[0])
    for i in range(3):
        rotated[i] = direction[i] + a[i] + b[i] / (1 + z)
