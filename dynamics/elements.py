"""Classical orbital elements and their conversions.

Classical elements are not defined for every ellipse. A convention fills the gaps, so that
every orbit converts and every round trip closes:

    circular (e = 0)       no perigee: ω = 0, and the true anomaly counts from the node
    equatorial (i = 0, π)  no node: Ω = 0, on the x axis

Near these orbits a small change of state changes the elements a lot. The polar-nodal
elements of `Orbit` are regular for circular orbits, and inertial states for all.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.coordinate_frames import inertial_state, to_polar_nodal
from dynamics.orbit import EARTH_MU, OrbitStates, Scalars, validate_ellipse, validate_inclination

MAX_NEWTON_ITERATIONS = 50  # 6 are enough for e = 0.9


@dataclass(frozen=True, eq=False)
class ClassicalElements:
    """Osculating classical elements of one orbit or of many, angles in radians."""

    semi_major_axis: Scalars  # [m]
    eccentricity: Scalars
    inclination: Scalars
    raan: Scalars  # right ascension of the ascending node, Ω
    arg_perigee: Scalars  # argument of perigee, ω, from the node
    true_anomaly: Scalars

    def __post_init__(self) -> None:
        """Check that all orbits are ellipses."""
        validate_ellipse(self.semi_major_axis, self.eccentricity)
        validate_inclination(self.inclination)

    @classmethod
    def from_polar_nodal(cls, chief: OrbitStates, mu: float = EARTH_MU) -> "ClassicalElements":
        """Convert polar-nodal elements.

        Raises:
            ValueError: An orbit is not an ellipse.
        """
        r, v_x, h, node, i, latitude = np.moveaxis(chief, -1, 0)
        p = h**2 / mu
        e_cos, e_sin = p / r - 1, h * v_x / mu
        e = np.hypot(e_cos, e_sin)
        anomaly = np.where(e == 0, latitude, np.arctan2(e_sin, e_cos))
        with np.errstate(divide="ignore"):  # a parabola is refused by the constructor
            a = p / ((1 - e) * (1 + e))
        return cls(a, e, i, node, latitude - anomaly, anomaly)

    @classmethod
    def from_state(cls, state: Float[Array, "*k 6"], mu: float = EARTH_MU) -> "ClassicalElements":
        """Convert inertial states [Vallado2013, algorithm 9].

        Raises:
            ValueError: An orbit is not an ellipse.
        """
        return cls.from_polar_nodal(to_polar_nodal(state), mu)

    def to_polar_nodal(self, mu: float = EARTH_MU) -> Float[Array, "*k 6"]:
        """Return the polar-nodal elements."""
        e = np.asarray(self.eccentricity)
        p = self.semi_major_axis * (1 - e) * (1 + e)
        h = np.sqrt(mu * p)
        r = p / (1 + e * np.cos(self.true_anomaly))
        v_x = mu / h * e * np.sin(self.true_anomaly)
        latitude = self.arg_perigee + self.true_anomaly
        parts = np.broadcast_arrays(r, v_x, h, self.raan, self.inclination, latitude)
        return np.stack(parts, axis=-1).astype(float)

    def to_state(self, mu: float = EARTH_MU) -> Float[Array, "*k 6"]:
        """Return the inertial states [Vallado2013, algorithm 10]."""
        return inertial_state(self.to_polar_nodal(mu))


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
