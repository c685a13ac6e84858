"""Orbit of the chief under two-body gravity and J2, in polar-nodal elements [Xu2008].

The six polar-nodal elements are radius r, radial speed v_x, specific angular momentum h,
right ascension of the ascending node Ω (RAAN), inclination i and argument of latitude θ.
Unlike perigee and anomaly they are defined for circular orbits, and their rates for
equatorial orbits too.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import cos, hypot, isfinite, pi, sin, sqrt
from typing import Annotated, NamedTuple

import numpy as np
import scipy
from annotated_types import Ge, Le
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.bodies import EARTH_J2 as EARTH_J2
from dynamics.bodies import EARTH_MU as EARTH_MU
from dynamics.bodies import EARTH_RADIUS as EARTH_RADIUS
from dynamics.bodies import EARTH_ROTATION as EARTH_ROTATION
from dynamics.bodies import FROM_MU, BodyRadius, Mu, Oblateness, complete_gravity, find_body
from dynamics.bodies import oblateness as oblateness
from dynamics.doors import checked
from dynamics.inputs import InputError
from dynamics.quantities import within_turns
from dynamics.symbols import Number, Numbers
from dynamics.units import Angle, Length, Speed, Unit

K_J2 = oblateness(EARTH_J2, EARTH_MU, EARTH_RADIUS)  # of the Earth [m⁵/s²]

Turn = Annotated[float, Ge(-1e4), Le(1e4)]  # angle, whose sine is then exact to 1e-12 [rad]
# One number, vector or state, or many.
Scalars = Number | Numbers[Array, "*#k"]
Vectors = Numbers[Array, "*#k 3"]
OrbitStates = Numbers[Array, "*k 6"]  # polar-nodal elements, or positions and velocities

MAX_AXIS = 1e13  # beyond the orbit of Neptune [m]
MAX_TIME = 1e8  # three years; longer ones would be integrated for minutes [s]
SEGMENT_DURATION = 3600.0  # the orbit is integrated and cached in segments of this length [s]
RTOL = 1e-13  # of the integration, near the resolution of double precision


class LVLHRates(NamedTuple):
    """Angular velocity (ω_x, 0, ω_z) and acceleration (α_x, 0, α_z) of the LVLH axes."""

    omega_x: Scalars  # [rad/s]
    omega_z: Scalars
    alpha_x: Scalars  # [rad/s²]
    alpha_z: Scalars


@checked
@dataclass(frozen=True)
class Orbit:
    """Orbit about a planet or moon, by default the Earth, given by its state at time 0.

    Args:
        r: Radius [m].
        v_x: Radial speed [m/s].
        h: Specific angular momentum [m²/s].
        raan: Right ascension of the ascending node, Ω [rad].
        inclination: i, between 0 and π [rad].
        arg_latitude: Argument of latitude, θ, from the node [rad].
        mu: Gravitational parameter [m³/s²].
        k_J2: 3/2 J₂ μ R², the strength of the oblateness [m⁵/s²]; 0 is Keplerian motion. By
            default that of the Earth, Venus, Mars, Mercury or the Moon, whichever has this mu.
        body_radius: Radius at the equator [m], by default that of the same; 0 if not known.

    Raises:
        ValueError: The state is not on an ellipse, the perigee is inside the body, or mu is of
            no known body and there is no k_J2.
    """

    r: Length
    v_x: Speed
    h: Annotated[float, Unit("m2_s")]
    raan: Turn
    inclination: Angle
    arg_latitude: Turn
    mu: Mu = EARTH_MU
    k_J2: Oblateness = FROM_MU
    body_radius: BodyRadius = FROM_MU

    def __post_init__(self) -> None:
        """Complete the gravity, and check that the state is on an ellipse above the surface."""
        complete_gravity(self)
        elements, is_positive = self.initial_elements, self.r > 0 and self.h > 0
        if not is_positive or not all(map(isfinite, elements)):
            needed = "six finite elements, and a positive radius and angular momentum"
            raise ValueError(f"an orbit needs {needed}, got {tuple(map(float, elements))}")
        validate_inclination(self.inclination)
        validate_ellipse(self.semi_major_axis, self.eccentricity, self.mu, self.body_radius)

    @classmethod
    def from_elements(
        cls,
        semi_major_axis: Length,
        eccentricity: float = 0.0,
        inclination: Angle = 0.0,
        raan: Angle = 0.0,
        arg_perigee: Angle = 0.0,
        true_anomaly: Angle = 0.0,
        mu: Mu = EARTH_MU,
        k_J2: Oblateness = FROM_MU,
        body_radius: BodyRadius = FROM_MU,
    ) -> "Orbit":
        """Create an orbit from osculating classical elements at time 0.

        Args:
            semi_major_axis: [m].
            eccentricity: Eccentricity, from 0 to below 1.
            inclination: Between 0 and π [rad].
            raan: Right ascension of the ascending node [rad].
            arg_perigee: Argument of perigee [rad].
            true_anomaly: True anomaly at time 0 [rad].
            mu: Gravitational parameter [m³/s²].
            k_J2: Strength of the oblateness [m⁵/s²], by default that of the body with this mu.
            body_radius: Radius at the equator [m], by default that of the body with this mu.

        Raises:
            ValueError: This is not an ellipse, the perigee is inside the body, or mu is of no
                known body and there is no k_J2.
        """
        within_turns(inclination, "inclination")
        within_turns(raan, "raan")
        within_turns(arg_perigee, "arg_perigee")
        within_turns(true_anomaly, "true_anomaly")
        validate_ellipse(semi_major_axis, eccentricity, mu)
        p = semi_major_axis * (1 - eccentricity**2)
        r, h = p / (1 + eccentricity * cos(true_anomaly)), sqrt(mu * p)
        v_x = mu / h * eccentricity * sin(true_anomaly)
        latitude = arg_perigee + true_anomaly
        return cls(r, v_x, h, raan, inclination, latitude, mu, k_J2, body_radius)

    @property
    def initial_elements(self) -> tuple[float, ...]:
        """Polar-nodal elements at time 0, r [m], v_x [m/s], h [m²/s], Ω, i and θ [rad]."""
        return self.r, self.v_x, self.h, self.raan, self.inclination, self.arg_latitude

    @property
    def semi_major_axis(self) -> float:
        """Osculating semi-major axis at time 0 [m]."""
        return 1 / (2 / self.r - (self.v_x**2 + (self.h / self.r) ** 2) / self.mu)

    @property
    def eccentricity(self) -> float:
        """Osculating eccentricity at time 0."""
        # The length of the eccentricity vector is exact near e = 0, where 1 − h²/(μa) is not.
        return hypot(self.h**2 / (self.mu * self.r) - 1, self.h * self.v_x / self.mu)

    @property
    def mean_motion(self) -> float:
        """Osculating mean motion at time 0 [rad/s]."""
        return sqrt(self.mu / self.semi_major_axis**3)

    @property
    def period(self) -> float:
        """Keplerian period of the osculating ellipse at time 0 [s]."""
        return 2 * pi / self.mean_motion

    def elements_at(self, t: Scalars) -> OrbitStates:
        """Return the polar-nodal elements at one time or at many.

        Args:
            t: Times, not negative; numbers or symbols [s].

        Raises:
            ValueError: A time is negative or not finite.
        """
        if (times := np.asarray(t)).dtype == object:
            from dynamics.symbolic_orbit import symbolic_elements

            return symbolic_elements(self, times)
        times = np.asarray(t, dtype=float)
        is_known = (times >= 0) & (times <= MAX_TIME)
        if not is_known.all():
            known = f"the chief's orbit is known from time 0 on, to {MAX_TIME:.0e} s"
            raise InputError("t", f"{known}, got {times[~is_known].flat[0]} s")
        elements = np.empty((*times.shape, 6))
        segment = (times // SEGMENT_DURATION).astype(int)
        for j in range(int(segment.max(initial=0))):
            _integrate_segment(self, j)  # in order, so that none recurses through all before it
        for j in np.unique(segment):
            elements[segment == j] = _integrate_segment(self, int(j)).at(times[segment == j])
        return elements


def validate_ellipse(
    semi_major_axis: float, eccentricity: float, mu: float, body_radius: float = 0.0
) -> None:
    """Check that an orbit is closed, and stays above the surface of the body."""
    if not 0 <= eccentricity < 1:
        wanted = "an ellipse needs 0 ≤ e < 1"
        raise ValueError(f"eccentricity: {wanted}, got {eccentricity:.6g}; a circle has e = 0")
    if not 0 < semi_major_axis <= MAX_AXIS:
        wanted = f"must be positive and at most {MAX_AXIS:.0e} m"
        raise ValueError(f"semi_major_axis: {wanted}, got {semi_major_axis} m")
    if (perigee := semi_major_axis * (1 - eccentricity)) <= body_radius:
        least = body_radius / (1 - eccentricity)
        body = f"{find_body(mu).name}, whose radius is {body_radius / 1e3:.0f} km"
        cure = f"a semi-major axis above {least / 1e3:.0f} km would do"
        if least > MAX_AXIS:  # nearly a fall, as of a speed that was given for h
            cure = "another would do; of a circle h is √(μ r)"
        found = f"the perigee, {perigee / 1e3:.0f} km from the center, is inside {body}"
        raise ValueError(f"{found}; with an eccentricity of {eccentricity:g} {cure}")


def validate_inclination(inclination: float) -> None:
    """Check that an inclination is in radians between 0 and π."""
    if not 0 <= inclination <= pi:
        reason = f"must lie between 0 and π, got {inclination:.6g} rad; angles are in radians"
        meant = f"{inclination:.6g}° would be {np.radians(inclination):.6g}"
        raise ValueError(f"inclination: {reason}, and {meant}")


def polar_nodal_rates(chief: OrbitStates, mu: float, k_J2: float) -> OrbitStates:
    """Return the rates of change of polar-nodal elements [Xu2008]."""
    r, v_x, h, _, i, theta = np.moveaxis(chief, -1, 0)
    sin_i, cos_i, sin_t = np.sin(i), np.cos(i), np.sin(theta)
    rates = (
        v_x,
        -mu / r**2 + h**2 / r**3 - k_J2 / r**4 * (1 - 3 * (sin_i * sin_t) ** 2),
        -k_J2 / r**3 * sin_i**2 * np.sin(2 * theta),
        -2 * k_J2 * cos_i * sin_t**2 / (h * r**3),
        -k_J2 * np.sin(2 * i) * np.sin(2 * theta) / (2 * h * r**3),
        h / r**2 + 2 * k_J2 * cos_i**2 * sin_t**2 / (h * r**3),
    )
    return np.stack(rates, axis=-1)


def lvlh_rates(chief: OrbitStates, k_J2: float) -> LVLHRates:
    """Return the angular velocity and acceleration of the chief's LVLH axes [Xu2008]."""
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
    """Return the order of magnitude of each polar-nodal element, for tolerances."""
    r, _, h, *_ = chief
    return np.array([r, h / r, h, 1.0, 1.0, 1.0])


