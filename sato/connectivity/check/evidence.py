"""What a run file holds, as arrays, beside the mission that its own text describes."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.check.happened import Happened
from sato.connectivity.distance import to_each_other, to_obstacles
from sato.connectivity.mission import ConnectivityFlight

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class Evidence:
    """A run as recorded, and the mission rebuilt from its scenario."""

    mission: ConnectivityFlight
    attributes: dict[str, Any]
    time: Float[Array, " instants"]
    position: Float[Array, "instants agents 3"]
    velocity: Float[Array, "instants agents 3"]
    alive: Bool[Array, "instants agents"]
    component: Int[Array, "instants agents"]
    command: Float[Array, "instants agents 3"]
    turn: Float[Array, "instants agents"]
    yaw: Float[Array, "instants agents"]
    lambda2: Float[Array, " instants"]
    lambda3: Float[Array, " instants"]
    estimate: Float[Array, "instants agents"]
    weight: Float[Array, "instants agents agents"]
    yaw_error: Float[Array, "instants agents agents"]
    sees: Bool[Array, "instants agents agents"]
    stick: Float[Array, "instants 3"]
    happened: Happened

    @classmethod
    def of(cls, data: "xarray.Dataset", mission: ConnectivityFlight) -> "Evidence":
        """Read a run's data."""

        def numbers(name: str) -> Array:
            return np.asarray(data[name], dtype=float)

        return cls(
            mission=mission,
            attributes={str(k): v for k, v in data.attrs.items()},
            time=numbers("time"),
            position=numbers("position"),
            velocity=numbers("velocity"),
            alive=np.asarray(data["alive"], dtype=bool),
            component=np.asarray(data["component"]),
            command=numbers("velocity_command"),
            turn=numbers("yaw_rate"),
            yaw=numbers("yaw"),
            lambda2=numbers("lambda2"),
            lambda3=numbers("lambda3"),
            estimate=numbers("lambda2_estimate"),
            weight=numbers("edge_weight"),
            yaw_error=numbers("yaw_estimate_error"),
            sees=np.asarray(data["visibility"], dtype=bool),
            stick=numbers("stick"),
            happened=Happened.of(data),
        )

    @cached_property
    def to_robots(self) -> float:
        """Least distance of two robots, between instants too; infinite for one [m]."""
        return to_each_other(self.position, self.alive)

    @cached_property
    def to_obstacles(self) -> float:
        """Least distance of a robot to an obstacle at an instant; infinite without any [m]."""
        away = to_obstacles(self.position, self.mission.obstacles)
        return float(away[self.alive].min(initial=np.inf))

    @cached_property
    def waypoints(self) -> int:
        """How many waypoints the leader has reached."""
        return len(self.happened.told("waypoint"))
