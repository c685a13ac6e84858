"""Tschauner–Hempel equations: relative motion about an ellipse [Tschauner1965].

Axes (LVLH): x radial, outward; y transverse, in the plane and perpendicular to x; z normal
(cross-track). Velocities are relative to the rotating axes.
"""

from dataclasses import dataclass, field
from math import atan2, inf, isfinite, sqrt
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.elements import mean_anomaly, true_anomaly
from dynamics.model import LinearModel, Matrices
from dynamics.orbit import EARTH_MU, Orbit, Scalars, Vectors, validate_ellipse, validate_perigee

IN_PLANE = np.array([0, 1, 3, 4])  # entries of the state


class AnomalyTerms(NamedTuple):
    """Functions of the chief's true anomaly f."""

    e_sin: Array | float  # e sin f
    rho: Array | float  # ρ = 1 + e cos f = p/r
    omega: Array | float  # ω = ḟ, rate of rotation of the LVLH axes [rad/s]


@dataclass(frozen=True)
class TschaunerHempel(LinearModel):
    """Tschauner–Hempel equations about a Keplerian ellipse.

        ẍ =  2ωẏ + (ω² + 2μ/r³)x + αy + u_x
        ÿ = −2ωẋ + (ω² −  μ/r³)y − αx + u_y
        z̈ =            −(μ/r³)z       + u_z,     ω = h/r²,  α = ω̇

    Valid while the separation is small against the radius, at any eccentricity below 1,
    without J2. For e = 0 they are the Clohessy–Wiltshire equations.

    Args:
        semi_major_axis: a [m].
        eccentricity: e, from 0 to below 1.
        true_anomaly: True anomaly at time 0 [rad].
        mu: Gravitational parameter [m³/s²].

    Raises:
        ValueError: This is not an ellipse, or the perigee is inside the Earth.
    """

    semi_major_axis: float
    eccentricity: float
    true_anomaly: float = 0.0
    mu: float = EARTH_MU
    axes: int = field(default=3, init=False, repr=False)

    def __post_init__(self) -> None:
        """Check the ellipse."""
        validate_ellipse(self.semi_major_axis, self.eccentricity)
        if not 0 < self.mu < inf or not isfinite(self.true_anomaly):
            raise ValueError(
                "mu: must be positive and finite, and true_anomaly finite, got "
                f"{self.mu} m³/s² and {self.true_anomaly} rad"
            )
        validate_perigee(self.semi_major_axis, self.eccentricity)

    @classmethod
    def from_orbit(cls, orbit: Orbit) -> "TschaunerHempel":
        """Take the osculating ellipse of an orbit at time 0."""
        e_cos = orbit.h**2 / (orbit.mu * orbit.r) - 1
        e_sin = orbit.h * orbit.v_x / orbit.mu
        anomaly = atan2(e_sin, e_cos)
        return cls(orbit.semi_major_axis, orbit.eccentricity, anomaly, orbit.mu)

    @property
    def n(self) -> float:
        """Mean motion [rad/s]."""
        return sqrt(self.mu / self.semi_major_axis**3)

    @property
    def p(self) -> float:
        """Semi-latus rectum [m]."""
        return self.semi_major_axis * (1 - self.eccentricity**2)

    def true_anomaly_at(self, t: Scalars) -> Float[Array, "*k"]:
        """Return the chief's true anomaly, not reduced to one revolution [rad].

        Args:
            t: Time, positive or negative [s].
        """
        e = self.eccentricity
        return true_anomaly(mean_anomaly(self.true_anomaly, e) + self.n * np.asarray(t), e)

    def A(self, t: Scalars) -> Float[Array, "*k 6 6"]:
        """State matrix at one time or at many."""
        at = self._anomaly_terms(self.true_anomaly_at(t))
        w = at.omega
        pull = w**2 / at.rho  # μ/r³
        alpha = -2 * w**2 * at.e_sin / at.rho
        A = np.zeros((*np.shape(w), 6, 6))
        A[..., :3, 3:] = np.eye(3)
        A[..., 3, 0], A[..., 3, 1], A[..., 3, 4] = w**2 + 2 * pull, alpha, 2 * w
        A[..., 4, 0], A[..., 4, 1], A[..., 4, 3] = -alpha, w**2 - pull, -2 * w
        A[..., 5, 2] = -pull
        return A

    def matrices(self, times: Float[Array, " k"]) -> Matrices:
        """Stack A, B and z at many times."""
        k = len(times)
        return self.A(times), np.repeat(self.B(0.0)[None], k, axis=0), np.zeros((k, 6))

    def transition_matrix(self, start: Scalars, end: Scalars) -> Float[Array, "*#k 6 6"]:
        """Return Φ(end, start), free motion in closed form [Yamanaka2002].

        Args:
            start: Initial time [s].
            end: Final time, which may be before the initial one [s].
        """
        f0, f1 = np.broadcast_arrays(self.true_anomaly_at(start), self.true_anomaly_at(end))
        J = np.asarray(self._k * np.subtract(end, start))
        initial = self._fundamental_matrix(f0, np.zeros_like(J))
        plane = self._fundamental_matrix(f1, J) @ np.linalg.inv(initial)
        scaled = np.zeros((*f0.shape, 6, 6))
        scaled[..., IN_PLANE[:, None], IN_PLANE] = plane
        scaled[..., 2, 2] = scaled[..., 5, 5] = np.cos(f1 - f0)
        scaled[..., 2, 5] = np.sin(f1 - f0)
        scaled[..., 5, 2] = -scaled[..., 2, 5]
        return np.asarray(self._inverse_scaling_matrix(f1) @ scaled @ self._scaling_matrix(f0))

    def bounded_velocity(self, position: Vectors, t: float = 0.0) -> Vectors:
        """Return the velocity of a closed orbit through a position [m/s].

            ẏ = −(ω + μ/rh) x + (v_x/r) y,  ẋ = ż = 0

        matches the chief's energy to first order, and so its period. About a circle it is
        ẏ = −2nx.

        Args:
            position: Relative to the chief [m].
            t: Time at that position [s].
        """
        at = self._anomaly_terms(self.true_anomaly_at(t))
        x, y = position[..., 0], position[..., 1]
        velocity = np.zeros(position.shape)
        # μ/rh = ω/ρ and v_x/r = ω e sin f/ρ.
        velocity[..., 1] = at.omega * ((at.e_sin * y - x) / at.rho - x)
        return velocity

    @property
    def _k(self) -> float:
        """Constant k = h/p² of ḟ = k ρ² [rad/s]."""
        return sqrt(self.mu / self.p**3)

    def _anomaly_terms(self, f: Array) -> AnomalyTerms:
        rho = 1 + self.eccentricity * np.cos(f)
        return AnomalyTerms(self.eccentricity * np.sin(f), rho, self._k * rho**2)

    def _fundamental_matrix(self, f: Array, J: Array) -> Array:
        """Return four in-plane solutions as columns of ρx, ρy and their derivatives by f.

        Only the last of them drifts. J is k times the time since the initial instant.
        """
        e, C, S = self.eccentricity, np.cos(f), np.sin(f)
        rho = 1 + e * C
        s, c = rho * S, rho * C
        ds, dc = C + e * np.cos(2 * f), -(S + e * np.sin(2 * f))
        zero, one = np.zeros_like(f), np.ones_like(f)
        rows = [
            [zero, s, c, 2 - 3 * e * s * J],
            [one, c + C, -s - S, -3 * rho**2 * J],
            [zero, ds, dc, -3 * e * (ds * J + S / rho)],
            [zero, -2 * s, e - 2 * c, 6 * e * s * J - 3],
        ]
        return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)

    def _scaling_matrix(self, f: Array) -> Array:
        """Map the state to ρ times the position and its derivative by f."""
        at = self._anomaly_terms(f)
        return _block_matrix(at.rho, np.zeros_like(f), -at.e_sin, at.rho / at.omega)

    def _inverse_scaling_matrix(self, f: Array) -> Array:
        """Invert `_scaling_matrix`."""
        at = self._anomaly_terms(f)
        return _block_matrix(1 / at.rho, np.zeros_like(f), self._k * at.e_sin, self._k * at.rho)


def _block_matrix(a: Array | float, b: Array, c: Array | float, d: Array | float) -> Array:
    """Return [[a I, b I], [c I, d I]]."""
    both = np.stack([np.stack([a, b], axis=-1), np.stack([c, d], axis=-1)], axis=-2)
    return np.asarray(np.kron(both, np.eye(3)))
