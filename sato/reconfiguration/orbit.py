"""The chief: the orbit about which a swarm moves, as a definition."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from functools import cached_property, partial
from math import degrees, pi
from typing import Annotated, Any

import numpy as np
from annotated_types import Le, Lt
from jaxtyping import Float
from numpy import ndarray as Array
from pydantic import AfterValidator, BeforeValidator

from dynamics.bodies import EARTH, EARTH_J2, EARTH_MU, NO_BODY, UNKNOWN, Body, find_body, oblateness
from dynamics.coordinate_frames import to_polar_nodal
from dynamics.j2 import invariant_velocity
from dynamics.orbit import Orbit
from dynamics.quantities import within_turns
from dynamics.units import Unit
from sato.scenario.definition import (
    LATER,
    TURNS,
    Coordinates,
    Definition,
    NotNegative,
    Positive,
    errors_in,
)
from sato.scenario.errors import InputError, join_names, round_down, round_up

YEARS = 1, 9998  # of an epoch: exports write years of four digits, a flight later too
MAX_J2 = 0.05  # about where J2 would no longer be a small part of gravity; the Earth's is 0.001
MIN_COS_LATITUDE = 0.3  # |cos θ| from which on velocities out of the plane are not large
ANOMALIES = range(-180, 180, 5)  # tried for a better start along the orbit [deg]
SUM_OF_TURNS = AfterValidator(partial(within_turns, turns=4.0))  # mark of perigee and anomaly
ELEMENTS = "semi_major_axis", "eccentricity", "inclination", "node", "perigee", "anomaly"
POLAR_NODAL = "radius", "radial_speed", "angular_momentum", "node", "inclination", "latitude"
# Ways to give an orbit, by the key that each needs, and the fields of that way alone.
WAYS = {
    "semi_major_axis_m": ("semi_major_axis", "eccentricity", "perigee", "anomaly"),
    "position_m": ("position", "velocity"),
    "radius_m": ("radius", "radial_speed", "angular_momentum", "latitude"),
}


def _as_utc(value: Any) -> Any:
    # A date is one in TOML, with quotes and without.
    try:
        value = value.isoformat() if isinstance(value, date) else value
        time = datetime.fromisoformat(value)
        if time.tzinfo is not None:
            time = time.astimezone(UTC).replace(tzinfo=None)
    except (TypeError, ValueError, OverflowError) as error:
        reason = 'must be a date and time in UTC; "2026-01-01T00:00:00" would do, no leap second'
        raise InputError("", reason) from error
    if not YEARS[0] <= time.year <= YEARS[1]:
        raise InputError("", f"must be in the years {YEARS[0]} to {YEARS[1]}, got {time.year}")
    if re.search(r"[.,]\d{6}\d*[1-9]", value):
        raise InputError("", f"must be of whole microseconds, got {value}")
    return time.isoformat()


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class Chief(Definition):
    """Orbit of the chief, osculating at time 0.

    By its classical elements, those that are not given being 0; by its inertial position and
    velocity; or by its polar-nodal elements, as run files have them.
    """

    semi_major_axis: Annotated[float | None, Unit("m"), Positive, "semi-major axis"] = None
    eccentricity: Annotated[float | None, NotNegative, "eccentricity"] = None
    inclination: Annotated[float | None, Unit("rad"), "inclination"] = None
    node: Annotated[float | None, Unit("rad"), TURNS, "right ascension of the ascending node"] = (
        None
    )
    perigee: Annotated[float | None, Unit("rad"), TURNS, "argument of perigee"] = None
    anomaly: Annotated[float | None, Unit("rad"), TURNS, "true anomaly"] = None
    position: Annotated[Coordinates | None, Unit("m"), "inertial position"] = None
    velocity: Annotated[Coordinates | None, Unit("m_s"), "inertial velocity"] = None
    radius: Annotated[float | None, Unit("m"), "distance from the center of the body"] = None
    radial_speed: Annotated[float | None, Unit("m_s"), "radial speed"] = None
    angular_momentum: Annotated[float | None, Unit("m2_s"), "specific angular momentum"] = None
    latitude: Annotated[float | None, Unit("rad"), SUM_OF_TURNS, "argument of latitude"] = None
    mu: Annotated[
        float | None, Unit("m3_s2"), Positive, "gravity of the body; the Earth's if absent"
    ] = None
    body_radius: Annotated[
        float | None, Unit("m"), NotNegative, "its radius at the equator; by its mu if absent"
    ] = None
    j2: Annotated[
        float, NotNegative, Lt(MAX_J2), "oblateness J2; 0 is Kepler's motion; by mu if absent"
    ] = LATER
    k_j2: Annotated[float | None, Unit("m5_s2"), Le(1e40), "3/2 J2 mu R², in place of j2"] = None
    epoch: Annotated[str, BeforeValidator(_as_utc), "UTC of time 0"] = "2026-01-01T00:00:00"

    @classmethod
    def from_orbit(cls, orbit: Orbit) -> "Chief":
        """Return the chief on an orbit of the library, equal to the last bit."""
        mu, k, radius = orbit.mu, orbit.k_J2, orbit.body_radius
        values: dict[str, Any] = dict(zip(POLAR_NODAL, orbit.initial_elements, strict=True))
        exact = [j2 for j2 in (0.0, find_body(mu).J2) if oblateness(j2, mu, radius) == k]
        values |= {"j2": exact[0]} if exact else {"k_j2": k}
        return cls(**values, mu=mu, body_radius=radius)

    def completed(self) -> dict[str, Any]:
        """Return the oblateness of the body, and no constants that follow from its gravity.

        Raises:
            InputError: No known body has this gravity, or constants contradict each other.
        """
        body, (_, mu, radius, _) = find_body(self.mu or EARTH_MU), self.center
        j2 = body.J2 if self.j2 is None and self.k_j2 is None else self.j2
        if self.j2 is None and self.k_j2 is None and body is UNKNOWN:
            raise InputError("j2", NO_BODY.format(mu))
        if j2 is not None and self.k_j2 is not None:
            raise InputError("k_j2_m5_s2", "gives the oblateness, and so does j2; give one of them")
        if j2 and not radius:
            reason = f"is missing, and j2 = {j2:g} is relative to it; j2 = 0 or k_j2_m5_s2 would do"
            raise InputError("body_radius_m", reason)
        if j2 == EARTH_J2 and body not in (EARTH, UNKNOWN):
            reason = f"{j2:g} is the Earth's, and mu_m3_s2 that of {body.name}"
            raise InputError("j2", f"{reason}; {body.J2:g} would do")
        short = None if radius == body.radius else radius
        return {"mu": None if mu == EARTH_MU else mu, "body_radius": short, "j2": j2}

    @cached_property
    def orbit(self) -> Orbit:
        """Orbit of the library, with the gravity and oblateness of the body."""
        _, mu, radius, _ = self.center
        k_J2 = oblateness(self.j2, mu, radius) if self.k_j2 is None else self.k_j2
        gravity = mu, k_J2, radius
        if self.radius is not None:
            elements = [getattr(self, name) or 0.0 for name in POLAR_NODAL]
        elif self.position is not None and self.velocity is not None:
            elements = to_polar_nodal(np.array([*self.position, *self.velocity])).tolist()
        else:
            a, e, i, raan, perigee, anomaly = [getattr(self, name) or 0.0 for name in ELEMENTS]
            return Orbit.from_elements(a, e, i, raan, perigee, anomaly, *gravity)
        r, v_x, h, raan, i, latitude = elements
        return Orbit(r, v_x, h, raan, i, latitude, *gravity)

    @property
    def perigee_altitude(self) -> float:
        """Altitude of the perigee above the equatorial radius of the body [m]."""
        orbit = self.orbit
        return orbit.semi_major_axis * (1 - orbit.eccentricity) - orbit.body_radius

    @property
    def center(self) -> Body:
        """Body that the chief goes about, with the gravity and radius that are asked for."""
        found = find_body(self.mu or EARTH_MU)
        radius = found.radius if self.body_radius is None else self.body_radius
        return found._replace(mu=self.mu or EARTH_MU, radius=radius)

    def drift_free_velocities(
        self, position: Float[Array, "k d"], t: float, where: str, times: Sequence[float]
    ) -> Float[Array, "k d"]:
        """Return J2-invariant velocities [m/s], with which vehicles stay about where they are.

        They are the same for every model, so that runs with different models can be compared.

        Args:
            position: Positions at t [m].
            t: Time [s].
            where: Table that asks for them.
            times: Times at which a mission asks for velocities, to say what would do [s].

        Raises:
            InputError: They are out of the chief's plane where no velocity keeps them there, or
                farther from the chief than the center of the body.
        """
        away, most = np.abs(position).max(initial=0.0), self.orbit.elements_at(t)[0]
        if away > most:
            reason = f"lies {away / 1e3:.4g} km from the chief, which is {most / 1e3:.4g} km"
            raise InputError(where, f"{reason} from the center of {self.center.name}")
        try:
            return invariant_velocity(self.orbit, position, t)
        except ValueError as error:
            latitude = np.degrees(self.orbit.elements_at(t)[5]) % 360
            raise InputError(
                where,
                f"lies out of the plane of the chief's orbit, and {t:g} s after the start the "
                f"chief is at {latitude:.4g}° of argument of latitude, too near 90° or 270° for "
                f"any velocity to keep vehicles there; {self.suggest_start(times)}",
            ) from error

    def suggest_start(self, times: Sequence[float]) -> str:
        """Say from where along its orbit vehicles could stay out of its plane at these times.

        Args:
            times: Times [s].
        """
        flat = "positions in the plane (z = 0)"
        if self.semi_major_axis is None or not len(times):
            return f"another start along the orbit would do, or {flat}"

        def least_cosine(anomaly: float) -> float:
            moved = replace(self, anomaly=float(np.radians(anomaly))).orbit
            return float(np.abs(np.cos(moved.elements_at(np.array(times))[:, 5])).min())

        best = max(ANOMALIES, key=least_cosine)
        if least_cosine(best) < MIN_COS_LATITUDE:
            return f"shorter legs and another chief.anomaly_deg would do, or {flat}"
        return f"chief.anomaly_deg = {best} would do, or {flat}"

    def check(self) -> None:
        """Refuse no orbit, two, or one that meets the body."""
        given = [
            key
            for key, names in WAYS.items()
            if any(getattr(self, name) is not None for name in names)
        ]
        way = given[0] if given else "semi_major_axis_m"
        if len(given) > 1 or (way == "position_m" and (self.inclination or self.node)):
            raise InputError(
                way,
                f"gives the orbit, and so does {given[-1]}; give classical elements, or "
                "position_m and velocity_m_s, or polar-nodal elements, one of the three",
            )
        needed = {way: getattr(self, WAYS[way][0])}
        if way == "position_m":
            needed["velocity_m_s"] = self.velocity
        for key, value in needed.items():
            if value is None:
                raise InputError(
                    key,
                    "is missing; an orbit is given by semi_major_axis_km = 6878, say, and the "
                    "other elements that are not 0, or by position_m and velocity_m_s",
                )
        if self.semi_major_axis is not None:
            self._check_elements(self.semi_major_axis)
        elif way == "position_m":
            self._check_state(needed["position_m"], needed["velocity_m_s"])
        else:
            with errors_in("radius_m"):
                _ = self.orbit

    def _check_elements(self, a: float) -> None:
        e, i = self.eccentricity or 0.0, self.inclination or 0.0
        body, _, radius, _ = self.center
        rounder = f"eccentricity = {round_down(1 - radius / a)}" if a > radius > 0 else ""
        if e >= 1:
            cure = rounder or "less than 1, in a wider orbit,"
            raise InputError("eccentricity", f"{e:g} is no ellipse; {cure} would do")
        if a * (1 - e) <= radius:
            cures = [f"semi_major_axis_km = {round_up(radius / (1 - e) / 1e3)}"]
            key = "semi_major_axis_m"
            if e > 0 and rounder:
                key, cures = "eccentricity", [rounder, *cures]
            raise InputError(
                key,
                f"puts the perigee {a * (1 - e) / 1e3:.6g} km from {body}'s center, inside {body}, "
                f"whose radius is {radius / 1e3:.0f} km; {join_names(cures)} would do",
            )
        if not 0 <= i <= pi:
            message = f"must be between 0 and 180 degrees, got {degrees(i):.6g}"
            if i > pi:
                message += f", or {i:.6g} rad; {i:.6g} degrees are np.radians({i:.6g})"
            raise InputError("inclination_rad", message)

    def _check_state(self, position: Sequence[float], velocity: Sequence[float]) -> None:
        for name, value in (("position_m", position), ("velocity_m_s", velocity)):
            if len(value) != 3:
                raise InputError(name, f"needs 3 coordinates, got {len(value)}")
        r = float(np.linalg.norm(position))
        body, mu, radius, _ = self.center
        if r <= radius:
            where = f"{r / 1e3:.6g} km from {body}'s center, inside {body}"
            raise InputError("position_m", f"is {where}")
        try:
            _ = self.orbit
        except ValueError as error:
            reason, circular = str(error).split(";")[0], (mu / r) ** 0.5
            raise InputError(
                "velocity_m_s",
                f"{reason}; perpendicular to position_m, {circular:.6g} m/s is a circular orbit",
            ) from error
