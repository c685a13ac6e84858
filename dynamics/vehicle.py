"""State of vehicles that are commanded by velocity and yaw rate."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.doors import checked


class VehicleState(NamedTuple):
    """State of one vehicle or of many, with any leading axes."""

    position: Float[Array, "*k 3"]  # in the world frame [m]
    yaw: Float[Array, "*k"]  # [rad]
    velocity: Float[Array, "*k 3"]  # in the heading frame [m/s]
    yaw_rate: Float[Array, "*k"]  # [rad/s]
    acceleration: Float[Array, "*k 3"]  # of quadrotors, in the world frame [m/s²]

    @classmethod
    def at_rest(cls, position: Float[Array, "*k 3"], yaw: Float[Array, "*k"]) -> "VehicleState":
        """Return the state of vehicles that hover."""
        zero, still = np.zeros_like(yaw), np.zeros_like(position)
        return cls(position, yaw, still, zero, still.copy())


def vector_lengths(vectors: Float[Array, "*k d"]) -> Float[Array, "*k"]:
    """Compute lengths along the last axis; of short vectors NumPy's norm takes thrice as long."""
    return np.asarray(np.sqrt(np.vecdot(vectors, vectors)))


@checked
def rotate_by_yaw(
    vectors: Float[Array, "*#k 3"], yaw: Float[Array, "*#k"] | float
) -> Float[Array, "*#k 3"]:
    """Rotate vectors from heading frames to the world frame: R_z(ψ) v."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = vectors[..., 0], vectors[..., 1]
    turned = np.asarray(c * x - s * y)
    rotated = np.empty((*turned.shape, 3))
    rotated[..., 0], rotated[..., 1], rotated[..., 2] = turned, s * x + c * y, vectors[..., 2]
    return rotated
