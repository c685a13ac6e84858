"""The chief of a scenario and the plant: in which orbit a swarm flies, and how it really moves."""

from datetime import UTC, date, datetime
from math import degrees, pi
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    NonNegativeFloat,
    PositiveFloat,
    model_validator,
)

from dynamics.coordinate_frames import to_polar_nodal
from dynamics.orbit import EARTH_J2, EARTH_MU, EARTH_RADIUS, Orbit
from sato.former.refusal import Refusal, downward, listed, upward
from sato.former.units import Table

ELEMENTS = (
    "semi_major_axis_m",
    "eccentricity",
    "inclination_rad",
    "node_rad",
    "perigee_rad",
    "anomaly_rad",
)
MUCH_J2 = 0.05  # about where J2 would no longer be a small part of gravity; the Earth's is 0.001
AIR = ("density_kg_m3", "altitude_m", "scale_height_m")
EXAMPLE = "ballistic_m2_kg = 0.01 (say 2.2 × 0.5 m² / 110 kg)"


def _utc(value: Any) -> Any:
    # A date is one in TOML, with quotes and without.
    try:
        moment = datetime.fromisoformat(value.isoformat() if isinstance(value, date) else value)
    except (TypeError, ValueError) as error:
        raise Refusal(
            "", 'must be a date and time in UTC; "2026-01-01T00:00:00" would do'
        ) from error
    if moment.tzinfo is not None:
        moment = moment.astimezone(UTC).replace(tzinfo=None)
    return moment.isoformat()


class Chief(Table):
    """The orbit about which a swarm flies, osculating at time 0.

    By its elements, those that are not given being 0, or by its inertial state.
    """

    semi_major_axis_m: PositiveFloat | None = None
    eccentricity: NonNegativeFloat | None = None
    inclination_rad: float | None = None
    node_rad: float | None = None
    perigee_rad: float | None = None
    anomaly_rad: float | None = None  # true
    position_m: list[float] | None = None
    velocity_m_s: list[float] | None = None
    j2: Annotated[float, Field(ge=0, lt=MUCH_J2)] = EARTH_J2  # 0 is Kepler's motion
    epoch: Annotated[str, BeforeValidator(_utc)] = "2026-01-01T00:00:00"  # UTC, of time 0

    @model_validator(mode="after")
    def _one_orbit(self) -> "Chief":
        given = [name for name in ELEMENTS if getattr(self, name) is not None]
        state = [name for name in ("position_m", "velocity_m_s") if getattr(self, name) is not None]
        if given and state:
            raise Refusal(
                given[0],
                f"is an element of the orbit, and so is {state[0]}, which gives it another way; "
                "give elements, or position_m and velocity_m_s, but not both",
            )
        if self.semi_major_axis_m is None and len(state) < 2:
            lacking = "velocity_m_s" if "position_m" in state else "position_m"
            missing = lacking if state else "semi_major_axis_m"
            raise Refusal(
                missing,
                "is missing; an orbit is given by semi_major_axis_km = 6878, say, "
                "and what other elements are not 0, or by position_m and velocity_m_s",
            )
        if state:
            self._check_state()
        else:
            self._check_elements()
        return self

    @property
    def orbit(self) -> Orbit:
        """The orbit, with the Earth's oblateness as it is asked for."""
        k_J2 = 1.5 * self.j2 * EARTH_MU * EARTH_RADIUS**2
        if self.position_m is not None and self.velocity_m_s is not None:
            state = np.array([*self.position_m, *self.velocity_m_s], dtype=float)
            r, v_x, h, node, inclination, latitude = to_polar_nodal(state).tolist()
            return Orbit(r, v_x, h, node, inclination, latitude, k_J2=k_J2)
        assert self.semi_major_axis_m is not None
        return Orbit.from_elements(
            self.semi_major_axis_m,
            self.eccentricity or 0.0,
            self.inclination_rad or 0.0,
            self.node_rad or 0.0,
            self.perigee_rad or 0.0,
            self.anomaly_rad or 0.0,
            k_J2=k_J2,
        )

    @property
    def perigee(self) -> float:
        """Altitude at the perigee, above the Earth's equatorial radius [m]."""
        orbit = self.orbit
        return orbit.semi_major_axis * (1 - orbit.eccentricity) - EARTH_RADIUS

    def _check_elements(self) -> None:
        assert self.semi_major_axis_m is not None
        a, e, i = self.semi_major_axis_m, self.eccentricity or 0.0, self.inclination_rad or 0.0
        rounder = f"eccentricity = {downward(1 - EARTH_RADIUS / a)}" if a > EARTH_RADIUS else ""
        if e >= 1:
            raise Refusal(
                "eccentricity",
                f"{e:g} is no ellipse, so the chief would never come back, and relative motion is "
                f"about one that does; {rounder or 'less than 1, in a wider orbit,'} would do",
            )
        if a * (1 - e) <= EARTH_RADIUS:
            wider = f"semi_major_axis_km = {upward(EARTH_RADIUS / (1 - e) / 1e3)}"
            cures = [rounder, wider] if e > 0 and rounder else [wider]
            raise Refusal(
                "eccentricity" if e > 0 and rounder else "semi_major_axis_m",
                f"puts the perigee {a * (1 - e) / 1e3:.6g} km from the Earth's centre, inside the "
                f"Earth, whose radius is {EARTH_RADIUS / 1e3:.0f} km; {listed(cures)} would do",
            )
        if not 0 <= i <= pi:
            raise Refusal(
                "inclination_rad",
                f"lies between 0 and 180 degrees, got {degrees(i):.6g}; above 90 an orbit runs "
                "against the Earth's turning",
            )

    def _check_state(self) -> None:
        for name in ("position_m", "velocity_m_s"):
            if len(getattr(self, name)) != 3:
                raise Refusal(name, f"needs 3 coordinates, got {len(getattr(self, name))}")
        try:
            _ = self.orbit
        except ValueError as error:
            assert self.position_m is not None
            r = float(np.linalg.norm(self.position_m))
            if r <= EARTH_RADIUS:
                raise Refusal(
                    "position_m",
                    f"is {r / 1e3:.6g} km from the Earth's centre, inside the Earth, whose radius "
                    f"is {EARTH_RADIUS / 1e3:.0f} km",
                ) from error
            raise Refusal(
                "velocity_m_s",
                f"{error}; square to position_m, {(EARTH_MU / r) ** 0.5:.6g} m/s is a circle",
            ) from error


