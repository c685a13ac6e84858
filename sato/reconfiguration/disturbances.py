"""What thrusters make of a command."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.reconfiguration.mission import Reconfiguration


def has_thruster_errors(mission: Reconfiguration) -> bool:
    """Whether thrusters do otherwise than they are told."""
    return mission.thrust_error > 0 or mission.pointing_error > 0


def apply_thruster_errors(
    mission: Reconfiguration, control: Float[Array, "*k d"], draws: Float[Array, "*k d+1"]
) -> Float[Array, "*k d"]:
    """Thrust of the wrong size in the wrong direction [m/s²].

    Args:
        mission: How wrong thrusters are.
        control: As commanded [m/s²].
        draws: Standard normal; the first of a row is of the size, the others, as far as they
            are square to the thrust, of its direction.
    """
    size = np.linalg.norm(control, axis=-1, keepdims=True)
    along = control / np.where(size > 0, size, 1.0)
    aside = draws[..., 1:]
    aside = aside - (aside * along).sum(axis=-1, keepdims=True) * along
    tilted = along + mission.pointing_error * aside
    tilted = tilted / np.where(size > 0, np.linalg.norm(tilted, axis=-1, keepdims=True), 1.0)
    return np.asarray((1 + mission.thrust_error * draws[..., :1]) * size * tilted)
