"""Kinematic vehicle, commanded by velocity in the body frame and yaw rate."""

from math import exp
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.units import Key, Time
from dynamics.vehicle import VehicleState, rotate_by_yaw


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

    def lag_factors(self, dt: float) -> tuple[float, float]:
        """Compute the share of an error of velocity after a step, and its mean in the step."""
        if self.time_constant <= 0:
            return 0.0, 0.0
        left = exp(-dt / self.time_constant)
        return left, self.time_constant / dt * (1 - left)


KinematicVehicle.kind = "kinematic"  # type: ignore[attr-defined]  # name in scenario files


def step_kinematic(
    state: VehicleState,
    command: Float[Array, "*k 4"],
    plant: KinematicVehicle,
    dt: float,
    rng: np.random.Generator,
) -> VehicleState:
    """Advance vehicles by a step.

    Args:
        state: State of the vehicles.
        command: Commanded velocity in the body frame [m/s] and yaw rate [rad/s].
        plant: Lag and noise.
        dt: Step [s].
        rng: Draws the noise.
    """
    left, share = plant.lag_factors(dt)
    error = np.concatenate([state.velocity, state.yaw_rate[..., None]], axis=-1) - command
    mean, end = command + error * share, command + error * left
    if plant.noise_std > 0:
        noise = plant.noise_std * rng.standard_normal(command.shape)
        mean, end = mean + noise, end + noise
    turn = mean[..., 3] * dt
    position = state.position + dt * rotate_by_yaw(mean[..., :3], state.yaw + turn / 2)
    return VehicleState(position, state.yaw + turn, end[..., :3], end[..., 3], state.acceleration)
