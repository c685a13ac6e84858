"""Losses, measurement noise, thruster errors and disturbances, drawn in this order."""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.reconfiguration.leg import Loss
from sato.reconfiguration.mission import Reconfiguration


def draw_losses(
    loss: Loss,
    position: Float[Array, "agents d"],
    alive: Bool[Array, " agents"],
    rng: np.random.Generator,
) -> list[int]:
    """Return the indices of the agents that are lost."""
    live = np.flatnonzero(alive)
    if loss.kind == "agents":
        return [i for i in loss.agents if alive[i]]
    count = round((loss.share or 0.0) * len(live))
    if loss.kind == "random":
        return [int(i) for i in rng.choice(live, count, replace=False)]
    distance = np.linalg.norm(position[live] - position[live].mean(axis=0), axis=1)
    return [int(i) for i in live[np.argsort(distance, kind="stable")[:count]]]


def measure(
    mission: Reconfiguration, x: Float[Array, "agents n"], rng: np.random.Generator
) -> Float[Array, "agents n"]:
    """Return the states that the agents measure."""
    noise = np.repeat([mission.position_noise, mission.velocity_noise], mission.axes)
    return np.asarray(x + noise * rng.standard_normal(x.shape)) if noise.any() else x


def disturb_control(
    mission: Reconfiguration, control: Float[Array, "agents d"], rng: np.random.Generator
) -> Float[Array, "agents d"]:
    """Return the accelerations that act on the agents for commanded ones [m/s²]."""
    disturbance = mission.disturbance * rng.standard_normal(control.shape)
    if mission.thrust_error or mission.pointing_error:
        agents, d = control.shape
        control = apply_thruster_errors(mission, control, rng.standard_normal((agents, 1 + d)))
    return control + disturbance if mission.disturbance else control


def apply_thruster_errors(
    mission: Reconfiguration, control: Float[Array, "*k d"], draws: Float[Array, "*k d+1"]
) -> Float[Array, "*k d"]:
    """Return thrusts with errors of size and direction [m/s²].

    Draws are standard normal: the first of a row is of the size, the components of the others that
    are perpendicular to the thrust are of its direction.
    """
    size: Any = np.linalg.norm(control, axis=-1, keepdims=True)
    direction = control / np.where(size > 0, size, 1.0)
    across = draws[..., 1:]
    across = across - (across * direction).sum(axis=-1, keepdims=True) * direction
    tilted = direction + mission.pointing_error * across
    tilted = tilted / np.where(size > 0, np.linalg.norm(tilted, axis=-1, keepdims=True), 1.0)
    return np.asarray((1 + mission.thrust_error * draws[..., :1]) * size * tilted)
