"""Models of vehicles, the chief's orbit, and the plant that is flown."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, date, datetime
from functools import cached_property
from math import degrees, pi
from typing import Annotated, Any, ClassVar, Literal, NamedTuple

import numpy as np
from annotated_types import Lt
from jaxtyping import Float
from numpy import ndarray as Array
from pydantic import BeforeValidator

from dynamics.atmosphere import Atmosphere
from dynamics.clohessy_wiltshire import ClohessyWiltshire
from dynamics.coordinate_frames import to_polar_nodal
from dynamics.double_integrator import DoubleIntegrator
from dynamics.inertial import InertialPlant
from dynamics.j2 import J2, invariant_velocity
from dynamics.model import LinearizedModel, LinearModel, NonlinearModel
from dynamics.orbit import EARTH_J2, EARTH_MU, EARTH_RADIUS, Orbit
from dynamics.plant import LinearPlant, NonlinearPlant, Plant
from dynamics.schweighart_sedwick import SchweighartSedwick
from dynamics.tschauner_hempel import TschaunerHempel
from dynamics.units import Unit
from sato.scenario.definition import Coordinates, Definition, NotNegative, Positive
from sato.scenario.errors import InputError, join_names, round_down, round_up

MAX_J2 = 0.05  # about where J2 would no longer be a small part of gravity; the Earth's is 0.001
MIN_COS_LATITUDE = 0.3  # |cos θ| from which on velocities out of the plane are not large
ANOMALIES = np.arange(-180, 180, 5)  # tried for a better start along the orbit [deg]
ELEMENTS = (
    "semi_major_axis", "eccentricity", "inclination", "node", "perigee", "anomaly"
)  # fmt: skip
POLAR_NODAL = ("radius", "radial_speed", "angular_momentum", "node", "inclination", "latitude")
EXAMPLE = "ballistic_m2_kg = 0.01 (say 2.2 × 0.5 m² / 110 kg)"

MODELS: dict[str, Callable[[Orbit], LinearModel]] = {
    "clohessy_wiltshire": ClohessyWiltshire.from_orbit,
    "schweighart_sedwick": SchweighartSedwick.from_orbit,
    "eccentric": TschaunerHempel.from_orbit,
    "j2": lambda orbit: LinearizedModel.at_origin(J2(orbit)),
}


def _as_utc(value: Any) -> Any:
    # A date is one in TOML, with quotes and without.
    try:
        time = datetime.fromisoformat(value.isoformat() if isinstance(value, date) else value)
    except (TypeError, ValueError) as error:
        raise InputError(
            "", 'must be a date and time in UTC; "2026-01-01T00:00:00" would do'
        ) from error
    if time.tzinfo is not None:
        time = time.astimezone(UTC).replace(tzinfo=None)
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
    node: Annotated[float | None, Unit("rad"), "right ascension of the ascending node"] = None
    perigee: Annotated[float | None, Unit("rad"), "argument of perigee"] = None
    anomaly: Annotated[float | None, Unit("rad"), "true anomaly"] = None
    position: Annotated[Coordinates | None, Unit("m"), "inertial position"] = None
    velocity: Annotated[Coordinates | None, Unit("m_s"), "inertial velocity"] = None
    radius: Annotated[float | None, Unit("m"), "distance from the Earth's center"] = None
    radial_speed: Annotated[float | None, Unit("m_s"), "radial speed"] = None
    angular_momentum: Annotated[float | None, Unit("m2_s"), "specific angular momentum"] = None
    latitude: Annotated[float | None, Unit("rad"), "argument of latitude"] = None
    j2: Annotated[float, NotNegative, Lt(MAX_J2), "oblateness J2; 0 is Kepler's motion"] = EARTH_J2
    epoch: Annotated[str, BeforeValidator(_as_utc), "UTC of time 0"] = "2026-01-01T00:00:00"

    @classmethod
    def from_orbit(cls, orbit: Orbit) -> "Chief":
        """Return the chief on an orbit of the library, equal to the last bit."""
        r, v_x, h, node, inclination, latitude = orbit.initial_elements
        chief = cls(
            radius=r,
            radial_speed=v_x,
            angular_momentum=h,
            node=node,
            inclination=inclination,
            latitude=latitude,
            j2=orbit.k_J2 / (1.5 * EARTH_MU * EARTH_RADIUS**2),
        )
        for j2 in (EARTH_J2, *(np.nextafter(chief.j2, end) for end in (0.0, 1.0))):
            if chief.orbit.k_J2 != orbit.k_J2:
                chief = replace(chief, j2=float(j2))
        return chief

    @cached_property
    def orbit(self) -> Orbit:
        """Orbit of the library, with the Earth's oblateness as it is asked for."""
        k_J2 = 1.5 * self.j2 * EARTH_MU * EARTH_RADIUS**2
        if self.radius is not None:
            elements = [getattr(self, name) or 0.0 for name in POLAR_NODAL]
        elif self.position is not None and self.velocity is not None:
            elements = to_polar_nodal(np.array([*self.position, *self.velocity])).tolist()
        else:
            a, e, i, raan, perigee, anomaly = [getattr(self, name) or 0.0 for name in ELEMENTS]
            return Orbit.from_elements(a, e, i, raan, perigee, anomaly, k_J2=k_J2)
        r, v_x, h, raan, i, latitude = elements
        return Orbit(r, v_x, h, raan, i, latitude, k_J2=k_J2)

    @property
    def perigee_altitude(self) -> float:
        """Altitude of the perigee above the Earth's equatorial radius [m]."""
        return self.orbit.semi_major_axis * (1 - self.orbit.eccentricity) - EARTH_RADIUS

    def check(self) -> None:
        """Refuse no orbit, two, or one that meets the Earth."""
        ways: dict[str, list[Any]] = {
            "semi_major_axis_m": [
                self.semi_major_axis,
                self.eccentricity,
                self.perigee,
                self.anomaly,
            ],
            "position_m": [self.position, self.velocity],
            "radius_m": [self.radius, self.radial_speed, self.angular_momentum, self.latitude],
        }
        given = [key for key, values in ways.items() if any(v is not None for v in values)]
        if len(given) > 1 or (given == ["position_m"] and (self.inclination or self.node)):
            raise InputError(
                given[0],
                f"gives the orbit, and so does {given[-1]}; give classical elements, or "
                "position_m and velocity_m_s, or polar-nodal elements, one of the three",
            )
        first = ways[given[0]] if given else []
        if not given or first[0] is None or (given == ["position_m"] and first[1] is None):
            missing = given[0] if given else "semi_major_axis_m"
            missing = "velocity_m_s" if missing == "position_m" and first[0] else missing
            raise InputError(
                missing,
                "is missing; an orbit is given by semi_major_axis_km = 6878, say, "
                "and the other elements that are not 0, or by position_m and velocity_m_s",
            )
        if self.semi_major_axis is not None:
            self._check_elements(self.semi_major_axis)
        elif self.position is not None and self.velocity is not None:
            self._check_state(self.position, self.velocity)
        else:
            _ = self.orbit

    def _check_elements(self, a: float) -> None:
        e, i = self.eccentricity or 0.0, self.inclination or 0.0
        rounder = f"eccentricity = {round_down(1 - EARTH_RADIUS / a)}" if a > EARTH_RADIUS else ""
        if e >= 1:
            raise InputError(
                "eccentricity",
                f"{e:g} is no ellipse, so the chief would never come back, and relative motion is "
                f"about one that does; {rounder or 'less than 1, in a wider orbit,'} would do",
            )
        if a * (1 - e) <= EARTH_RADIUS:
            wider = f"semi_major_axis_km = {round_up(EARTH_RADIUS / (1 - e) / 1e3)}"
            cures = [rounder, wider] if e > 0 and rounder else [wider]
            raise InputError(
                "eccentricity" if e > 0 and rounder else "semi_major_axis_m",
                f"puts the perigee {a * (1 - e) / 1e3:.6g} km from the Earth's center, inside the "
                f"Earth, whose radius is {EARTH_RADIUS / 1e3:.0f} km; {join_names(cures)} would do",
            )
        if not 0 <= i <= pi:
            raise InputError(
                "inclination_rad",
                f"must be between 0 and 180 degrees, got {degrees(i):.6g}; above 90 an orbit is "
                "retrograde",
            )

    def _check_state(self, position: tuple[float, ...], velocity: tuple[float, ...]) -> None:
        for name, value in (("position_m", position), ("velocity_m_s", velocity)):
            if len(value) != 3:
                raise InputError(name, f"needs 3 coordinates, got {len(value)}")
        try:
            _ = self.orbit
        except ValueError as error:
            r = float(np.linalg.norm(position))
            if r <= EARTH_RADIUS:
                raise InputError(
                    "position_m",
                    f"is {r / 1e3:.6g} km from the Earth's center, inside the Earth, whose radius "
                    f"is {EARTH_RADIUS / 1e3:.0f} km",
                ) from error
            reason, circular = str(error).split(";")[0], (EARTH_MU / r) ** 0.5
            raise InputError(
                "velocity_m_s",
                f"{reason}; perpendicular to position_m, {circular:.6g} m/s is a circular orbit",
            ) from error


