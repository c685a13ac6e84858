"""Kinematic vehicle, commanded by velocity in the body frame and yaw rate."""

from math import cos, exp, sin
from typing import Annotated, NamedTuple, no_type_check

import numba
from annotated_types import Ge

from dynamics.units import Key, Time


class KinematicVehicle(NamedTuple):
    """ṗ = R_z(ψ) v, ψ̇ = w, where v and w follow their commands [Bernard2023, eq. 1].

    v and w follow as independent first-order systems, exactly for a command that is held.
    The displacement in a step is computed from the mean velocity and the middle yaw; its
    error is of third order in the step.
    """

    time_constant: Annotated[Time, Key("lag"), Ge(0), "time constant; 0 obeys at once"] = 0.0
    noise_std: Annotated[
        float, Key("noise"), Ge(0), "standard deviation of each velocity in each step [m/s, rad/s]"
    ] = 0.0


KinematicVehicle.kind = "kinematic"  # type: ignore[attr-defined]  # name in scenario files


@no_type_check
@numba.njit
def step_kinematic(position, yaw, velocity, yaw_rate, command, yaw_command, plant, dt, rng):
    """Advance a vehicle by a step.

    Args:
        position: In the world frame, (3,), changed in place [m].
        yaw: Of the body frame [rad].
        velocity: In the body frame, (3,), changed in place [m/s].
        yaw_rate: [rad/s].
        command: Commanded velocity in the body frame, (3,) [m/s].
        yaw_command: Commanded yaw rate [rad/s].
        plant: A `KinematicVehicle`.
        dt: Step [s].
        rng: Random generator of the noise.

    Returns:
        Yaw and yaw rate at the end of the step.
    """
    decay = exp(-dt / plant.time_constant) if plant.time_constant > 0 else 0.0
    mean = plant.time_constant / dt * (1 - decay) if plant.time_constant > 0 else 0.0
    mean_yaw_rate = yaw_command + (yaw_rate - yaw_command) * mean
    yaw_rate = yaw_command + (yaw_rate - yaw_command) * decay
    mean_velocity = [0.0, 0.0, 0.0]
    for a in range(3):
        mean_velocity[a] = command[a] + (velocity[a] - command[a]) * mean
        velocity[a] = command[a] + (velocity[a] - command[a]) * decay
        if plant.noise_std > 0:
            noise = plant.noise_std * rng.standard_normal()
            mean_velocity[a] += noise
            velocity[a] += noise
    if plant.noise_std > 0:
        noise = plant.noise_std * rng.standard_normal()
        mean_yaw_rate += noise
        yaw_rate += noise
    middle = yaw + mean_yaw_rate * dt / 2
    c, s = cos(middle), sin(middle)
    position[0] += dt * (c * mean_velocity[0] - s * mean_velocity[1])
    position[1] += dt * (s * mean_velocity[0] + c * mean_velocity[1])
    position[2] += dt * mean_velocity[2]
    return yaw + mean_yaw_rate * dt, yaw_rate
