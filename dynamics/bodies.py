"""Bodies that orbits go about: gravity, radius and oblateness, found by the gravity.

A value that a caller leaves out is that of the body whose gravitational parameter is given.
"""

from math import inf, isfinite
from typing import Any, NamedTuple

from dynamics.inputs import join_names

# The constants of the Earth are those of [IERS2010, table 1.1].
EARTH_MU = 3.986004418e14  # gravitational parameter [m³/s²]
EARTH_RADIUS = 6378136.6  # at the equator [m]
EARTH_J2 = 1.0826359e-3  # dynamical form factor
EARTH_ROTATION = 7.292115e-5  # [rad/s]
FROM_MU: Any = None  # default of what follows from the gravitational parameter
SAME_BODY = 1e-3  # relative difference of two gravitational parameters of one body, at most


class Body(NamedTuple):
    """Planet or moon."""

    name: str
    mu: float  # gravitational parameter [m³/s²]
    radius: float  # at the equator [m]
    J2: float  # dynamical form factor

    @property
    def key(self) -> str:
        """Name without its article, in lower case: "earth"."""
        return self.name.removeprefix("the ").lower()


BODIES = (
    Body("the Earth", EARTH_MU, EARTH_RADIUS, EARTH_J2),
    # NASA's planetary fact sheets, https://nssdc.gsfc.nasa.gov/planetary/factsheet/
    Body("the Moon", 4.9028e12, 1738.1e3, 2.027e-4),
    Body("Mars", 4.282837e13, 3396.2e3, 1.96045e-3),
    Body("Venus", 3.24859e14, 6051.8e3, 4.458e-6),
    Body("Mercury", 2.2032e13, 2440.5e3, 5.03e-5),
)
UNKNOWN = Body("the central body", 0.0, 0.0, 0.0)


def find_body(mu: float) -> Body:
    """Find the body with a gravitational parameter [m³/s²]; `UNKNOWN` where there is none."""
    near = (body for body in BODIES if abs(mu - body.mu) <= SAME_BODY * body.mu)
    return next(near, UNKNOWN)


def is_earth(mu: float) -> bool:
    """Tell whether a gravitational parameter [m³/s²] is that of the Earth."""
    return find_body(mu) is BODIES[0]


def oblateness(J2: float, mu: float, radius: float) -> float:
    """Compute k_J2 = 3/2 J₂ μ R², the strength of the oblateness [m⁵/s²].

    Args:
        J2: Dynamical form factor.
        mu: Gravitational parameter [m³/s²].
        radius: Radius R at the equator [m].
    """
    return 1.5 * J2 * mu * radius**2


def complete_gravity(
    mu: float, k_J2: float | None, body_radius: float | None
) -> tuple[float, float]:
    """Return k_J2 [m⁵/s²] and the radius [m], those of the body with this gravity if not given.

    Args:
        mu: Gravitational parameter [m³/s²].
        k_J2: Strength of the oblateness [m⁵/s²].
        body_radius: Radius at the equator [m]; 0 where it is not known.

    Raises:
        ValueError: A value is out of its range, or no body has this gravity and k_J2 is not given.
    """
    if not 0 < mu < inf:
        raise ValueError(f"mu: must be positive and finite, got {mu} m³/s²")
    body = find_body(mu)
    radius = body.radius if body_radius is None else body_radius
    if k_J2 is None and body is UNKNOWN:
        known = join_names([f"{each.name} ({each.mu:.6g})" for each in BODIES], "or")
        raise ValueError(
            f"k_J2: is missing, and mu = {mu:.6g} m³/s² is not that of {known}; 0 is Keplerian "
            "motion, else 1.5 * J2 * mu * radius**2"
        )
    k = oblateness(body.J2, mu, body.radius) if k_J2 is None else k_J2
    if not (isfinite(k) and 0 <= radius < inf):
        raise ValueError(
            "k_J2 must be a small part of gravity, and body_radius finite and not negative, got "
            f"{k} m⁵/s² and {radius} m"
        )
    return k, radius
