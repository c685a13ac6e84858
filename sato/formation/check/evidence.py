"""What a run file holds, as arrays, beside the mission that its own text describes."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Complex, Float, Int
from numpy import ndarray as Array

from problems.gain_matrix import GainMatrix
from sato.check.event_log import EventLog
from sato.formation.check.closest import ClosestPair, find_closest_approach
from sato.formation.check.replay import Replay, replay
from sato.formation.mission import Formation
from sato.formation.record import GAIN_PARTS

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class FormationRecord:
    """A run as recorded, and the mission rebuilt from its scenario."""

    mission: Formation
    attributes: dict[str, Any]
    time: Float[Array, " instants"]
    position: Float[Array, "instants agents 3"]
    velocity: Float[Array, "instants agents 3"]
    alive: Bool[Array, "instants agents"]
    component: Int[Array, "instants agents"]
    velocity_command: Float[Array, "instants agents 3"]
    avoiding: Bool[Array, "instants agents"]
    assignment: Int[Array, "instants agents"]
    leg: Int[Array, " instants"]
    frame_drift: Float[Array, "instants agents 3"]
    frame_yaw: Float[Array, " agents"]
    frame_origin: Float[Array, "agents 3"]
    formation_points: Float[Array, "legs points 3"]
    graph: Bool[Array, "legs points points"]
    gains_xy: Complex[Array, "legs points points"]
    gains_z: Float[Array, "legs points points"]
    events: EventLog

    @classmethod
    def from_dataset(cls, data: "xarray.Dataset", mission: Formation) -> "FormationRecord":
        """Read a run's data."""

        def numbers(name: str) -> Array:
            return np.asarray(data[name], dtype=float)

        parts = data["gains"].sel(part=list(GAIN_PARTS))
        real, imaginary, z = np.moveaxis(np.asarray(parts, dtype=float), 1, 0)
        return cls(
            mission=mission,
            attributes={str(k): v for k, v in data.attrs.items()},
            time=numbers("time"),
            position=numbers("position"),
            velocity=numbers("velocity"),
            alive=np.asarray(data["alive"], dtype=bool),
            component=np.asarray(data["component"]),
            velocity_command=numbers("velocity_command"),
            avoiding=np.asarray(data["avoiding"], dtype=bool),
            assignment=np.asarray(data["point_index"]),
            leg=np.asarray(data["leg_index"]),
            frame_drift=numbers("frame_drift"),
            frame_yaw=numbers("frame_yaw"),
            frame_origin=numbers("frame_offset"),
            formation_points=numbers("formation"),
            graph=np.asarray(data["graph"], dtype=bool),
            gains_xy=real + 1j * imaginary,
            gains_z=z,
            events=EventLog.from_dataset(data),
        )

    @cached_property
    def replay(self) -> Replay:
        """How the flight had to go by the commands and the avoidance on file."""
        rounds = [int(e["rounds"]) for _, e in self.events.of_kind("auction")]
        return replay(self.mission, self.velocity_command, self.avoiding, rounds)

    @cached_property
    def closest_approach(self) -> ClosestPair:
        """The closest two vehicles in the plane, on the lines between the instants."""
        return find_closest_approach(self.position[..., :2])

    def load_gains(self, leg: int) -> GainMatrix:
        """The gains on file, of the scenario's own formation.

        Raises:
            ValueError: They are not stable gains of it.
        """
        formation = self.mission.gains[leg].formation
        return GainMatrix(
            formation, self.gains_xy[leg], self.gains_z[leg], "on file", np.inf, np.inf
        )
