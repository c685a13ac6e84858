"""What a run file holds, as arrays, beside the mission that its own text describes."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy import ndarray as Array

from problems.gains import Gains
from sato.check.happened import Happened
from sato.formation.check.closest import Closest, closest
from sato.formation.check.replay import Replay, replay
from sato.formation.log import PARTS
from sato.formation.mission import FormationFlight

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class Evidence:
    """A run as recorded, and the mission rebuilt from its scenario."""

    mission: FormationFlight
    attributes: dict[str, Any]
    time: Float[Array, " instants"]
    position: Float[Array, "instants agents 3"]
    velocity: Float[Array, "instants agents 3"]
    alive: Bool[Array, "instants agents"]
    component: Int[Array, "instants agents"]
    command: Float[Array, "instants agents 3"]
    avoiding: Bool[Array, "instants agents"]
    point: Int[Array, "instants agents"]
    leg: Int[Array, " instants"]
    drift: Float[Array, "instants agents 3"]
    yaw: Float[Array, " agents"]
    offset: Float[Array, "agents 3"]
    formation: Float[Array, "legs points 3"]
    graph: Bool[Array, "legs points points"]
    xy: Complex[Array, "legs points points"]
    z: Float[Array, "legs points points"]
    happened: Happened

    @classmethod
    def of(cls, data: "xarray.Dataset", mission: FormationFlight) -> "Evidence":
        """Read a run's data."""

        def numbers(name: str) -> Array:
            return np.asarray(data[name], dtype=float)

        parts = data["gains"].sel(part=list(PARTS))
        real, imaginary, z = np.moveaxis(np.asarray(parts, dtype=float), 1, 0)
        return cls(
            mission=mission,
            attributes={str(k): v for k, v in data.attrs.items()},
            time=numbers("time"),
            position=numbers("position"),
            velocity=numbers("velocity"),
            alive=np.asarray(data["alive"], dtype=bool),
            component=np.asarray(data["component"]),
            command=numbers("velocity_command"),
            avoiding=np.asarray(data["avoiding"], dtype=bool),
            point=np.asarray(data["point"]),
            leg=np.asarray(data["leg"]),
            drift=numbers("frame_drift"),
            yaw=numbers("frame_yaw"),
            offset=numbers("frame_offset"),
            formation=numbers("formation"),
            graph=np.asarray(data["graph"], dtype=bool),
            xy=real + 1j * imaginary,
            z=z,
            happened=Happened.of(data),
        )

    @cached_property
    def replay(self) -> Replay:
        """How the flight had to go by the commands and the avoidance on file."""
        rounds = [int(e["rounds"]) for _, e in self.happened.told("auction")]
        return replay(self.mission, self.command, self.avoiding, rounds)

    @cached_property
    def closest(self) -> Closest:
        """The closest two vehicles in the plane, on the lines between the instants."""
        return closest(self.position[..., :2])

    def gains(self, leg: int) -> Gains:
        """The gains on file, of the scenario's own formation.

        Raises:
            ValueError: They are not stable gains of it.
        """
        formation = self.mission.shapes[leg].formation
        return Gains(formation, self.xy[leg], self.z[leg], "on file", np.inf, np.inf)