class PlantTable(Table):
    """How the vehicles really move, where that is not what plans think."""

    kind: Literal["inertial", "model"] | None = None  # without it, inertial about a chief
    drag: bool = False
    ballistic_m2_kg: PositiveFloat | None = None  # C_D A/m
    ballistic_spread: Annotated[float, Field(ge=0, lt=1)] = 0.0  # drawn within ± this part of it
    chief_ballistic_m2_kg: NonNegativeFloat | None = None  # without it, as the others
    density_kg_m3: PositiveFloat | None = None  # of the air at the altitude; without these three,
    altitude_m: NonNegativeFloat | None = None  # as it is at the chief's perigee
    scale_height_m: PositiveFloat | None = None

    @model_validator(mode="after")
    def _whole_drag(self) -> "PlantTable":
        of_drag = ("ballistic_m2_kg", "ballistic_spread", "chief_ballistic_m2_kg", *AIR)
        idle = [name for name in of_drag if getattr(self, name) not in (None, 0.0)]
        if idle and not self.drag:
            raise Refusal(idle[0], "does nothing without drag; drag = true would put it to use")
        if self.drag and self.ballistic_m2_kg is None:
            raise Refusal(
                "ballistic_m2_kg",
                f"is missing, and drag needs the coefficient C_D A/m; {EXAMPLE} would do",
            )
        if self.drag and self.kind == "model":
            raise Refusal("drag", 'the model knows no air; kind = "inertial" would do')
        lacking = [name for name in AIR if getattr(self, name) is None]
        if 0 < len(lacking) < len(AIR):
            raise Refusal(
                lacking[0], f"is missing; {listed(AIR, 'and')} are given together, or none of them"
            )
        return self
