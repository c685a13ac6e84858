"""Quadrotor, commanded by velocity in the heading frame and yaw rate."""

from math import exp, tan
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Gt, Lt
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.units import Acceleration, Angle, Key, Time
from dynamics.vehicle import VehicleState, rotate_by_yaw

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


def step_quadrotor(
    state: VehicleState, command: Float[Array, "*k 4"], plant: Quadrotor, dt: float
) -> VehicleState:
    """Advance quadrotors by a step, commanded by velocity in the heading frame and yaw rate."""
    left = exp(-dt / plant.attitude_time_constant)
    velocity = rotate_by_yaw(state.velocity, state.yaw)
    wanted = rotate_by_yaw(command[..., :3], state.yaw)
    demand = (wanted - velocity) / plant.velocity_time_constant
    limit = plant.max_vertical_acceleration
    demand[..., 2] = np.clip(demand[..., 2], -limit, limit)
    horizontal = np.linalg.norm(demand[..., :2], axis=-1)
    most = (STANDARD_GRAVITY + demand[..., 2]) * tan(plant.max_tilt)
    demand[..., :2] *= (most / np.maximum(horizontal, most))[..., None]
    acceleration = demand + (state.acceleration - demand) * left
    mean = (state.acceleration + acceleration) / 2
    position = state.position + dt * (velocity + dt * mean / 2)
    yaw_rate = command[..., 3] + (state.yaw_rate - command[..., 3]) * left
    yaw = state.yaw + dt * (state.yaw_rate + yaw_rate) / 2
    velocity = rotate_by_yaw(velocity + dt * mean, -yaw)
    return VehicleState(position, yaw, velocity, yaw_rate, acceleration)


def rotate_to_heading_frame(
    direction: Float[Array, " 3"], acceleration: Float[Array, "*k 3"], yaw: Float[Array, "*k"]
) -> Float[Array, "*k 3"]:
    """Rotate a direction from the body frames of quadrotors to their heading frames.

    The body frame is the heading frame after the smallest rotation that takes the vertical
    to the thrust: the acceleration, in the world frame, less gravity [m/s²].
    """
    thrust = rotate_by_yaw(acceleration + np.array([0, 0, STANDARD_GRAVITY]), -yaw)
    x, y, z = np.moveaxis(thrust / np.linalg.norm(thrust, axis=-1, keepdims=True), -1, 0)
    # Rodrigues' formula about e_z × t = (−y, x, 0), whose cosine is z.
    axis = np.stack([-y, x, np.zeros_like(x)], axis=-1)
    once = np.cross(axis, direction)
    return np.asarray(direction + once + np.cross(axis, once) / (1 + z)[..., None])
