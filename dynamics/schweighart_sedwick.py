"""Relative motion about a circular orbit under the mean of J2 [Schweighart2002]."""

from dataclasses import dataclass
from math import cos, inf, pi, sin, sqrt

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.circular_orbit import CircularOrbitModel
from dynamics.orbit import EARTH_MU, EARTH_RADIUS, K_J2, Orbit


@dataclass(frozen=True)
class SchweighartSedwick(CircularOrbitModel):
    """The Clohessy–Wiltshire equations with the gradient of J2, averaged round the orbit.

        ẍ =  2ncẏ + (5c² − 2)n²x + u_x
        ÿ = −2ncẋ                + u_y
        z̈ = −k_z²z               + u_z

        s = k_J2 (1 + 3 cos 2i) / (4μr²),  c = √(1 + s),  k_z = nc + n k_J2 cos²i / (μr²)

    The axes turn at nc, as the plane of the chief's orbit and the chief in it do on average,
    and k_z is the rate of its argument of latitude, nodes included.

    Good while the separation is small against the radius of a nearly circular orbit, and
    across the plane while all inclinations are the same. Where they are not, nodes part and
    z grows slowly: [Schweighart2002] has 2lq cos(qt + φ) on the right of z̈, which the state
    does not determine without the chief's latitude. It is left out of A; `across` has it.
    """

    radius: float  # of the chief's orbit [m]
    inclination: float  # of the chief's orbit [rad]
    mu: float = EARTH_MU  # gravitational parameter [m³/s²]
    k_J2: float = K_J2  # 3/2 J₂ μ R² [m⁵/s²]; 0 is Clohessy–Wiltshire

    def __post_init__(self) -> None:
        """Refuse an orbit inside the Earth, or one that J2 dominates."""
        if not EARTH_RADIUS < self.radius < inf:
            raise ValueError(
                f"a circle needs a radius above the Earth's, {EARTH_RADIUS / 1e3:.0f} km, from the "
                f"centre and in metres, got {self.radius} m"
            )
        if not 0 <= self.inclination <= pi:
            raise ValueError(
                f"an inclination lies between 0 and π rad, got {self.inclination}; "
                "degrees are to be converted"
            )
        if not 0 < self.mu < inf:
            raise ValueError(f"gravity must be positive and finite, got mu = {self.mu} m³/s²")
        if not abs(self.k_J2) < 0.1 * self.mu * self.radius**2:
            raise ValueError(
                f"J2 is a small part of gravity here, got k_J2 = {self.k_J2} m⁵/s², which is "
                f"{self.k_J2 / (self.mu * self.radius**2):.3g} of it; the Earth's is {K_J2:.4g}"
            )

    @classmethod
    def from_orbit(cls, orbit: Orbit) -> "SchweighartSedwick":
        """About the circle on which the averaged J2 leaves the energy that the orbit has.

        Its rates are the orbit's own on average, to about a hundred-thousandth where the
        eccentricity is of the order of J2. With the semi-major axis of an instant they would
        be wrong by up to three thousandths, for J2 makes that axis swing by kilometres in
        each orbit; across the plane it would show as 20 m an orbit for each km. In the plane
        one is as good as the other: the start's own share in what is averaged away decides.
        """
        mu, k = orbit.mu, orbit.k_J2
        first = cls(orbit.semi_major_axis, orbit.inclination, mu, k)
        Z2 = (sin(orbit.inclination) * sin(orbit.arg_latitude)) ** 2
        energy = -mu / (2 * orbit.semi_major_axis) - k / orbit.r**3 * (1 / 3 - Z2)
        # On a circle at the rate nc it is −μ/2r + μs/6r; s is known well enough from the first.
        return cls(-mu / (2 * energy) * (1 - first.s / 3), orbit.inclination, mu, k)

    @property
    def n(self) -> float:
        """Rate of Kepler's motion on the circle [rad/s]."""
        return sqrt(self.mu / self.radius**3)

    @property
    def s(self) -> float:
        """Strength of J2, averaged round the orbit."""
        return self._j2_ratio * (1 + 3 * cos(2 * self.inclination)) / 4

    @property
    def c(self) -> float:
        """How much faster than at n the axes turn."""
        return sqrt(1 + self.s)

    @property
    def k_z(self) -> float:
        """Rate of the argument of latitude [rad/s]."""
        return self.n * (self.c + self._j2_ratio * cos(self.inclination) ** 2)

    @property
    def rotation_rate(self) -> float:
        """The rate at which the axes turn [rad/s]."""
        return self.n * self.c

    @property
    def radial_gradient(self) -> float:
        """The gradient of gravity and centrifugal force along the radius [1/s²]."""
        return (5 * self.c**2 - 2) * self.n**2

    @property
    def cross_track_rate(self) -> float:
        """Rate of the oscillation through the plane [rad/s]."""
        return self.k_z

    def cross_track_motion(
        self,
        z: float | Float[Array, "*#k"],
        velocity: float | Float[Array, "*#k"],
        latitude: float,
        t: float | Float[Array, "*#k"],
    ) -> float | Float[Array, "*#k"]:
        """Free motion along the normal, with its slow growth [m].

            z(t) = z cos k_z t + (ż/k_z) sin k_z t − r sin i ΔΩ cos(θ + k_z t)

        where ΔΩ is what nodes part by until t. To first order in J2 and in z it is the
        motion of [Schweighart2002], whose l, q and φ follow from spherical triangles.

        Args:
            z: Along the normal at time 0 [m].
            velocity: The same, ż [m/s].
            latitude: θ, the chief's argument of latitude at time 0 [rad].
            t: Since then [s].
        """
        q, i = self.k_z, self.inclination
        inclined = z * sin(latitude) + velocity / q * cos(latitude)  # r Δi
        parted = self.n * self._j2_ratio * sin(i) ** 2 * inclined * t  # r sin i ΔΩ
        swing = z * np.cos(q * t) + velocity / q * np.sin(q * t)
        return np.asarray(swing - parted * np.cos(latitude + q * t))

    @property
    def _j2_ratio(self) -> float:
        return self.k_J2 / (self.mu * self.radius**2)
