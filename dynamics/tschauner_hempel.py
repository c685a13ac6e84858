"""Tschauner–Hempel equations: relative motion about an ellipse [Tschauner1965].

Axes (LVLH): x radial, outward; y transverse, in the plane and perpendicular to x; z normal
(cross-track). Velocities are relative to the rotating axes.
"""

from dataclasses import dataclass, field
from math import atan2, inf, isfinite, pi, sqrt
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.model import LinearModel, Matrices
from dynamics.orbit import (
    EARTH_MU,
    Orbit,
    Scalars,
    Vectors,
    validate_eccentricity,
    validate_semi_major_axis,
)

MAX_NEWTON_ITERATIONS = 50  # 6 are enough for e = 0.9


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
        validate_eccentricity(self.eccentricity)
        if not 0 < self.mu < inf or not isfinite(self.true_anomaly):
            raise ValueError(
                "mu: must be positive and finite, and true_anomaly finite, got "
                f"{self.mu} m³/s² and {self.true_anomaly} rad"
            )
        validate_semi_major_axis(self.semi_major_axis, self.eccentricity)

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

    def true_anomaly_at(self, t: Scalars) -> Float[Array, "*k"]:
        """Return the chief's true anomaly, not reduced to one revolution [rad].

        Args:
            t: Time, positive or negative [s].
        """
        e = self.eccentricity
        return true_anomaly(mean_anomaly(self.true_anomaly, e) + self.n * np.asarray(t), e)

    def A(self, t: Scalars) -> Float[Array, "*k 6 6"]:
        """State matrix at one time or at many."""
        at = self._anomaly_terms(t)
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

    def bounded_velocity(self, position: Vectors, t: float = 0.0) -> Vectors:
        """Return the velocity of a closed orbit through a position [m/s].

            ẏ = −(ω + μ/rh) x + (v_x/r) y,  ẋ = ż = 0

        matches the chief's energy to first order, and so its period. About a circle it is
        ẏ = −2nx.

        Args:
            position: Relative to the chief [m].
            t: Time at that position [s].
        """
        at = self._anomaly_terms(t)
        x, y = position[..., 0], position[..., 1]
        velocity = np.zeros(position.shape)
        # μ/rh = ω/ρ and v_x/r = ω e sin f/ρ.
        velocity[..., 1] = at.omega * ((at.e_sin * y - x) / at.rho - x)
        return velocity

    def _anomaly_terms(self, t: Scalars) -> AnomalyTerms:
        f, p = self.true_anomaly_at(t), self.semi_major_axis * (1 - self.eccentricity**2)
        rho = 1 + self.eccentricity * np.cos(f)
        return AnomalyTerms(self.eccentricity * np.sin(f), rho, sqrt(self.mu / p**3) * rho**2)


def mean_anomaly(true_anomaly: Scalars, eccentricity: Scalars) -> Float[Array, "*k"]:
    """Convert a true anomaly, not reduced to one revolution."""
    f, e = np.asarray(true_anomaly), np.asarray(eccentricity)
    beta = e / (1 + np.sqrt(1 - e**2))  # tan((f − E)/2) = β sin f/(1 + β cos f)
    E = f - 2 * np.arctan2(beta * np.sin(f), 1 + beta * np.cos(f))
    return np.asarray(E - e * np.sin(E))


def true_anomaly(mean_anomaly: Scalars, eccentricity: Scalars) -> Float[Array, "*k"]:
    """Solve Kepler's equation for a mean anomaly, not reduced to one revolution."""
    M, e = np.asarray(mean_anomaly, dtype=float), np.asarray(eccentricity, dtype=float)
    turns = 2 * pi * np.round(M / (2 * pi))
    sign, M = np.sign(M - turns), np.abs(M - turns)
    # On [0, π] the function E − e sin E − M is convex, and it is not negative at M + e or at
    # π. From there Newton's method decreases monotonically to the root.
    E = np.minimum(M + e, pi)
    for _ in range(MAX_NEWTON_ITERATIONS):
        step = (E - e * np.sin(E) - M) / (1 - e * np.cos(E))
        E = E - step
        if (np.abs(step) <= 1e-15).all():
            break
    beta = e / (1 + np.sqrt(1 - e**2))
    f = E + 2 * np.arctan2(beta * np.sin(E), 1 - beta * np.cos(E))
    return np.asarray(turns + sign * f)
