"""The chief's orbit: an osculating state, and how it moves under two bodies and J2 [Xu2008].

The chief is held as six numbers: radius r, radial speed v_x, angular momentum h (all per
unit of mass), node Ω, inclination i and argument of latitude θ. Unlike perigee and anomaly
they are defined for circular orbits, and their rates for equatorial ones too.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import cos, hypot, inf, isfinite, pi, sin, sqrt
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.integrate import solve_ivp

# All of the Earth's constants are of [IERS2010, table 1.1].
EARTH_MU = 3.986004418e14  # gravitational parameter [m³/s²]
EARTH_RADIUS = 6378136.6  # at the equator [m]
EARTH_J2 = 1.0826359e-3  # dynamical form factor
EARTH_ROTATION = 7.292115e-5  # [rad/s]
K_J2 = 1.5 * EARTH_J2 * EARTH_MU * EARTH_RADIUS**2  # as the equations use J2 [m⁵/s²]

SEGMENT_DURATION = 3600.0  # pieces in which the orbit is integrated and kept [s]
RTOL = 1e-13  # of the integration: about what doubles can hold


class LVLHRates(NamedTuple):
    """How the chief's frame turns: ω = (ω_x, 0, ω_z), α = (α_x, 0, α_z)."""

    omega_x: Float[Array, "*k"] | float  # [rad/s]
    omega_z: Float[Array, "*k"] | float
    alpha_x: Float[Array, "*k"] | float  # [rad/s²]
    alpha_z: Float[Array, "*k"] | float


