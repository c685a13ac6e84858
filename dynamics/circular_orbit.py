"""Relative motion about a circular orbit: base of the time-invariant models.

Axes (LVLH): x radial, outward; y transverse (along-track); z normal (cross-track).
Velocities are relative to the rotating axes.
"""

from abc import abstractmethod
from math import sqrt
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.model import LinearModel
from dynamics.orbit import Vectors


class CircularOrbitModel(LinearModel):
    """Linear model of relative motion about a circular orbit.

        ẍ =  2aẏ + bx + u_x
        ÿ = −2aẋ      + u_y
        z̈ = −q²z      + u_z

    Let w² = 4a² − b. Without control, D = ẏ + 2ax is constant, and the in-plane motion is
    an ellipse with semi-axes in the ratio w : 2a, traversed at the rate w, about a center
    that drifts along the orbit at −(b/w²) D. The orbit is closed if and only if D = 0.
    """

    axes: int = 3
    is_time_invariant: ClassVar[bool] = True

    @property
    @abstractmethod
    def rotation_rate(self) -> float:
        """a: rate of rotation of the LVLH axes [rad/s]."""

    @property
    @abstractmethod
    def radial_gradient(self) -> float:
        """b: gravity gradient and centrifugal term along the radius [1/s²]."""

    @property
    @abstractmethod
    def cross_track_rate(self) -> float:
        """q: rate of the cross-track oscillation [rad/s]."""

    @property
    def in_plane_rate(self) -> float:
        """w: rate of the in-plane motion [rad/s]."""
        return sqrt(4 * self.rotation_rate**2 - self.radial_gradient)

    def A(self, t: float) -> Float[Array, "6 6"]:
        """State matrix."""
        a = self.rotation_rate
        K = np.diag([self.radial_gradient, 0, -(self.cross_track_rate**2)])
        C = np.array([[0, 2 * a, 0], [-2 * a, 0, 0], [0, 0, 0]])
        return np.block([[np.zeros((3, 3)), np.eye(3)], [K, C]])

    def bounded_velocity(self, position: Vectors, t: float = 0.0) -> Vectors:
        """Return the velocity of a closed orbit through a position [m/s].

        ẏ = −2ax cancels the along-track drift; ẋ = ż = 0.

        Args:
            position: Relative to the chief [m].
            t: Time; without effect, as the model is time-invariant [s].
        """
        velocity = np.zeros(position.shape)
        velocity[..., 1] = -2 * self.rotation_rate * position[..., 0]
        return velocity

    def centered_velocity(self, position: Vectors, t: float = 0.0) -> Vectors:
        """Return the velocity of a closed orbit that is centered on the chief [m/s].

        ẋ = w²y / 2a and ẏ = −2ax put the center of the ellipse at the chief; ż = 0.

        Args:
            position: Relative to the chief [m].
            t: Time; without effect, as the model is time-invariant [s].
        """
        velocity = self.bounded_velocity(position)
        velocity[..., 0] = self.in_plane_rate**2 / (2 * self.rotation_rate) * position[..., 1]
        return velocity
