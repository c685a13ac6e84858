"""Clohessy–Wiltshire equations: relative motion about a circular orbit [Clohessy1960]."""

from dataclasses import dataclass
from math import inf

from dynamics.circular_orbit import CircularOrbitModel
from dynamics.orbit import Orbit


@dataclass(frozen=True)
class ClohessyWiltshire(CircularOrbitModel):
    """Clohessy–Wiltshire equations.

        ẍ =  3n²x + 2nẏ + u_x
        ÿ =        −2nẋ + u_y
        z̈ = −n²z        + u_z

    Valid while the separation is small against the radius of the orbit. Errors from J2, the
    eccentricity and second-order terms add up: see `scripts/linear_model_errors.py`.
    """

    n: float  # mean motion of the chief [rad/s]

    def __post_init__(self) -> None:
        """Check the mean motion."""
        if not 0 < self.n < inf:
            raise ValueError(f"n: the mean motion must be positive and finite, got {self.n} rad/s")

    @classmethod
    def from_orbit(cls, orbit: Orbit) -> "ClohessyWiltshire":
        """Take a circle with the mean motion of the orbit at time 0."""
        return cls(orbit.mean_motion)

    @property
    def rotation_rate(self) -> float:
        """a: rate of rotation of the LVLH axes [rad/s]."""
        return self.n

    @property
    def radial_gradient(self) -> float:
        """b: gravity gradient and centrifugal term along the radius [1/s²]."""
        return 3 * self.n**2

    @property
    def cross_track_rate(self) -> float:
        """q: rate of the cross-track oscillation [rad/s]."""
        return self.n