@dataclass(frozen=True, eq=False, repr=False)
class PointMass(Definition):
    """Double integrator, r̈ = u."""

    kind: ClassVar[str] = "double_integrator"
    dimension: Annotated[Literal[2, 3], "axes of space"] = 2


@dataclass(frozen=True, eq=False, repr=False)
class OrbitalModel(Definition):
    """Motion relative to a chief."""

    kind: Annotated[
        Literal["clohessy_wiltshire", "schweighart_sedwick", "eccentric", "j2"], "equations"
    ]
    relinearize: Annotated[bool, "for j2: linearize about each agent's own trajectory"] = True
    mean_motion: Annotated[
        float | None, Unit("rad_s"), Positive, "for clohessy_wiltshire without a chief"
    ] = None

    def check(self) -> None:
        """Refuse a mean motion for a model that has none."""
        if self.mean_motion is not None and self.kind != "clohessy_wiltshire":
            raise InputError("mean_motion_rad_s", 'is for kind = "clohessy_wiltshire" only')


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class PlantSettings(Definition):
    """Motion that is flown, where it differs from the model."""

    kind: Annotated[
        Literal["inertial", "model"] | None, "what is integrated; inertial about a chief if absent"
    ] = None
    drag: Annotated[bool, "drag in the Earth's atmosphere"] = False
    ballistic: Annotated[float | None, Unit("m2_kg"), Positive, "C_D A/m of the vehicles"] = None
    ballistic_spread: Annotated[float, NotNegative, Lt(1), "it is drawn within ± this part"] = 0.0
    chief_ballistic: Annotated[
        float | None, Unit("m2_kg"), NotNegative, "C_D A/m of the chief; as the others if absent"
    ] = None
    density: Annotated[float | None, Unit("kg_m3"), Positive, "air density at the altitude"] = None
    altitude: Annotated[
        float | None, Unit("m"), NotNegative, "altitude; the chief's perigee if absent"
    ] = None
    scale_height: Annotated[float | None, Unit("m"), Positive, "scale height of the air"] = None

    def check(self) -> None:
        """Refuse half a drag."""
        idle = {
            "ballistic_m2_kg": self.ballistic,
            "ballistic_spread": self.ballistic_spread or None,
            "chief_ballistic_m2_kg": self.chief_ballistic,
        } | self._air
        unused = [key for key, value in idle.items() if value is not None]
        if unused and not self.drag:
            raise InputError(unused[0], "has no effect without drag; drag = true would use it")
        if self.drag and self.ballistic is None:
            raise InputError(
                "ballistic_m2_kg",
                f"is missing, and drag needs the coefficient C_D A/m; {EXAMPLE} would do",
            )
        if self.drag and self.kind == "model":
            raise InputError("drag", 'this model has no drag; kind = "inertial" would do')
        missing = [key for key, value in self._air.items() if value is None]
        if 0 < len(missing) < len(self._air):
            names = join_names(self._air, "and")
            raise InputError(missing[0], f"is missing; {names} are given together, or none of them")

    @property
    def _air(self) -> dict[str, float | None]:
        return {
            "density_kg_m3": self.density,
            "altitude_m": self.altitude,
            "scale_height_m": self.scale_height,
        }

    def atmosphere(self, chief: Chief) -> Atmosphere:
        """Return the air that is given, or that at the chief's perigee.

        Raises:
            InputError: There is no air at the chief's perigee.
        """
        if self.density is None or self.altitude is None or self.scale_height is None:
            try:
                return Atmosphere.from_altitude(chief.perigee_altitude)
            except ValueError as error:
                message = f"there is no air at the chief's perigee: {error}"
                raise InputError("plant.drag", message) from error
        return Atmosphere(self.density, self.altitude, self.scale_height)


