"""Cameras and range sensors: the only readers of the truth."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.quadrotor import Quadrotor, rotate_to_heading_frame
from dynamics.vehicle import VehicleState, rotate_by_yaw, vector_lengths
from problems.interaction_graph import bearings, cosine_ramp, range_weight
from sato.connectivity.mission import Connectivity
from sato.connectivity.obstacles import (
    blocks_line_of_sight,
    nearest_points,
    obstacle_distances,
    segments_hit_balls,
)
from sato.connectivity.state import Measurements


class CameraViews(NamedTuple):
    """Views of all cameras, at one instant or at many."""

    weight: Float[Array, "*k n n"]  # true A_ij
    view_cosine: Float[Array, "*k n n"]  # of j to the axis of i; −∞ out of range or hidden
    relative_position: Float[Array, "*k n n 3"]  # p_ij in the body frame of i [m]


def compute_views(
    vehicles: VehicleState, alive: Bool[Array, "*k n"], mission: Connectivity
) -> CameraViews:
    """Compute the view of every camera; those that are alive see, are seen and block the view."""
    position, yaw, camera = vehicles.position, vehicles.yaw, mission.camera
    distance, bearing = bearings(position, yaw)
    axis = np.array(camera.optical_axis)
    if isinstance(mission.plant, Quadrotor):
        axis = rotate_to_heading_frame(axis, vehicles.acceleration, yaw)[..., None, :]
    is_clear = (camera.d_min < distance) & (distance < camera.d_max)
    is_clear &= alive[..., None] & alive[..., None, :]
    if mission.occlusion:
        is_clear &= ~_is_occluded(position, alive, mission)
    cosine = np.where(is_clear, np.vecdot(axis, bearing), -np.inf)
    f = cosine_ramp(cosine, camera.a_min, camera.a_max)
    g = f.swapaxes(-1, -2)
    weight = range_weight(distance, camera) * (f + g - f * g)
    return CameraViews(weight, cosine, distance[..., None] * bearing)


def measure(
    vehicles: VehicleState,
    views: CameraViews,
    alive: Bool[Array, " n"],
    before: Measurements,
    mission: Connectivity,
    rng: np.random.Generator,
) -> Measurements:
    """Measure with the sensors of all agents.

    Args:
        vehicles: True state of all agents.
        views: Views of their cameras.
        alive: True for agents that measure.
        before: Measurements of a step ago.
        mission: Drawn mission.
        rng: Draws the noise of the cameras.
    """
    sees = views.view_cosine > mission.assumed_camera.a_min
    p = np.where(sees[..., None], views.relative_position, np.nan)
    if mission.camera_noise > 0:
        # Drawn pair by pair: for i what j < i sees of it comes after what it sees of j.
        low, high = np.tril_indices(len(alive), -1)
        i, j = np.stack([low, high], axis=1).ravel(), np.stack([high, low], axis=1).ravel()
        i, j = i[sees[i, j]], j[sees[i, j]]
        p[i, j] += mission.camera_noise * rng.standard_normal((len(i), 3))
    near = _measure_ranges(vehicles, alive, mission)
    return Measurements(vehicles.velocity, vehicles.yaw_rate, p, before.relative_position, near)


def _measure_ranges(
    vehicles: VehicleState, alive: Bool[Array, " n"], mission: Connectivity
) -> Float[Array, "n points 3"]:
    # Nearest points of agents and obstacles in range, without telling which is which.
    position, n, obstacles = vehicles.position, len(alive), mission.obstacle_arrays
    others = np.broadcast_to(position, (n, n, 3))
    away = np.where(alive, vector_lengths(others - position[:, None]), np.inf)
    np.fill_diagonal(away, np.inf)
    to_obstacles, of_obstacles = obstacle_distances(position, obstacles), np.empty((n, 0, 3))
    if (to_obstacles < mission.repulsion.max_distance).any():
        of_obstacles = nearest_points(position, obstacles)
    points = np.concatenate([others, of_obstacles], axis=1)
    distance = np.concatenate([away, to_obstacles], axis=1)[:, : points.shape[1]]
    is_near = (distance < mission.repulsion.max_distance) & alive[:, None]
    local = rotate_by_yaw(points - position[:, None], -vehicles.yaw[:, None])
    return np.where(is_near[..., None], local, np.nan)


def _is_occluded(
    position: Float[Array, "*k n 3"], alive: Bool[Array, "*k n"], mission: Connectivity
) -> Bool[Array, "*k n n"]:
    # True where another live agent or an obstacle is between two agents.
    p, q = position[..., :, None, :], position[..., None, :, :]
    others = position[..., None, None, :, :]
    hits = segments_hit_balls(p[..., None, :], q[..., None, :], others, mission.body_radius)
    own = np.eye(alive.shape[-1], dtype=bool)
    hits &= alive[..., None, None, :] & ~own[:, None] & ~own
    hidden = np.tril(hits.any(axis=-1) | blocks_line_of_sight(p, q, mission.obstacle_arrays))
    return np.asarray(hidden | hidden.swapaxes(-1, -2))
