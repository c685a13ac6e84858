"""Kinematic vehicle, commanded by velocity in the body frame and yaw rate."""

from math import exp
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.units import Key, Time
from dynamics.vehicle import VehicleState, rotate_by_yaw

Velocities = Float[Array, "*k 4"]  # in the body frame [m/s], and yaw rates [rad/s]


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

    def draw_noise(self, vehicles: int, rng: np.random.Generator) -> Float[Array, "vehicles 4"]:
        """Draw the noise of velocities and yaw rates in a step."""
        if self.noise_std == 0:
            return np.zeros((vehicles, 4))
        return self.noise_std * rng.standard_normal((vehicles, 4))


KinematicVehicle.kind = "kinematic"  # type: ignore[attr-defined]  # name in scenario files


def step_kinematic(
    state: VehicleState, command: Velocities, plant: KinematicVehicle, dt: float, noise: Velocities
) -> VehicleState:
    """Advance vehicles by a step.

    Commands and noise are of the velocity in the body frame [m/s] and of the yaw rate [rad/s].
    """
    lag = plant.time_constant
    left = exp(-dt / lag) if lag > 0 else 0.0
    error = np.concatenate([state.velocity, state.yaw_rate[..., None]], axis=-1) - command
    mean, end = command + error * (lag / dt * (1 - left)) + noise, command + error * left + noise
    turn = mean[..., 3] * dt
    position = state.position + dt * rotate_by_yaw(mean[..., :3], state.yaw + turn / 2)
    return VehicleState(position, state.yaw + turn, end[..., :3], end[..., 3], state.acceleration)
