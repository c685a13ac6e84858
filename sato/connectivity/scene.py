"""Scene of a connectivity mission, as viewers show it."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.mission import Connectivity
from sato.connectivity.obstacles import Plane
from sato.figures.style import BLUE, ORANGE
from sato.run_data import RunData
from sato.scene import (
    ALIVE,
    LOST,
    Coloring,
    Hull,
    Links,
    Series,
    SwarmScene,
    Targets,
    color_by_component,
    color_by_speed,
    enclose_obstacle,
    least_over_agents,
    nearest_distances,
)

PLANE_MARGIN = 0.2  # of a drawn plane beyond the flight, in its size


def make_scene(data: RunData, mission: Connectivity) -> SwarmScene:
    """Make the scene of a run; links are the edges of positive weight."""
    record = ConnectivityRecord.from_data(data, mission)
    frames, alive = record.frames, record.frames.alive
    nearest, limit = nearest_distances(frames.position, alive), mission.repulsion.min_distance
    role = np.where(alive, np.arange(alive.shape[1]) > 0, np.nan)
    estimate = np.where(alive, frames.lambda2_estimate, np.nan)
    return SwarmScene(
        time=record.time,
        position=frames.position,
        velocity=frames.velocity,
        status=np.where(alive, ALIVE, LOST),
        diameter=np.full(alive.shape[1], limit),
        links=Links("edges of positive weight", listed=tuple(_list_edges(record))),
        targets=_collect_waypoints(record),
        colorings=(
            Coloring("role", role, "", (("leader", ORANGE), ("follower", BLUE))),
            color_by_component(frames.component),
            Coloring("separation", nearest, "m"),
            color_by_speed(frames.velocity, alive),
            Coloring("own estimate of λ₂", estimate),
        ),
        series=(
            Series("least separation", "m", least_over_agents(nearest), limit, "nearest allowed"),
            Series("λ₂", "", frames.lambda2, mission.potential.lambda2_min, "least allowed"),
        ),
        stages=((0.0, "flight"),),
        events=frames.events,
        obstacles=tuple(_enclose(one, frames.position) for one in mission.obstacles),
    )


def _list_edges(record: ConnectivityRecord) -> Iterator[tuple[int, Int[Array, "pairs 2"]]]:
    linked = np.triu(record.frames.edge_weight, 1) > 0
    changed = (linked[1:] != linked[:-1]).any(axis=(1, 2))
    for k in (0, *(np.flatnonzero(changed) + 1).tolist()):
        yield k, np.argwhere(linked[k])


def _collect_waypoints(record: ConnectivityRecord) -> Targets:
    """Collect the waypoints of the leader, which holds the next one that it has not reached."""
    points = np.asarray(record.mission.stick.waypoints, dtype=float).reshape(1, -1, 3)
    instants, agents = record.frames.alive.shape
    held = np.full((instants, agents), -1)
    held[:, 0] = 0
    for k, _ in record.events.of_kind("waypoint"):
        held[k:, 0] += 1
    held[held >= points.shape[1]] = -1
    return Targets("waypoint", points, np.zeros(instants, dtype=int), held)


def _enclose(obstacle: Any, position: Float[Array, "instants agents 3"]) -> Hull:
    """Return the surface of an obstacle, of a plane the part below, or beside, the flight."""
    if not isinstance(obstacle, Plane):
        return enclose_obstacle(obstacle)
    *normal, offset = obstacle.unit_normal_and_offset
    low, high = position.min(axis=(0, 1)), position.max(axis=(0, 1))
    middle, half = (low + high) / 2, (0.5 + PLANE_MARGIN) * np.linalg.norm(high - low)
    across = np.linalg.svd(np.array([normal]))[2][1:]  # two directions in the plane
    foot = middle - (middle @ normal - offset) * np.array(normal)
    square = foot + half * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) @ across
    both_sides = np.array([[0, 1, 2], [0, 2, 3], [2, 1, 0], [3, 2, 0]])
    return Hull(square, both_sides, np.zeros(3))
