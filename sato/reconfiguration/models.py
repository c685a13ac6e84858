"""Models by which vehicles plan, and the plant that is flown: as definitions, and as motion."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from math import pi
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from annotated_types import Ge, Lt

from dynamics.atmosphere import Atmosphere
from dynamics.bodies import EARTH, find_body
from dynamics.circular_orbit import CircularOrbitModel, ClohessyWiltshire, SchweighartSedwick
from dynamics.coordinate_frames import inertial_state
from dynamics.discretize import DiscreteModel, discretize_zoh, have_equal_steps
from dynamics.doors import check_methods
from dynamics.double_integrator import DoubleIntegrator
from dynamics.inertial import InertialPlant
from dynamics.j2 import J2
from dynamics.model import LinearizedModel, LinearModel, NonlinearModel
from dynamics.orbit import Orbit
from dynamics.plant import LinearPlant, NonlinearPlant, Plant
from dynamics.tschauner_hempel import TschaunerHempel
from dynamics.units import Unit
from sato.reconfiguration.orbit import Chief
from sato.reconfiguration.own_motion import check_axes
from sato.scenario.definition import Amount, Definition, NotNegative, Positive, fields_of
from sato.scenario.errors import InputError, join_names

MODELS: dict[str, Callable[[Orbit], LinearModel]] = {
    "clohessy_wiltshire": ClohessyWiltshire.from_orbit,
    "schweighart_sedwick": SchweighartSedwick.from_orbit,
    "eccentric": TschaunerHempel,
    "j2": lambda orbit: LinearizedModel(J2(orbit)),
}
OTHER_N = 0.01  # relative difference of mean motions from which on orbits are others
SAMPLED_STEPS = (0, 1, 3, 7, 15, 31, 63, 127, 255, 511, 1023)  # at which models are compared
AIR = {"density_kg_m3": "density", "altitude_m": "altitude", "scale_height_m": "scale_height"}


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
    scale_height: Annotated[float | None, Unit("m"), Ge(1e3), "scale height of the air"] = None

    def check(self) -> None:
        """Refuse half a drag."""
        if not self.drag:
            for field in fields_of(type(self)):
                is_given = getattr(self, field.name) != field.default
                if is_given and field.name not in ("kind", "drag"):
                    reason = "has no effect without drag; drag = true would use it"
                    raise InputError(field.key, reason)
            return
        if self.ballistic is None:
            example = "ballistic_m2_kg = 0.01 (say 2.2 × 0.5 m² / 110 kg)"
            needed = f"drag needs the coefficient C_D A/m; {example} would do"
            raise InputError("ballistic_m2_kg", f"is missing, and {needed}")
        if self.kind == "model":
            raise InputError("drag", 'this model has no drag; kind = "inertial" would do')
        missing = [key for key, name in AIR.items() if getattr(self, name) is None]
        if 0 < len(missing) < len(AIR):
            names = join_names(AIR, "and")
            raise InputError(missing[0], f"is missing; {names} are given together, or none of them")

    def atmosphere(self, chief: Chief) -> Atmosphere:
        """Return the air that is given, or that at the chief's perigee.

        Raises:
            InputError: There is no air at the chief's perigee, or the chief is not about the Earth.
        """
        if find_body(chief.center.mu) is not EARTH:
            reason = f"the air is the Earth's, and the chief goes about {chief.center.name}"
            raise InputError("plant.drag", f"{reason}; drag = false would do")
        if self.density is not None and self.altitude is not None and self.scale_height is not None:
            return Atmosphere(self.density, self.altitude, self.scale_height)
        try:
            return Atmosphere.from_altitude(chief.perigee_altitude)
        except ValueError as error:
            message = f"there is no air at the chief's perigee: {error}"
            raise InputError("plant.drag", message) from error


AnyModel = PointMass | OrbitalModel | LinearModel | NonlinearModel


def as_definition(model: AnyModel, chief: Chief | None) -> tuple[AnyModel, Chief | None]:
    """Return a model of the library as the definition, and the chief, that a file has for it."""
    if type(model) is J2 and (chief is None or chief.orbit == model.orbit):
        return OrbitalModel("j2"), chief or Chief.from_orbit(model.orbit)
    if type(model) is ClohessyWiltshire and chief is None:
        return OrbitalModel("clohessy_wiltshire", mean_motion=model.n), None
    if chief is not None and isinstance(model, CircularOrbitModel | TschaunerHempel):
        for kind, make in MODELS.items():
            if model == make(chief.orbit):
                return OrbitalModel(kind), chief  # type: ignore[arg-type]
    return model, chief


def as_point_mass(model: Any) -> Any:
    """Convert a double integrator of the library to its definition; refuse a model by its axes."""
    check_axes(model)
    return PointMass(model.axes) if type(model) is DoubleIntegrator else model


def as_chief(value: Any) -> Any:
    """Convert an orbit of the library to the definition of a chief."""
    return Chief.from_orbit(value) if isinstance(value, Orbit) else value


def check_orbital_model(kind: object, has_orbit: bool) -> None:
    """Refuse an orbital model without an orbit; its keys are likely those of another."""
    if isinstance(kind, str) and kind in MODELS and not has_orbit:
        raise InputError(
            "model.kind",
            f'"{kind}" is motion about an orbit, and this mission has none; a [chief] with '
            "semi_major_axis_km = 6878, say, and a swarm in space would do, as the scenario orbit "
            'has them, or here kind = "double_integrator"',
        )


def check_motion(model: AnyModel, chief: Chief | None, plant: PlantSettings | Plant) -> None:
    """Refuse a model, a chief and a plant that do not belong together."""
    if isinstance(model, OrbitalModel):
        check_orbital_model(model.kind, chief is not None or model.mean_motion is not None)
    if chief is not None and isinstance(model, PointMass):
        others = join_names(f'"{name}"' for name in MODELS)
        none = '"double_integrator" has no orbit, and this mission has a [chief]'
        raise InputError("model.kind", f"{none}; {others} would do")
    for name, part in (("model", model), ("plant", plant)):
        if chief is None:
            break
        about, orbit = getattr(part, "chief_orbit", None), chief.orbit
        about = getattr(part, "orbit", part) if about is None else about
        period, mu = getattr(about, "period", None), getattr(about, "mu", None)
        if isinstance(part, ClohessyWiltshire | SchweighartSedwick):
            period, mu = 2 * pi / part.n, None
        if mu not in (None, orbit.mu):
            reason = f"has mu = {mu:.6g} m³/s², and the chief {orbit.mu:.6g}"
            raise InputError(name, f"{reason}; one orbit for both would do")
        if period is not None and abs(orbit.period / period - 1) > OTHER_N:
            reason = f"has a period of {period:.5g} s, and the chief {orbit.period:.5g} s"
            raise InputError(name, f"{reason}; one orbit for both, or a mission without the chief")
        if isinstance(about, Orbit):
            here, there = (inertial_state(np.array(o.initial_elements)) for o in (orbit, about))
            if (gap := np.linalg.norm((there - here)[:3])) > OTHER_N * orbit.r:
                reason = f"is about an orbit {gap / 1e3:.4g} km from the chief at time 0"
                raise InputError(name, f"{reason}; one orbit for both would do")
    if isinstance(plant, Plant):
        return
    if chief is None and (plant.kind == "inertial" or plant.drag):
        raise InputError(
            "plant.kind" if plant.kind == "inertial" else "plant.drag",
            "takes place about the Earth, and this mission has no [chief]; one with "
            'semi_major_axis_km = 6878, say, would do, or plant.kind = "model" without drag',
        )
    if chief is not None and plant.drag:
        plant.atmosphere(chief)


@check_methods
class Motion:
    """Properties that follow from the model, the chief and the plant of a mission."""

    model: AnyModel
    chief: Chief | None
    plant: PlantSettings | Plant
    step: float

    @property
    def axes(self) -> int:
        """Axes of space."""
        if isinstance(self.model, PointMass):
            return self.model.dimension
        return 3 if isinstance(self.model, OrbitalModel) else self.model.axes

    @property
    def array_sizes(self) -> dict[str, int]:
        """Sizes of the axes of arrays, by name."""
        return {"d": self.axes, "n": 2 * self.axes}

    @property
    def is_point_mass(self) -> bool:
        """True for a double integrator."""
        return isinstance(self.model, PointMass)

    @cached_property
    def flies_model(self) -> bool:
        """True where the vehicles do exactly what the shared model says.

        A plant of a linear model does so if its steps are those of the shared model, up to
        rounding: at the beginning, and 1, 3, 7 … 1023 control steps later.
        """
        plant, step = self.plant, self.step
        if isinstance(self.model, NonlinearModel):
            return False
        if isinstance(plant, Plant):
            if type(plant) is not LinearPlant:
                return False
            times = [k * step for k in SAMPLED_STEPS]
            return have_equal_steps(plant.model, self.linear_model, step, times)
        return plant.kind == "model" or self.chief is None

    @cached_property
    def linear_model(self) -> LinearModel:
        """Model that all agents share, and auctions price by."""
        model = self.model
        if isinstance(model, PointMass):
            return DoubleIntegrator(model.dimension)
        if isinstance(model, LinearModel):
            return model
        if isinstance(model, NonlinearModel):
            return LinearizedModel(model)
        if model.mean_motion is not None:
            return ClohessyWiltshire(model.mean_motion)
        assert self.chief is not None
        return MODELS[model.kind](self.chief.orbit)

    def discretize(self, steps: Amount, time: float = 0.0) -> DiscreteModel:
        """Discretize the shared model over some control steps from a time on."""
        return discretize_zoh(self.linear_model, self.step, steps, time)

    @cached_property
    def nonlinear_model(self) -> NonlinearModel | None:
        """Model that each agent linearizes about its own trajectory, if there is one."""
        if isinstance(self.model, NonlinearModel):
            return self.model
        if self.chief is None or not isinstance(self.model, OrbitalModel) or self.flies_model:
            return None
        is_own = self.model.kind == "j2" and self.model.relinearize
        return J2(self.chief.orbit) if is_own else None

    @property
    def orbital_period(self) -> float | None:
        """Period of the chief, or of the model [s]; None where there is no orbit."""
        if self.chief is not None:
            return self.chief.orbit.period
        model = self.linear_model
        if isinstance(model, ClohessyWiltshire | SchweighartSedwick):
            return 2 * pi / model.n
        orbit = getattr(model, "orbit", None)
        return orbit.period if isinstance(orbit, Orbit) else None

    def draw_plant(self, agents: Amount, rng: np.random.Generator) -> PlantSettings | Plant:
        """Return the plant, with ballistic coefficients drawn where vehicles have them."""
        plant, chief = self.plant, self.chief
        if isinstance(plant, Plant) or plant.ballistic is None or chief is None:
            return plant
        drawn = plant.ballistic * (1 + plant.ballistic_spread * rng.uniform(-1, 1, agents))
        of_chief = plant.ballistic if plant.chief_ballistic is None else plant.chief_ballistic
        return InertialPlant(chief.orbit, drawn, of_chief, plant.atmosphere(chief))

    @cached_property
    def flown_plant(self) -> Plant:
        """Motion of the vehicles, once ballistic coefficients are drawn."""
        if isinstance(self.plant, Plant):
            return self.plant
        if self.plant.ballistic is not None:
            raise ValueError("the plant is known once the mission is drawn: mission.draw(rng)")
        orbit = None if self.chief is None else self.chief.orbit
        if orbit is not None and not self.flies_model:
            return InertialPlant(orbit)
        if isinstance(self.model, NonlinearModel):
            return NonlinearPlant(self.model)
        return LinearPlant(self.linear_model, orbit)
