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
from dynamics.orbit import Scalars, Vectors


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

    def transition_matrix(self, t: Scalars) -> Float[Array, "*k 6 6"]:
        """Return Φ(t) = exp(A t) in closed form: free motion over a time t.

        Args:
            t: Time, positive or negative [s].
        """
        a, b = self.rotation_rate, self.radial_gradient
        q, w = self.cross_track_rate, self.in_plane_rate
        t = np.asarray(t, dtype=float)
        S, V, L = _sine_integrals(w, t)
        Phi = np.zeros((*t.shape, 6, 6))
        Phi[..., 0, 0], Phi[..., 0, 3], Phi[..., 0, 4] = 1 + b * V, S, 2 * a * V
        Phi[..., 1, 0], Phi[..., 1, 1] = -2 * a * b * L, 1
        Phi[..., 1, 3], Phi[..., 1, 4] = -2 * a * V, t - 4 * a**2 * L
        Phi[..., 3, 0], Phi[..., 3, 3], Phi[..., 3, 4] = b * S, np.cos(w * t), 2 * a * S
        Phi[..., 4, 0], Phi[..., 4, 3] = -2 * a * b * V, -2 * a * S
        Phi[..., 4, 4] = 1 - 4 * a**2 * V
        Phi[..., 2, 2] = Phi[..., 5, 5] = np.cos(q * t)
        Phi[..., 2, 5], Phi[..., 5, 2] = np.sin(q * t) / q, -q * np.sin(q * t)
        return Phi

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


def _sine_integrals(w: float, t: Array) -> tuple[Array, Array, Array]:
    """Return S = sin(wt)/w and its repeated integrals V = (1 − cos wt)/w², L = (t − S)/w²."""
    angle = w * t
    S = np.sin(angle) / w
    V = 2 * np.sin(angle / 2) ** 2 / w**2
    # In short steps t − S cancels to a few digits; its series keeps all of them.
    x = np.minimum(angle**2, 0.25)
    series = 1 - x / 20 * (1 - x / 42 * (1 - x / 72 * (1 - x / 110 * (1 - x / 156))))
    L = np.where(np.abs(angle) < 0.5, t**3 / 6 * series, (t - S) / w**2)
    return np.asarray(S), np.asarray(V), L
