"""Schweighart–Sedwick equations: relative motion under the mean of J2 [Schweighart2002]."""

from dataclasses import dataclass
from math import cos, inf, sin, sqrt

from dynamics.circular_orbit import CircularOrbitModel
from dynamics.orbit import EARTH_MU, EARTH_RADIUS, K_J2, Orbit, validate_inclination


@dataclass(frozen=True)
class SchweighartSedwick(CircularOrbitModel):
    """Clohessy–Wiltshire equations with the J2 gradient averaged over the orbit.

        ẍ =  2ncẏ + (5c² − 2)n²x + u_x
        ÿ = −2ncẋ                + u_y
        z̈ = −k_z²z               + u_z

        s = k_J2 (1 + 3 cos 2i) / (4μr²),  c = √(1 + s),  k_z = nc + n k_J2 cos²i / (μr²)

    The LVLH axes turn at the mean rate nc; k_z is the mean rate of the chief's argument of
    latitude, which the drift of the node is part of.

    Valid while the separation is small against the radius of a nearly circular orbit, and,
    in cross-track, between orbits of one inclination. Nodes of orbits of different
    inclination drift apart, and the amplitude of z grows slowly: [Schweighart2002] has a
    term 2lq cos(qt + φ) in z̈, which depends on the chief's latitude and is left out here.
    """

    radius: float  # of the chief's orbit [m]
    inclination: float  # of the chief's orbit [rad]
    mu: float = EARTH_MU  # gravitational parameter [m³/s²]
    k_J2: float = K_J2  # 3/2 J₂ μ R² [m⁵/s²]; 0 gives Clohessy–Wiltshire

    def __post_init__(self) -> None:
        """Check the orbit, and that J2 is a small perturbation."""
        if not EARTH_RADIUS < self.radius < inf:
            raise ValueError(
                f"radius: must be above the Earth's, {EARTH_RADIUS / 1e3:.0f} km, measured from "
                f"the center and in meters, got {self.radius} m"
            )
        validate_inclination(self.inclination)
        if not 0 < self.mu < inf:
            raise ValueError(f"mu: must be positive and finite, got {self.mu} m³/s²")
        if not abs(self.k_J2) < 0.1 * self.mu * self.radius**2:
            raise ValueError(
                f"k_J2: must be a small part of gravity, got {self.k_J2} m⁵/s², which is "
                f"{self.k_J2 / (self.mu * self.radius**2):.3g} of it; the Earth's is {K_J2:.4g}"
            )

    @classmethod
    def from_orbit(cls, orbit: Orbit) -> "SchweighartSedwick":
        """Take the circle with the orbit's energy under the averaged J2.

        Its rates are the orbit's mean rates to about 1e-5 where the eccentricity is of the
        order of J2. With the osculating semi-major axis, which J2 moves by kilometers in
        each orbit, they would be wrong by up to 3e-3; in cross-track that is 20 m an orbit
        for each km. In the plane both are equally good, since the periodic terms that the
        average omits dominate there.
        """
        mu, k = orbit.mu, orbit.k_J2
        first = cls(orbit.semi_major_axis, orbit.inclination, mu, k)
        Z2 = (sin(orbit.inclination) * sin(orbit.arg_latitude)) ** 2
        energy = -mu / (2 * orbit.semi_major_axis) - k / orbit.r**3 * (1 / 3 - Z2)
        # A circle at the rate nc has −μ/2r + μs/6r; the first estimate of s is good enough.
        return cls(-mu / (2 * energy) * (1 - first.s / 3), orbit.inclination, mu, k)

    @property
    def n(self) -> float:
        """Mean motion of the circle without J2 [rad/s]."""
        return sqrt(self.mu / self.radius**3)

    @property
    def s(self) -> float:
        """Strength of J2 averaged over the orbit."""
        return self._j2_ratio * (1 + 3 * cos(2 * self.inclination)) / 4

    @property
    def c(self) -> float:
        """Ratio of the rotation rate of the axes to n."""
        return sqrt(1 + self.s)

    @property
    def rotation_rate(self) -> float:
        """a: rate of rotation of the LVLH axes [rad/s]."""
        return self.n * self.c

    @property
    def radial_gradient(self) -> float:
        """b: gravity gradient and centrifugal term along the radius [1/s²]."""
        return (5 * self.c**2 - 2) * self.n**2

    @property
    def cross_track_rate(self) -> float:
        """k_z: rate of the cross-track oscillation and of the argument of latitude [rad/s]."""
        return self.n * (self.c + self._j2_ratio * cos(self.inclination) ** 2)

    @property
    def _j2_ratio(self) -> float:
        return self.k_J2 / (self.mu * self.radius**2)