@dataclass(frozen=True)
class Orbit:
    """An orbit of the Earth, by its osculating state at time 0. Angles in radians.

    Args:
        r: Radius [m].
        v_x: Radial speed [m/s].
        h: Angular momentum [m²/s].
        node: Right ascension of the ascending node, Ω.
        inclination: i, between 0 and π.
        latitude: Argument of latitude, θ, from the node.
        mu: Gravitational parameter [m³/s²].
        k_J2: 3/2 J₂ μ R², the strength of the oblateness [m⁵/s²]; 0 is Kepler's motion.

    Raises:
        ValueError: This is no ellipse, or it meets the Earth.
    """

    r: float
    v_x: float
    h: float
    raan: float
    inclination: float
    arg_latitude: float
    mu: float = EARTH_MU
    k_J2: float = K_J2

    def __post_init__(self) -> None:
        """Refuse what no spacecraft could fly."""
        if not all(map(isfinite, self.initial_elements)) or not (
            self.r > 0 and self.h > 0 and self.mu > 0
        ):
            raise ValueError(
                "an orbit needs six finite numbers, and a positive radius and angular momentum, "
                f"got {tuple(map(float, self.initial_elements))}"
            )
        if not 0 <= self.inclination <= pi:
            raise ValueError(
                f"an inclination lies between 0 and 180 degrees, got {np.degrees(self.inclination)}"
            )
        if self.eccentricity >= 1:
            raise ValueError(
                f"an orbit with eccentricity {self.eccentricity:.4g} never comes back; "
                "relative motion here is about an ellipse, with 0 ≤ e < 1"
            )
        if (perigee := self.semi_major_axis * (1 - self.eccentricity)) <= EARTH_RADIUS:
            least = EARTH_RADIUS / (1 - self.eccentricity)
            raise ValueError(
                f"the perigee, {perigee / 1e3:.0f} km from the centre, is inside the Earth, whose "
                f"radius is {EARTH_RADIUS / 1e3:.0f} km; with this eccentricity a semi-major axis "
                f"above {least / 1e3:.0f} km would do"
            )

    @classmethod
    def from_elements(
        cls,
        semi_major_axis: float,
        eccentricity: float = 0.0,
        inclination: float = 0.0,
        raan: float = 0.0,
        arg_perigee: float = 0.0,
        true_anomaly: float = 0.0,
        mu: float = EARTH_MU,
        k_J2: float = K_J2,
    ) -> "Orbit":
        """An orbit by its osculating classical elements.

        Args:
            semi_major_axis: [m].
            eccentricity: Between 0 and 1.
            inclination: [rad].
            node: Right ascension of the ascending node [rad].
            perigee: Argument of perigee [rad].
            anomaly: True anomaly at time 0 [rad].
            mu: Gravitational parameter [m³/s²].
            k_J2: Strength of the oblateness [m⁵/s²].

        Raises:
            ValueError: This is no ellipse, or it meets the Earth.
        """
        if not 0 <= eccentricity < 1 or not 0 < semi_major_axis < inf:
            raise ValueError(
                "an ellipse has 0 ≤ eccentricity < 1 and a positive semi-major axis, got "
                f"eccentricity = {eccentricity} and {semi_major_axis} m"
            )
        p = semi_major_axis * (1 - eccentricity**2)
        h = sqrt(mu * p)
        return cls(
            r=p / (1 + eccentricity * cos(true_anomaly)),
            v_x=mu / h * eccentricity * sin(true_anomaly),
            h=h,
            raan=raan,
            inclination=inclination,
            arg_latitude=arg_perigee + true_anomaly,
            mu=mu,
            k_J2=k_J2,
        )

    @property
    def initial_elements(self) -> tuple[float, ...]:
        """The six numbers at time 0."""
        return self.r, self.v_x, self.h, self.raan, self.inclination, self.arg_latitude

    @property
    def semi_major_axis(self) -> float:
        """Osculating at time 0 [m]."""
        return 1 / (2 / self.r - (self.v_x**2 + (self.h / self.r) ** 2) / self.mu)

    @property
    def eccentricity(self) -> float:
        """Osculating at time 0."""
        # As a vector towards the perigee, which is exact near e = 0 where 1 − h²/(μa) is not.
        return hypot(self.h**2 / (self.mu * self.r) - 1, self.h * self.v_x / self.mu)

    @property
    def mean_motion(self) -> float:
        """Osculating at time 0 [rad/s]."""
        return sqrt(self.mu / self.semi_major_axis**3)

    @property
    def period(self) -> float:
        """Of Kepler's motion from time 0 on [s]."""
        return 2 * pi / self.mean_motion

    def elements_at(self, t: float | Float[Array, "*k"]) -> Float[Array, "*k 6"]:
        """The six numbers at a time, or at many.

        Args:
            t: Since time 0 [s]; not negative.

        Raises:
            ValueError: A time is negative or not finite.
        """
        times = np.asarray(t, dtype=float)
        if not (np.isfinite(times).all() and (times >= 0).all()):
            raise ValueError(f"the chief's orbit is known from time 0 on, got t = {times.min()} s")
        found = np.empty((*times.shape, 6))
        piece = (times // SEGMENT_DURATION).astype(int)
        for j in range(int(piece.max(initial=0))):
            _integrate_segment(self, j)  # each begins where the one before ends
        for j in np.unique(piece):
            found[piece == j] = _integrate_segment(self, int(j)).sol(times[piece == j]).T
        return found


def polar_nodal_rates(chief: Float[Array, "*k 6"], mu: float, k_J2: float) -> Float[Array, "*k 6"]:
    """Rates of the six numbers [Xu2008]."""
    r, v_x, h, _, i, theta = np.moveaxis(chief, -1, 0)
    sin_i, cos_i, sin_t = np.sin(i), np.cos(i), np.sin(theta)
    return np.stack(
        [
            v_x,
            -mu / r**2 + h**2 / r**3 - k_J2 / r**4 * (1 - 3 * (sin_i * sin_t) ** 2),
            -k_J2 / r**3 * sin_i**2 * np.sin(2 * theta),
            -2 * k_J2 * cos_i * sin_t**2 / (h * r**3),
            -k_J2 * np.sin(2 * i) * np.sin(2 * theta) / (2 * h * r**3),
            h / r**2 + 2 * k_J2 * cos_i**2 * sin_t**2 / (h * r**3),
        ],
        axis=-1,
    )


def lvlh_rates(chief: Float[Array, "*k 6"], k_J2: float) -> LVLHRates:
    """How the frame of the chief's osculating orbit turns, and how that changes [Xu2008]."""
    r, v_x, h, _, i, theta = np.moveaxis(chief, -1, 0)
    sin_2i, sin_t, cos_t = np.sin(2 * i), np.sin(theta), np.cos(theta)
    return LVLHRates(
        omega_x=-k_J2 * sin_2i * sin_t / (h * r**3),
        omega_z=h / r**2,
        alpha_x=(
            -k_J2 * sin_2i * cos_t / r**5
            + 3 * v_x * k_J2 * sin_2i * sin_t / (r**4 * h)
            - 8 * k_J2**2 * np.sin(i) ** 3 * np.cos(i) * sin_t**2 * cos_t / (r**6 * h**2)
        ),
        alpha_z=-2 * h * v_x / r**3 - k_J2 * np.sin(i) ** 2 * np.sin(2 * theta) / r**5,
    )


def polar_nodal_scales(chief: Float[Array, " 6"]) -> Float[Array, " 6"]:
    """How large each of the six numbers is about, also where it happens to be 0."""
    r, _, h, *_ = chief
    return np.array([r, h / r, h, 1.0, 1.0, 1.0])


@lru_cache(maxsize=4096)
def _integrate_segment(orbit: Orbit, j: int) -> Any:
    start = (
        np.array(orbit.initial_elements) if j == 0 else _integrate_segment(orbit, j - 1).y[:, -1]
    )
    return solve_ivp(
        lambda t, y: polar_nodal_rates(y, orbit.mu, orbit.k_J2),
        (j * SEGMENT_DURATION, (j + 1) * SEGMENT_DURATION),
        start,
        method="DOP853",
        rtol=RTOL,
        atol=RTOL * polar_nodal_scales(start),
        dense_output=True,
    )
