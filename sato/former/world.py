"""Where a scenario takes place: in a plane, in space, or about a chief in orbit."""

from typing import Any, NamedTuple, get_args

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics import DoubleIntegrator, LinearModel
from dynamics.atmosphere import Atmosphere
from dynamics.inertial import InertialPlant
from dynamics.j2 import J2, invariant_velocity
from dynamics.orbit import Orbit
from dynamics.plant import LinearPlant, Plant
from sato.former.models import AnyModel, PointMasses, Relative
from sato.former.orbital import Chief, PlantTable
from sato.former.refusal import Refusal, listed

ORBITAL = get_args(Relative.model_fields["kind"].annotation)
FAR_FROM_POLES = 0.3  # |cos θ| from which on velocities out of the plane are not large
ANOMALIES = np.arange(-180, 180, 5)  # that are tried where another would do [deg]


class World(NamedTuple):
    """What a scenario says of where it takes place."""

    moves: AnyModel
    chief: Chief | None
    plant: PlantTable

    @property
    def orbit(self) -> Orbit | None:
        """The chief's, where there is one."""
        return None if self.chief is None else self.chief.orbit

    @property
    def as_planned(self) -> bool:
        """Whether the vehicles do exactly what the shared model says."""
        return self.plant.kind == "model" or self.chief is None

    def model(self) -> LinearModel:
        """What all agents share, and auctions price by."""
        if isinstance(self.moves, PointMasses):
            return DoubleIntegrator(self.moves.dimension)
        assert self.chief is not None
        return self.moves.about(self.chief.orbit)

    def nonlinear(self) -> J2 | None:
        """What agents re-linearise about their own paths; nothing where the model is the truth."""
        if self.chief is None or not isinstance(self.moves, Relative) or self.as_planned:
            return None
        again = self.moves.kind == "j2" and self.moves.relinearise
        return J2(self.chief.orbit) if again else None

    def truth(self, model: LinearModel, agents: int, rng: np.random.Generator) -> Plant | None:
        """What the vehicles really do; draws their ballistic coefficients where they differ."""
        if self.chief is None:
            return None
        if self.as_planned:
            return LinearPlant(model, self.chief.orbit)
        if not self.plant.drag:
            return InertialPlant(self.chief.orbit)
        usual = self.plant.ballistic_m2_kg
        assert usual is not None
        own = self.plant.chief_ballistic_m2_kg
        return InertialPlant(
            self.chief.orbit,
            ballistic_coefficient=usual
            * (1 + self.plant.ballistic_spread * rng.uniform(-1, 1, agents)),
            chief_ballistic_coefficient=usual if own is None else own,
            atmosphere=_air(self.plant, self.chief),
        )

    def resting(
        self, placed: Float[Array, "k d"], t: float, where: str, all_times: tuple[float, ...]
    ) -> Float[Array, "k d"]:
        """Velocities with which vehicles stay about where they are.

        At rest, or J2-invariant about a chief: the same for every model, so that runs with
        different models can be compared.

        Args:
            placed: Where they are at t [m].
            t: When [s].
            where: The table that asks for it.
            all_times: When velocities are asked for in this scenario, to say what would do [s].

        Raises:
            Refusal: They are out of the chief's plane where no velocity keeps them there.
        """
        if self.chief is None:
            return np.zeros_like(placed)
        try:
            return invariant_velocity(self.chief.orbit, placed, t)
        except ValueError as error:
            latitude = np.degrees(self.chief.orbit.elements_at(t)[5]) % 360
            raise Refusal(
                where,
                f"lies out of the plane of the chief's orbit, and {t:g} s after the start the "
                f"chief is at {latitude:.4g}° of argument of latitude, too near 90° or 270° for "
                f"any velocity to keep vehicles there; {elsewhere(self.chief, all_times)}",
            ) from error


def check_kinds(data: dict[str, Any]) -> None:
    """A model about an orbit has a chief, and a chief has such a model.

    Asked before the tables are read, for keys of one kind of model mean nothing to another.

    Raises:
        Refusal: One is there without the other.
    """
    model = data.get("model")
    kind = model.get("kind") if isinstance(model, dict) else None
    if kind in ORBITAL and "chief" not in data:
        raise Refusal(
            "model.kind",
            f'"{kind}" moves about an orbit in three axes, and this scenario has none; a [chief] '
            "with semi_major_axis_km = 6878, say, and a swarm in space would do, as the scenario "
            'orbit has them, or here kind = "double_integrator"',
        )
    if kind == "double_integrator" and "chief" in data:
        others = listed(f'"{name}"' for name in ORBITAL)
        raise Refusal(
            "model.kind",
            f'"{kind}" knows no orbit, and this scenario has a [chief]; {others} would do',
        )


def check_world(world: World) -> None:
    """Refuse a plant that cannot be.

    Raises:
        Refusal: It flies about no chief, or in air that is not known.
    """
    if world.chief is None and (world.plant.kind == "inertial" or world.plant.drag):
        key = "plant.kind" if world.plant.kind == "inertial" else "plant.drag"
        raise Refusal(
            key,
            "takes place about the Earth, and this scenario has no [chief]; one with "
            'semi_major_axis_km = 6878, say, would do, or plant.kind = "model" without drag',
        )
    if world.chief is not None and world.plant.drag:
        _air(world.plant, world.chief)


def _air(plant: PlantTable, chief: Chief) -> Atmosphere:
    if plant.density_kg_m3 is None or plant.altitude_m is None or plant.scale_height_m is None:
        try:
            return Atmosphere.from_altitude(chief.perigee)
        except ValueError as error:
            raise Refusal("plant.drag", f"finds no air at the chief's perigee: {error}") from error
    return Atmosphere(plant.density_kg_m3, plant.altitude_m, plant.scale_height_m)


def elsewhere(chief: Chief, times: tuple[float, ...]) -> str:
    """Where along its orbit a chief would let vehicles stay out of its plane at these times [s]."""
    flat = "places in the plane (z = 0)"
    if chief.semi_major_axis_m is None:
        return f"another start along the orbit would do, or {flat}"

    def least(degrees: float) -> float:
        moved = chief.model_copy(update={"anomaly_rad": float(np.radians(degrees))})
        return float(np.abs(np.cos(moved.orbit.elements_at(np.array(times))[:, 5])).min())

    best = max(ANOMALIES.tolist(), key=least)
    if least(best) < FAR_FROM_POLES:
        return f"shorter legs and another chief.anomaly_deg would do, or {flat}"
    return f"chief.anomaly_deg = {best} would do, or {flat}"
