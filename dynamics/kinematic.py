"""Vehicles that are told how fast to go: velocity in the body frame, and yaw rate."""

from math import cos, exp, sin
from typing import NamedTuple, no_type_check

import numba


class KinematicVehicle(NamedTuple):
    """ṗ = R_z(ψ) v, ψ̇ = w, and v and w follow what is commanded [Bernard2023, eq. 1].

    v and w are exact for a command that is held: with a lag, they approach it as systems of
    first order, each on its own. The path of a step is taken at its mean velocity and middle
    yaw, which leaves an error of third order in the step.
    """

    time_constant: float = 0.0  # time constant [s]; without it, commands are obeyed at once
    noise_std: float = 0.0  # standard deviation of each velocity in each step [m/s, rad/s]


@no_type_check
@numba.njit
def step_kinematic(position, yaw, velocity, rate, command, turn, plant, dt, rng):
    """Drive a vehicle for a step.

    Args:
        position: In the world frame, (3,), changed in place [m].
        yaw: Of the body frame [rad].
        velocity: In the body frame, (3,), changed in place [m/s].
        rate: Of yaw [rad/s].
        command: Velocity asked for, in the body frame, (3,) [m/s].
        turn: Yaw rate asked for [rad/s].
        plant: How it obeys.
        dt: Step [s].
        rng: Draws the noise.

    Returns:
        Yaw and yaw rate at the end of the step.
    """
    keep = exp(-dt / plant.time_constant) if plant.time_constant > 0 else 0.0
    mean = plant.time_constant / dt * (1 - keep) if plant.time_constant > 0 else 0.0
    swept = turn + (rate - turn) * mean
    rate = turn + (rate - turn) * keep
    gone = [0.0, 0.0, 0.0]
    for a in range(3):
        gone[a] = command[a] + (velocity[a] - command[a]) * mean
        velocity[a] = command[a] + (velocity[a] - command[a]) * keep
        if plant.noise_std > 0:
            shaken = plant.noise_std * rng.standard_normal()
            gone[a] += shaken
            velocity[a] += shaken
    if plant.noise_std > 0:
        shaken = plant.noise_std * rng.standard_normal()
        swept += shaken
        rate += shaken
    middle = yaw + swept * dt / 2
    c, s = cos(middle), sin(middle)
    position[0] += dt * (c * gone[0] - s * gone[1])
    position[1] += dt * (s * gone[0] + c * gone[1])
    position[2] += dt * gone[2]
    return yaw + swept * dt, rate