class _Segment(NamedTuple):
    """Elements over a segment of time: the dense output of DOP853, of all its steps together."""

    ends: Float[Array, " steps+1"]  # of the steps [s]
    start: Float[Array, "steps 6"]  # elements
    terms: Float[Array, "steps 7 6"]
    last: Float[Array, " 6"]  # elements at the end

    def at(self, times: Float[Array, " k"]) -> OrbitStates:
        """Evaluate the elements at many times, as the solution of SciPy does one after another."""
        k = np.searchsorted(self.ends, times).clip(1, len(self.start)) - 1
        x = ((times - self.ends[k]) / np.diff(self.ends)[k])[:, None]
        y = np.zeros((len(times), 6))
        for i, term in enumerate(np.moveaxis(self.terms[k], 1, 0)[::-1]):
            y = (y + term) * (1 - x if i % 2 else x)
        return np.asarray(y + self.start[k])


@lru_cache(maxsize=4096)
def _integrate_segment(orbit: Orbit, j: int) -> _Segment:
    y = _integrate_segment(orbit, j - 1).last if j > 0 else np.array(orbit.initial_elements)
    span, atol = (j * SEGMENT_DURATION, (j + 1) * SEGMENT_DURATION), RTOL * polar_nodal_scales(y)

    def rate(t: float, y: Array) -> Array:
        return polar_nodal_rates(y, orbit.mu, orbit.k_J2)

    found = scipy.integrate.solve_ivp(
        rate, span, y, "DOP853", dense_output=True, rtol=RTOL, atol=atol
    )
    steps = found.sol.interpolants
    start, terms = (np.array([getattr(step, name) for step in steps]) for name in ("y_old", "F"))
    return _Segment(found.sol.ts, start, terms, found.y[:, -1])
