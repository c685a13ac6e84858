"""Run of a connectivity mission as recorded, and quantities that follow from it."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.quadrotor import Quadrotor
from dynamics.vehicle import VehicleState, rotate_by_yaw
from sato.check.event_log import EventLog
from sato.connectivity.distance import min_obstacle_distance, min_separation
from sato.connectivity.loop import advance_vehicles, vehicles_at_rest
from sato.connectivity.mission import Connectivity
from sato.connectivity.record import ConnectivityFrame
from sato.connectivity.sensors import CameraViews, compute_views
from sato.record import read_frames

if TYPE_CHECKING:
    import xarray

MAX_BATCH = 1_000_000  # pairs, with what may hide one from the other, of one computation


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
    def total_command(self) -> Float[Array, "instants agents 4"]:
        """Commanded velocity in the body frame, of the leader with the stick, and yaw rate."""
        frames = self.frames
        command = np.concatenate([frames.velocity_command, frames.yaw_rate[..., None]], axis=2)
        command[:, 0, :3] += rotate_by_yaw(frames.stick, -frames.yaw[:, 0])
        return command

    @cached_property
    def replay(self) -> VehicleState | None:
        """Flight of the recorded commands from the start, at every instant; of quadrotors alone."""
        if not isinstance(self.mission.plant, Quadrotor):
            return None
        states, rng = [vehicles_at_rest(self.mission)], np.random.default_rng()
        for alive, command in zip(self.frames.alive[:-1], self.total_command, strict=False):
            states.append(advance_vehicles(states[-1], alive, command, self.mission, rng))
        return VehicleState(*(np.array(part) for part in zip(*states, strict=True)))

    @cached_property
    def views(self) -> CameraViews:
        """Views of all cameras at the recorded poses, tilted as replayed."""
        frames, replay = self.frames, self.replay
        still = np.zeros_like(frames.position)
        tilt = still if replay is None else replay.acceleration
        vehicles = VehicleState(frames.position, frames.yaw, still, frames.yaw_rate, tilt)
        found = []
        count = max(1, MAX_BATCH // frames.alive.shape[1] ** 3)
        for first in range(0, len(frames.time), count):
            part = slice(first, first + count)
            now = VehicleState(*(values[part] for values in vehicles))
            found.append(compute_views(now, frames.alive[part], self.mission))
        return CameraViews(*(np.concatenate(part) for part in zip(*found, strict=True)))

    @property
    def waypoints_reached(self) -> int:
        """Number of waypoints that the leader has reached."""
        return len(self.events.of_kind("waypoint"))