AnyModel = PointMass | OrbitalModel | LinearModel | NonlinearModel


def as_definition(model: AnyModel, chief: Chief | None) -> tuple[AnyModel, Chief | None]:
    """Return a model of the library as the definition, and the chief, that a file has for it."""
    if type(model) is DoubleIntegrator:
        return PointMass(model.axes), chief  # type: ignore[arg-type]
    if type(model) is J2 and chief in (None, Chief.from_orbit(model.orbit)):
        return OrbitalModel("j2"), chief or Chief.from_orbit(model.orbit)
    if type(model) is ClohessyWiltshire and chief is None:
        return OrbitalModel("clohessy_wiltshire", mean_motion=model.n), None
    if isinstance(model, ClohessyWiltshire) and chief is not None:
        if model == ClohessyWiltshire.from_orbit(chief.orbit):
            return OrbitalModel("clohessy_wiltshire"), chief
    return model, chief


def check_kind(data: dict[str, Any]) -> None:
    """Refuse the table of an orbital model without a chief, before its keys are read.

    Raises:
        InputError: There is no chief, so the keys of the model are likely those of another.
    """
    model = data.get("model")
    kind = model.get("kind") if isinstance(model, dict) else None
    if kind in MODELS and "chief" not in data and "mean_motion_rad_s" not in model:  # type: ignore[operator]
        raise InputError(
            "model.kind",
            f'"{kind}" is motion about an orbit, and this mission has none; a [chief] with '
            "semi_major_axis_km = 6878, say, and a swarm in space would do, as the scenario orbit "
            'has them, or here kind = "double_integrator"',
        )


