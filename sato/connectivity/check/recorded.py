"""Run of a connectivity mission as recorded, and quantities that follow from it."""

from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Shaped
from numpy import ndarray as Array

from dynamics.kinematic import KinematicVehicle
from dynamics.vehicle import VehicleState, rotate_by_yaw
from sato.check import common
from sato.connectivity.loop import advance_vehicles
from sato.connectivity.mission import Connectivity
from sato.connectivity.obstacles import min_obstacle_distance
from sato.connectivity.sensors import CameraViews, compute_views
from sato.connectivity.settings import MAX_ROW_AGE
from sato.record import RunRecord

SETTLING_TIME = 2.0  # in which commands of the start die away [s]
COMMAND_QUANTILE = 0.999  # of the changes of commands; the largest few are left out
JUMP_SHARE = 0.1  # of the largest speed: a change of a command in a step that is a jump
MAX_BATCH = 1_000_000  # pairs, with what may hide one from the other, of one computation


class ConnectivityRecord(RunRecord[Connectivity, Any, None]):
    """Frames of a run, with time as their leading axis, and its drawn mission."""

    @cached_property
    def closest_pair(self) -> common.ClosestPair:
        """Closest two agents, between instants too; infinitely far for one."""
        return common.find_closest_approach(self.frames.position, self.frames.alive)

    @cached_property
    def min_obstacle_distance(self) -> float:
        """Least distance of an agent to an obstacle, between instants too [m]."""
        obstacles = self.mission.obstacle_arrays
        return min_obstacle_distance(self.frames.position, self.frames.alive, obstacles)

    @cached_property
    def chattering(self) -> float:
        """Share of the followers' commands that jump by a tenth of the limit, and back at once.

        NaN in the first second, in which robots hear of each other.
        """
        first = round(MAX_ROW_AGE / self.mission.step)
        change = np.diff(self.frames.velocity_command[first:, 1:], axis=0)
        is_live = self.frames.alive[:, 1:].all(axis=0)
        jumps = np.linalg.norm(change, axis=2) > JUMP_SHARE * self.mission.limits.speed
        is_back = np.vecdot(change[1:], change[:-1]) < 0
        return _mean(jumps[1:] & jumps[:-1] & is_back, np.broadcast_to(is_live, is_back.shape))

    @cached_property
    def command_change(self) -> float:
        """Change of a follower's command that 99.9 % of those after 2 s do not exceed, or NaN."""
        frames, first = self.frames, round(SETTLING_TIME / self.mission.step)
        change = np.diff(frames.velocity_command[first:, 1:], axis=0)
        size = np.linalg.norm(change, axis=2)[frames.alive[first + 1 :, 1:]]
        return float(np.quantile(size, COMMAND_QUANTILE)) if size.size else np.nan

    @cached_property
    def paths(self) -> tuple[Float[Array, " steps"], Float[Array, " steps"]]:
        """Paths of the leader and of the live followers' centroid in each step [m]."""
        step, live = np.diff(self.frames.position, axis=0), self.frames.alive[1:, 1:]
        share = live / np.maximum(live.sum(axis=1, keepdims=True), 1)
        centroid = np.einsum("ti,tik->tk", share, step[:, 1:])
        return np.linalg.norm(step[:, 0], axis=1), np.linalg.norm(centroid, axis=1)

    @property
    def followed(self) -> float:
        """Path of the followers' centroid over the leader's while the stick is held, or NaN."""
        is_held = self.frames.stick[:-1].any(axis=1)
        leader, followers = (float(path[is_held].sum()) for path in self.paths)
        return followers / leader if leader > 0 else np.nan

    @property
    def noise_std(self) -> float:
        """Standard deviation of the noise of velocities in a step [m/s, rad/s]."""
        plant = self.mission.plant
        return plant.noise_std if isinstance(plant, KinematicVehicle) else 0.0

    @cached_property
    def replay(self) -> VehicleState:
        """Flight of the recorded commands from the start, at every instant.

        A plant with noise is replayed step by step. The noise of a step is then what the
        recorded velocity and yaw differ by from those replayed, and the position is replayed
        with it, but for agents that were lost: what they had of velocity is not recorded.
        """
        frames, mission = self.frames, self.mission
        command = np.concatenate([frames.velocity_command, frames.yaw_rate[..., None]], axis=2)
        command[:, 0, :3] += rotate_by_yaw(frames.stick, -frames.yaw[:, 0])
        velocity = rotate_by_yaw(frames.velocity, -frames.yaw)
        state = VehicleState.at_rest(frames.position[0], frames.yaw[0])
        found, no_noise = [state], np.zeros_like(command[0])
        for k in range(1, len(frames.time)):
            given = frames.alive[k - 1], command[k - 1]
            flown = state
            state = advance_vehicles(flown, *given, no_noise, mission)
            if self.noise_std > 0:
                turned = (frames.yaw[k] - state.yaw) / mission.step
                noise = np.column_stack([velocity[k] - state.velocity, turned])
                noise[~frames.alive[k], :3] = 0.0
                noisy = advance_vehicles(flown, *given, noise, mission)
                found.append(state._replace(position=noisy.position))
                state = noisy._replace(position=frames.position[k])
            else:
                found.append(state)
        return VehicleState(*(np.array(part) for part in zip(*found, strict=True)))

    @cached_property
    def views(self) -> CameraViews:
        """Views of all cameras at the recorded poses, tilted as replayed."""
        vehicles = self.replay._replace(position=self.frames.position, yaw=self.frames.yaw)
        found, count = [], max(1, MAX_BATCH // self.frames.alive.shape[1] ** 3)
        for first in range(0, len(self.frames.time), count):
            part = slice(first, first + count)
            now = VehicleState(*(values[part] for values in vehicles))
            found.append(compute_views(now, self.frames.alive[part], self.mission))
        return CameraViews(*(np.concatenate(part) for part in zip(*found, strict=True)))

    def summarize(self) -> dict[str, Any]:
        """Summarize a run; quantities without a value are absent."""
        frames, lambda2_min = self.frames, float(self.frames.lambda2.min())
        sees, is_seen = frames.visibility, frames.visibility.transpose(0, 2, 1)
        lambda2_error = np.abs(frames.lambda2_estimate - frames.lambda2[:, None])
        yaw_error = np.abs(np.sin(frames.yaw_estimate_error / 2))  # as in [Bernard2023, Fig. 7]
        summary = common.common_summary(self.attributes, frames.alive) | {
            "lambda2_min": lambda2_min,
            "lambda2_error_mean": _mean(lambda2_error, frames.alive & np.isfinite(lambda2_error)),
            "yaw_error_mutual": _mean(yaw_error, sees & is_seen),
            "yaw_error_one_sided": _mean(yaw_error, sees & ~is_seen),
            "followed": self.followed,
            "command_change_m_s": self.command_change,
            "chattering": self.chattering,
            "min_separation_m": self.closest_pair.distance,
            "min_obstacle_distance_m": self.min_obstacle_distance,
            "edges_mean": float(np.triu(frames.edge_weight > 0).sum(axis=(1, 2)).mean()),
            "waypoints_reached": len(self.events.of_kind("waypoint")),
            "waypoints": len(self.mission.stick.waypoints),
        }
        return common.drop_non_finite(summary)


def _mean(values: Shaped[Array, "*k"], which: Bool[Array, "*k"]) -> float:
    return float(values[which].mean()) if which.any() else np.nan
