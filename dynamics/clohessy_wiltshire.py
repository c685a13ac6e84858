"""Relative motion about a circular orbit [Clohessy1960].

Axes: x radially out, y along the orbit, z along its normal. Velocities are those
seen in the rotating frame.
"""

from dataclasses import dataclass, field
from math import inf
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.model import LinearModel


@dataclass(frozen=True)
class ClohessyWiltshire(LinearModel):
    """The Clohessy–Wiltshire equations.

        ẍ =  3n²x + 2nẏ + u_x
        ÿ =        −2nẋ + u_y
        z̈ = −n²z        + u_z

    Good while the separation is small against the radius of the orbit.
    """

    n: float  # mean motion of the chief [rad/s]
    axes: int = field(default=3, init=False, repr=False)
    constant: ClassVar[bool] = True

    def __post_init__(self) -> None:
        """Refuse an orbit that does not turn."""
        if not 0 < self.n < inf:
            raise ValueError(f"mean motion must be positive and finite, got n = {self.n} rad/s")

    def A(self, t: float) -> Float[Array, "6 6"]:
        """State matrix, constant in time."""
        n = self.n
        K = np.diag([3 * n**2, 0, -(n**2)])  # gravity gradient
        C = np.array([[0, 2 * n, 0], [-2 * n, 0, 0], [0, 0, 0]])  # Coriolis
        return np.block([[np.zeros((3, 3)), np.eye(3)], [K, C]])

    def bounded(self, position: Float[Array, "*k 3"]) -> Float[Array, "*k 3"]:
        """Velocity with which an orbit through a position closes [m/s].

        ẏ = −2nx cancels the drift along the orbit; the other axes are left at rest.
        """
        velocity = np.zeros(position.shape)
        velocity[..., 1] = -2 * self.n * position[..., 0]
        return velocity
