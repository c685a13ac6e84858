"""Relative motion about a circular orbit of Kepler's [Clohessy1960]."""

from dataclasses import dataclass
from math import inf

from dynamics.circular_orbit import CircularOrbitModel
from dynamics.orbit import Orbit


@dataclass(frozen=True)
class ClohessyWiltshire(CircularOrbitModel):
    """The Clohessy–Wiltshire equations.

        ẍ =  3n²x + 2nẏ + u_x
        ÿ =        −2nẋ + u_y
        z̈ = −n²z        + u_z

    Good while the separation is small against the radius of the orbit. What it leaves
    out, J2, the eccentricity and second order, adds up: see `scripts/linear_model_errors.py`.
    """

    n: float  # mean motion of the chief [rad/s]

    def __post_init__(self) -> None:
        """Refuse an orbit that does not turn."""
        if not 0 < self.n < inf:
            raise ValueError(f"mean motion must be positive and finite, got n = {self.n} rad/s")

    @classmethod
    def from_orbit(cls, orbit: Orbit) -> "ClohessyWiltshire":
        """About a circle with the mean motion that the orbit has at time 0."""
        return cls(orbit.mean_motion)

    @property
    def rotation_rate(self) -> float:
        """The rate at which the axes turn [rad/s]."""
        return self.n

    @property
    def radial_gradient(self) -> float:
        """The gravity gradient and centrifugal force along the radius [1/s²]."""
        return 3 * self.n**2

    @property
    def cross_track_rate(self) -> float:
        """Rate of the oscillation through the plane [rad/s]."""
        return self.n
