"""Run of a connectivity mission as recorded, and quantities that follow from it."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
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
from sato.connectivity.record import ConnectivityFrame, rotate_by_yaw
from sato.record import read_frames

if TYPE_CHECKING:
    import xarray


@dataclass(frozen=True, eq=False)
class ConnectivityRecord:
    """Frames of a run, with time as their leading axis, and its drawn mission."""

    mission: Connectivity
    attributes: dict[str, Any]
    frames: Any  # ConnectivityFrame with time as the leading axis of each field
    events: EventLog

    @classmethod
    def from_dataset(cls, data: "xarray.Dataset", mission: Connectivity) -> "ConnectivityRecord":
        """Read the data of a run."""
        attributes = {str(name): value for name, value in data.attrs.items()}
        frames = read_frames(ConnectivityFrame, data)
        return cls(mission, attributes, frames, EventLog.from_dataset(data))

    @cached_property
    def min_separation(self) -> float:
        """Least distance of two agents, between instants too; infinite for one [m]."""
        return min_separation(self.frames.position, self.frames.alive)

    @cached_property
    def min_obstacle_distance(self) -> float:
        """Least distance of an agent to an obstacle, between instants too [m]."""
        obstacles = self.mission.obstacle_arrays
        return min_obstacle_distance(self.frames.position, self.frames.alive, obstacles)

    @cached_property
    def total_command(self) -> Float[Array, "instants agents 3"]:
        """Commanded velocity in the body frame, of the leader with the stick [m/s]."""
        command = np.array(self.frames.velocity_command)
        command[:, 0] += rotate_by_yaw(self.frames.stick, -self.frames.yaw[:, 0])
        return command

    @cached_property
    def replay(self) -> QuadrotorReplay | None:
        """Flight of the recorded commands from the recorded start; None but for quadrotors."""
        plant, frames = self.mission.plant, self.frames
        if not isinstance(plant, Quadrotor):
            return None
        return replay_quadrotors(
            frames.position[0], frames.yaw[0], self.total_command, frames.yaw_rate, frames.alive,
            plant, self.mission.step,
        )  # fmt: skip

    @cached_property
    def views(self) -> CameraViews:
        """Views of all cameras at the recorded poses, tilted as replayed."""
        frames, replay = self.frames, self.replay
        acceleration = np.zeros_like(frames.position) if replay is None else replay.acceleration
        return compute_views(frames.position, frames.yaw, acceleration, frames.alive, self.mission)

    @property
    def waypoints_reached(self) -> int:
        """Number of waypoints that the leader has reached."""
        return len(self.events.of_kind("waypoint"))
