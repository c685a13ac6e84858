"""Bodies that orbits go about: gravity, radius and oblateness, found by the gravity.

A value that a caller leaves out is that of the body whose gravitational parameter is given.
"""

from typing import Annotated, Any, NamedTuple

from annotated_types import Ge, Gt, Le

from dynamics.errors import InputError
from dynamics.units import Length, Unit

# The constants of the Earth are those of [IERS2010, table 1.1].
EARTH_MU = 3.986004418e14  # gravitational parameter [m³/s²]
EARTH_RADIUS = 6378136.6  # at the equator [m]
EARTH_J2 = 1.0826359e-3  # dynamical form factor
EARTH_ROTATION = 7.292115e-5  # [rad/s]
Mu = Annotated[float, Unit("m3_s2"), Gt(0)]
Oblateness = Annotated[float, Unit("m5_s2"), Le(1e40)]
BodyRadius = Annotated[Length, Ge(0)]  # 0 where it is not known
FROM_MU: Any = None  # default of what follows from mu
LEAST_J2 = 1e-9  # of a body, other than 0
SAME_BODY = 1e-3  # relative difference of two gravitational parameters of one body, at most


class Body(NamedTuple):
    """Planet or moon."""

    name: str
    mu: float  # gravitational parameter [m³/s²]
    radius: float  # at the equator [m]
    J2: float  # dynamical form factor


EARTH = Body("the Earth", EARTH_MU, EARTH_RADIUS, EARTH_J2)
UNKNOWN = Body("the central body", 0.0, 0.0, 0.0)
BODIES = (
    EARTH,
    # NASA's planetary fact sheets, https://nssdc.gsfc.nasa.gov/planetary/factsheet/
    Body("the Moon", 4.9028e12, 1738.1e3, 2.027e-4),
    Body("Mars", 4.282837e13, 3396.2e3, 1.96045e-3),
    Body("Venus", 3.24859e14, 6051.8e3, 4.458e-6),
    Body("Mercury", 2.2032e13, 2440.5e3, 5.03e-5),
)
NO_BODY = "is missing, and mu = {:.6g} m³/s² is of no known body; 0 is Keplerian motion"


def find_body(mu: float) -> Body:
    """Find the body with a gravitational parameter [m³/s²]; `UNKNOWN` where there is none."""
    return next((body for body in BODIES if abs(mu - body.mu) <= SAME_BODY * body.mu), UNKNOWN)


def oblateness(J2: float, mu: float, radius: float) -> float:
    """Compute k_J2 = 3/2 J₂ μ R² [m⁵/s²] from J₂, μ [m³/s²] and the radius [m]."""
    return 1.5 * J2 * mu * radius**2


def complete_gravity(value: Any) -> None:
    """Set k_J2 and body_radius of a frozen value to those of the body with its mu, if not given.

    A radius of 0 is not known: nothing hits the surface. A mu of no known body needs k_J2.
    """
    mu, k, radius = value.mu, value.k_J2, value.body_radius
    body = find_body(mu)
    radius = body.radius if radius is None else radius
    if k is None and body is UNKNOWN:
        raise InputError("k_J2", NO_BODY.format(mu))
    k = oblateness(body.J2, mu, radius or body.radius) if k is None else k
    if radius and body.radius and not 0.1 < radius / body.radius < 10:
        reason = f"{radius:.6g} m is far from that of {body.name}, {body.radius:.6g} m"
        raise InputError("body_radius", f"{reason}; without it that would be taken")
    if 0 < abs(k) < LEAST_J2 * oblateness(1.0, mu, radius or body.radius):
        reason = f"{k:.6g} m⁵/s² is of a body rounder than any; it is 3/2 J2 mu R²"
        raise InputError("k_J2", f"{reason}, {oblateness(body.J2, mu, body.radius):.6g} by the mu")
    if k == oblateness(EARTH_J2, EARTH_MU, EARTH_RADIUS) and body not in (EARTH, UNKNOWN):
        raise InputError("k_J2", f"{k:.6g} m⁵/s² is the Earth's, and mu is that of {body.name}")
    object.__setattr__(value, "k_J2", k)
    object.__setattr__(value, "body_radius", radius)
