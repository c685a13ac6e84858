"""Classical elements, and what they are of a state.

They are not defined for every ellipse, and a convention fills in, so that no orbit is
refused and every round trip closes:

    circular (e = 0)       no perigee; it is put at the node, and the anomaly counts from there
    equatorial (i = 0, π)  no node; it is put on the x axis

Near these they jump about though the orbit hardly changes. The six numbers of `Orbit`
have no trouble with circular orbits, and inertial states with none at all.
"""

from dataclasses import dataclass
from math import pi

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.coordinate_frames import inertial_state, to_polar_nodal
from dynamics.orbit import EARTH_MU

MAX_NEWTON_ITERATIONS = 50  # iterations at most; 6 do for e = 0.9


@dataclass(frozen=True, eq=False)
class ClassicalElements:
    """Osculating classical elements of one orbit, or of many; angles in radians."""

    semi_major_axis: float | Float[Array, "*k"]  # [m]
    eccentricity: float | Float[Array, "*k"]
    inclination: float | Float[Array, "*k"]
    raan: float | Float[Array, "*k"]  # right ascension of the ascending node
    arg_perigee: float | Float[Array, "*k"]  # argument of perigee, from the node
    true_anomaly: float | Float[Array, "*k"]  # true anomaly

    def __post_init__(self) -> None:
        """Refuse what is no ellipse."""
        validate_eccentricity(self.eccentricity)
        a, i = np.ravel(self.semi_major_axis), np.ravel(self.inclination)
        if len(wrong := a[~((a > 0) & np.isfinite(a))]):
            raise ValueError(f"a semi-major axis is positive and finite, got {wrong[0]} m")
        if len(wrong := i[~((i >= 0) & (i <= pi))]):
            tilt = np.degrees(wrong[0])
            raise ValueError(f"an inclination lies between 0 and 180 degrees, got {tilt:.6g}")

    @classmethod
    def from_polar_nodal(
        cls, chief: Float[Array, "*k 6"], mu: float = EARTH_MU
    ) -> "ClassicalElements":
        """Elements of the six numbers of an orbit.

        Raises:
            ValueError: This is no ellipse.
        """
        r, v_x, h, node, i, latitude = np.moveaxis(chief, -1, 0)
        p = h**2 / mu
        cosine, sine = p / r - 1, h * v_x / mu  # of the anomaly, times e
        e = np.hypot(cosine, sine)
        anomaly = np.where(e == 0, latitude, np.arctan2(sine, cosine))
        with np.errstate(divide="ignore"):  # a parabola is refused below
            a = p / ((1 - e) * (1 + e))
        return cls(a, e, i, node, latitude - anomaly, anomaly)

    @classmethod
    def from_state(cls, state: Float[Array, "*k 6"], mu: float = EARTH_MU) -> "ClassicalElements":
        """Elements of inertial states [Vallado2013, algorithm 9].

        Raises:
            ValueError: This is no ellipse.
        """
        return cls.from_polar_nodal(to_polar_nodal(state), mu)

    def to_polar_nodal(self, mu: float = EARTH_MU) -> Float[Array, "*k 6"]:
        """The six numbers of these orbits."""
        e = np.asarray(self.eccentricity)
        p = self.semi_major_axis * (1 - e) * (1 + e)
        h = np.sqrt(mu * p)
        r = p / (1 + e * np.cos(self.true_anomaly))
        v_x = mu / h * e * np.sin(self.true_anomaly)
        latitude = self.arg_perigee + self.true_anomaly
        parts = np.broadcast_arrays(r, v_x, h, self.raan, self.inclination, latitude)
        return np.stack(parts, axis=-1).astype(float)

    def to_state(self, mu: float = EARTH_MU) -> Float[Array, "*k 6"]:
        """Inertial states [Vallado2013, algorithm 10]."""
        return inertial_state(self.to_polar_nodal(mu))

    @property
    def mean_anomaly(self) -> Float[Array, "*k"]:
        """M = E − e sin E."""
        return mean_anomaly(self.true_anomaly, self.eccentricity)


def mean_anomaly(
    anomaly: float | Float[Array, "*k"], eccentricity: float | Float[Array, "*k"]
) -> Float[Array, "*k"]:
    """Mean anomaly of a true one, counted over revolutions."""
    f, e = np.asarray(anomaly), np.asarray(eccentricity)
    beta = e / (1 + np.sqrt(1 - e**2))  # tan((f − E)/2) = β sin f/(1 + β cos f)
    E = f - 2 * np.arctan2(beta * np.sin(f), 1 + beta * np.cos(f))
    return np.asarray(E - e * np.sin(E))


def true_anomaly(
    mean: float | Float[Array, "*k"], eccentricity: float | Float[Array, "*k"]
) -> Float[Array, "*k"]:
    """True anomaly of a mean one, counted over revolutions."""
    M, e = np.asarray(mean, dtype=float), np.asarray(eccentricity, dtype=float)
    turns = 2 * pi * np.round(M / (2 * pi))
    sign, M = np.sign(M - turns), np.abs(M - turns)
    # On [0, π] E − e sin E − M is convex, and not negative at M + e nor at π: from there
    # Newton's steps only go down, so they cannot miss.
    E = np.minimum(M + e, pi)
    for _ in range(MAX_NEWTON_ITERATIONS):
        step = (E - e * np.sin(E) - M) / (1 - e * np.cos(E))
        E = E - step
        if (np.abs(step) <= 1e-15).all():
            break
    beta = e / (1 + np.sqrt(1 - e**2))
    f = E + 2 * np.arctan2(beta * np.sin(E), 1 - beta * np.cos(E))
    return np.asarray(turns + sign * f)


def validate_eccentricity(eccentricity: float | Float[Array, "*k"]) -> None:
    """Refuse what never comes back.

    Raises:
        ValueError: An eccentricity is not in [0, 1).
    """
    e = np.ravel(eccentricity)
    if len(wrong := e[~((e >= 0) & (e < 1))]):
        raise ValueError(
            f"these elements are of ellipses, with 0 ≤ e < 1, got an eccentricity of "
            f"{wrong[0]:.6g}; an orbit that never comes back is held by its inertial position "
            "and velocity"
        )
