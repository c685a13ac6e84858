"""What a run file holds, as arrays, beside the mission that its own text describes."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.quadrotor import Quadrotor
from sato.check.happened import Happened
from sato.connectivity.check.replay import Flown, Views, flown, views
from sato.connectivity.distance import past_obstacles, to_each_other
from sato.connectivity.log import rotated
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
        """Least distance of a robot to an obstacle, between instants too; infinite without [m]."""
        return past_obstacles(self.position, self.alive, self.mission.obstacles)

    @cached_property
    def asked(self) -> Float[Array, "instants agents 3"]:
        """Velocity asked of each robot, in its body frame: of the leader, with the stick [m/s]."""
        asked = self.command.copy()
        asked[:, 0] += rotated(self.stick, -self.yaw[:, 0])
        return asked

    @cached_property
    def again(self) -> Flown | None:
        """What was asked, flown once more from the recorded start; none but for quadrotors."""
        plant, step = self.mission.plant, self.mission.step
        if not isinstance(plant, Quadrotor):
            return None
        p, yaw = self.position[0], self.yaw[0]
        return flown(p, yaw, self.asked, self.turn, self.alive, plant, step)

    @cached_property
    def views(self) -> Views:
        """Who has whom in sight, by the recorded poses, and the tilt of what flew once more."""
        push = np.zeros_like(self.position) if self.again is None else self.again.push
        return views(self.position, self.yaw, push, self.alive, self.mission)

    @cached_property
    def waypoints(self) -> int:
        """How many waypoints the leader has reached."""
        return len(self.happened.told("waypoint"))