def as_chief(value: Any) -> Any:
    """Convert an orbit of the library to the definition of a chief."""
    return Chief.from_orbit(value) if isinstance(value, Orbit) else value


class World(NamedTuple):
    """Model, chief and plant of a mission, and what follows from the three."""

    model: AnyModel
    chief: Chief | None
    plant: PlantSettings | Plant

    @property
    def flies_model(self) -> bool:
        """True where the vehicles do exactly what the shared model says."""
        if isinstance(self.plant, Plant):
            return isinstance(self.plant, LinearPlant)
        if isinstance(self.model, NonlinearModel):
            return False
        return self.plant.kind == "model" or self.chief is None

    def linear_model(self) -> LinearModel:
        """Return the model that all agents share and auctions price by."""
        if isinstance(self.model, PointMass):
            return DoubleIntegrator(self.model.dimension)
        if isinstance(self.model, LinearModel):
            return self.model
        if isinstance(self.model, NonlinearModel):
            return LinearizedModel.at_origin(self.model)
        if self.model.mean_motion is not None:
            return ClohessyWiltshire(self.model.mean_motion)
        assert self.chief is not None
        return MODELS[self.model.kind](self.chief.orbit)

    def nonlinear_model(self) -> NonlinearModel | None:
        """Return the model that agents linearize about their own trajectories, if there is one."""
        if isinstance(self.model, NonlinearModel):
            return self.model
        if self.chief is None or not isinstance(self.model, OrbitalModel) or self.flies_model:
            return None
        is_own = self.model.kind == "j2" and self.model.relinearize
        return J2(self.chief.orbit) if is_own else None

    def draw_plant(self, model: LinearModel, agents: int, rng: np.random.Generator) -> Plant:
        """Return what is flown, with ballistic coefficients drawn where they differ."""
        if isinstance(self.plant, Plant):
            return self.plant
        if self.chief is None or self.flies_model:
            if isinstance(self.model, NonlinearModel):
                return NonlinearPlant(self.model)
            return LinearPlant(model, None if self.chief is None else self.chief.orbit)
        if not self.plant.drag:
            return InertialPlant(self.chief.orbit)
        usual = self.plant.ballistic
        assert usual is not None
        own = self.plant.chief_ballistic
        return InertialPlant(
            self.chief.orbit,
            ballistic_coefficient=usual
            * (1 + self.plant.ballistic_spread * rng.uniform(-1, 1, agents)),
            chief_ballistic_coefficient=usual if own is None else own,
            atmosphere=self.plant.atmosphere(self.chief),
        )

    def drift_free_velocities(
        self, position: Float[Array, "k d"], t: float, where: str, all_times: tuple[float, ...]
    ) -> Float[Array, "k d"]:
        """Return velocities with which vehicles stay about where they are.

        At rest, or J2-invariant about a chief: the same for every model, so that runs with
        different models can be compared.

        Args:
            position: Positions at t [m].
            t: Time [s].
            where: Table that asks for them.
            all_times: Times at which this mission asks for velocities, to say what would do [s].

        Raises:
            InputError: They are out of the chief's plane where no velocity keeps them there.
        """
        if isinstance(self.model, OrbitalModel) and self.model.mean_motion is not None:
            return ClohessyWiltshire(self.model.mean_motion).bounded_velocity(position)
        if self.chief is None:
            return np.zeros_like(position)
        try:
            return invariant_velocity(self.chief.orbit, position, t)
        except ValueError as error:
            latitude = np.degrees(self.chief.orbit.elements_at(t)[5]) % 360
            raise InputError(
                where,
                f"lies out of the plane of the chief's orbit, and {t:g} s after the start the "
                f"chief is at {latitude:.4g}° of argument of latitude, too near 90° or 270° for "
                f"any velocity to keep vehicles there; {better_start(self.chief, all_times)}",
            ) from error

    def check(self) -> None:
        """Refuse a model, a chief and a plant that do not belong together.

        Raises:
            InputError: They do not.
        """
        if isinstance(self.model, OrbitalModel) and self.model.mean_motion is None:
            check_kind({"model": {"kind": self.model.kind}} | ({"chief": 1} if self.chief else {}))
        if self.chief is not None and isinstance(self.model, PointMass):
            others = join_names(f'"{name}"' for name in MODELS)
            raise InputError(
                "model.kind",
                f'"double_integrator" has no orbit, and this mission has a [chief]; {others} '
                "would do",
            )
        if isinstance(self.plant, Plant):
            return
        if self.chief is None and (self.plant.kind == "inertial" or self.plant.drag):
            key = "plant.kind" if self.plant.kind == "inertial" else "plant.drag"
            raise InputError(
                key,
                "takes place about the Earth, and this mission has no [chief]; one with "
                'semi_major_axis_km = 6878, say, would do, or plant.kind = "model" without drag',
            )
        if self.chief is not None and self.plant.drag:
            self.plant.atmosphere(self.chief)


def better_start(chief: Chief, times: tuple[float, ...]) -> str:
    """Say where along its orbit a chief would let vehicles stay out of its plane at all times."""
    flat = "positions in the plane (z = 0)"
    if chief.semi_major_axis is None:
        return f"another start along the orbit would do, or {flat}"

    def least_cosine(degrees: float) -> float:
        moved = replace(chief, anomaly=float(np.radians(degrees)))
        return float(np.abs(np.cos(moved.orbit.elements_at(np.array(times))[:, 5])).min())

    best = max(ANOMALIES.tolist(), key=least_cosine)
    if least_cosine(best) < MIN_COS_LATITUDE:
        return f"shorter legs and another chief.anomaly_deg would do, or {flat}"
    return f"chief.anomaly_deg = {best} would do, or {flat}"
