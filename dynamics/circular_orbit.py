"""Relative motion about a circle: what the models with constant matrices share.

Axes: x radially out, y along the orbit, z along its normal. Velocities are those
seen in the rotating frame.
"""

from abc import abstractmethod
from math import sqrt
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.model import LinearModel


class CircularOrbitModel(LinearModel):
    """A linear model about a circular orbit.

        ẍ =  2aẏ + bx + u_x
        ÿ = −2aẋ      + u_y
        z̈ = −q²z      + u_z

    In the plane, with w² = 4a² − b and D = ẏ + 2ax, which stays what it was, a free
    vehicle goes round an ellipse whose half axes are as w to 2a, at the rate w, about
    a centre that moves along the orbit at −(b/w²) D. It closes if and only if D = 0.
    """

    axes: int = 3
    is_time_invariant: ClassVar[bool] = True

    @property
    @abstractmethod
    def rotation_rate(self) -> float:
        """a: the rate at which the axes turn [rad/s]."""

    @property
    @abstractmethod
    def radial_gradient(self) -> float:
        """b: the gravity gradient and centrifugal force along the radius [1/s²]."""

    @property
    @abstractmethod
    def cross_track_rate(self) -> float:
        """q: rate of the oscillation through the plane [rad/s]."""

    @property
    def in_plane_rate(self) -> float:
        """w: rate of the motion in the plane [rad/s]."""
        return sqrt(4 * self.rotation_rate**2 - self.radial_gradient)

    def A(self, t: float) -> Float[Array, "6 6"]:
        """State matrix, constant in time."""
        a = self.rotation_rate
        K = np.diag([self.radial_gradient, 0, -(self.cross_track_rate**2)])
        C = np.array([[0, 2 * a, 0], [-2 * a, 0, 0], [0, 0, 0]])
        return np.block([[np.zeros((3, 3)), np.eye(3)], [K, C]])

    def transition_matrix(self, t: float | Float[Array, "*k"]) -> Float[Array, "*k 6 6"]:
        """Φ(t): the state t seconds later, without input. exp(A t) in closed form.

        Args:
            t: How much later [s]; of either sign.
        """
        a, b, q, w = (
            self.rotation_rate,
            self.radial_gradient,
            self.cross_track_rate,
            self.in_plane_rate,
        )
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

    def zoh_input_matrix(self, t: float | Float[Array, "*k"]) -> Float[Array, "*k 6 3"]:
        """Γ(t): the state t seconds after rest at the origin, for an acceleration held since.

        Args:
            t: For how long it is held [s].
        """
        a, w = self.rotation_rate, self.in_plane_rate
        t = np.asarray(t, dtype=float)
        _, V, L = _sine_integrals(w, t)
        Gamma = np.zeros((*t.shape, 6, 3))
        Gamma[..., 0, 0], Gamma[..., 0, 1], Gamma[..., 1, 0] = V, 2 * a * L, -2 * a * L
        Gamma[..., 1, 1] = t**2 / 2 - 4 * (a / w) ** 2 * (t**2 / 2 - V)
        Gamma[..., 2, 2] = _sine_integrals(self.cross_track_rate, t)[1]
        # Γ is the integral of Φ B, and so its rate in time is Φ B.
        Gamma[..., 3:, :] = self.transition_matrix(t)[..., :3, 3:]
        return Gamma

    def bounded_velocity(
        self, position: Float[Array, "*k 3"], t: float = 0.0
    ) -> Float[Array, "*k 3"]:
        """Velocity with which an orbit through a position closes [m/s].

        ẏ = −2ax cancels the drift along the orbit; the other axes are left at rest.

        Args:
            position: Relative to the chief [m].
            t: When; all times are alike here [s].
        """
        velocity = np.zeros(position.shape)
        velocity[..., 1] = -2 * self.rotation_rate * position[..., 0]
        return velocity

    def centered_velocity(
        self, position: Float[Array, "*k 3"], t: float = 0.0
    ) -> Float[Array, "*k 3"]:
        """Velocity with which an orbit through a position closes round the chief [m/s].

        ẋ = w²y / 2a puts the chief in the middle; the normal axis is left at rest.

        Args:
            position: Relative to the chief [m].
            t: When; all times are alike here [s].
        """
        velocity = self.bounded_velocity(position)
        velocity[..., 0] = self.in_plane_rate**2 / (2 * self.rotation_rate) * position[..., 1]
        return velocity


def _sine_integrals(w: float, t: Array) -> tuple[Array, Array, Array]:
    """The sine of wt over w, and its integrals in turn: S, (1 − cos wt)/w² and (t − S)/w²."""
    angle = w * t
    S = np.sin(angle) / w
    V = 2 * np.sin(angle / 2) ** 2 / w**2
    # The difference loses its digits in short steps, where its series does not.
    x = np.minimum(angle**2, 0.25)
    series = 1 - x / 20 * (1 - x / 42 * (1 - x / 72 * (1 - x / 110 * (1 - x / 156))))
    L = np.where(np.abs(angle) < 0.5, t**3 / 6 * series, (t - S) / w**2)
    return np.asarray(S), np.asarray(V), L
