"""What a run file holds, as arrays, beside the mission that its own text describes."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.quadrotor import Quadrotor
from sato.check.event_log import EventLog
from sato.connectivity.check.replay import (
    CameraViews,
    QuadrotorReplay,
    compute_views,
    replay_quadrotors,
)
from sato.connectivity.distance import min_obstacle_distance, min_separation
from sato.connectivity.mission import Connectivity
from sato.connectivity.record import rotate_by_yaw

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class ConnectivityRecord:
    """A run as recorded, and the mission rebuilt from its scenario."""

    mission: Connectivity
    attributes: dict[str, Any]
    time: Float[Array, " instants"]
    position: Float[Array, "instants agents 3"]
    velocity: Float[Array, "instants agents 3"]
    alive: Bool[Array, "instants agents"]
    component: Int[Array, "instants agents"]
    velocity_command: Float[Array, "instants agents 3"]
    yaw_rate_command: Float[Array, "instants agents"]
    yaw: Float[Array, "instants agents"]
    lambda2: Float[Array, " instants"]
    lambda3: Float[Array, " instants"]
    lambda2_estimate: Float[Array, "instants agents"]
    edge_weight: Float[Array, "instants agents agents"]
    yaw_estimate_error: Float[Array, "instants agents agents"]
    visibility: Bool[Array, "instants agents agents"]
    stick: Float[Array, "instants 3"]
    events: EventLog

    @classmethod
    def from_dataset(cls, data: "xarray.Dataset", mission: Connectivity) -> "ConnectivityRecord":
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
            velocity_command=numbers("velocity_command"),
            yaw_rate_command=numbers("yaw_rate"),
            yaw=numbers("yaw"),
            lambda2=numbers("lambda2"),
            lambda3=numbers("lambda3"),
            lambda2_estimate=numbers("lambda2_estimate"),
            edge_weight=numbers("edge_weight"),
            yaw_estimate_error=numbers("yaw_estimate_error"),
            visibility=np.asarray(data["visibility"], dtype=bool),
            stick=numbers("stick"),
            events=EventLog.from_dataset(data),
        )

    @cached_property
    def min_separation(self) -> float:
        """Least distance of two robots, between instants too; infinite for one [m]."""
        return min_separation(self.position, self.alive)

    @cached_property
    def min_obstacle_distance(self) -> float:
        """Least distance of a robot to an obstacle, between instants too; infinite without [m]."""
        return min_obstacle_distance(self.position, self.alive, self.mission.obstacle_arrays)

    @cached_property
    def total_command(self) -> Float[Array, "instants agents 3"]:
        """Velocity asked of each robot, in its body frame: of the leader, with the stick [m/s]."""
        asked = self.velocity_command.copy()
        asked[:, 0] += rotate_by_yaw(self.stick, -self.yaw[:, 0])
        return asked

    @cached_property
    def replay(self) -> QuadrotorReplay | None:
        """What was asked, flown once more from the recorded start; none but for quadrotors."""
        plant, step = self.mission.plant, self.mission.step
        if not isinstance(plant, Quadrotor):
            return None
        p, yaw = self.position[0], self.yaw[0]
        return replay_quadrotors(
            p, yaw, self.total_command, self.yaw_rate_command, self.alive, plant, step
        )

    @cached_property
    def views(self) -> CameraViews:
        """Who has whom in sight, by the recorded poses, and the tilt of what flew once more."""
        push = np.zeros_like(self.position) if self.replay is None else self.replay.acceleration
        return compute_views(self.position, self.yaw, push, self.alive, self.mission)

    @cached_property
    def waypoints_reached(self) -> int:
        """How many waypoints the leader has reached."""
        return len(self.events.of_kind("waypoint"))
