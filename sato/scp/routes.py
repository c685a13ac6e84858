"""Routes around obstacles: the shortest way among them, by which an agent begins to plan.

A roadmap has points about each obstacle, a little farther away than vehicles keep, and the straight
ways between those that see each other. Dijkstra's algorithm finds the shortest way from a start to
a target. The nominal follows it at the pace of the trajectory that the agent would fly alone.
"""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from problems.obstacle_paths import ControlPath, ObstaclePaths, is_path_clear, segments_clear
from sato.obstacles import polytope_about_ball
from sato.scp.planner import Planner

ROOM = 1.02  # distance of the points from obstacles, over the clearance, at corners of their hull
NEIGHBORS = 24  # points of a roadmap that each may be linked to
MAX_ROADMAPS = 64  # that are remembered


class Roadmap(NamedTuple):
    """Points about obstacles, and the straight ways between those that see each other."""

    points: Float[Array, "points d"]
    begin: Int[Array, " ways"]
    end: Int[Array, " ways"]
    length: Float[Array, " ways"]


def go_around(agent: Planner) -> Planner:
    """Begin with the shortest way around obstacles at rest, where the solo trajectory meets any."""
    assert agent.obstacles is not None
    still = agent.obstacles.select(np.asarray(~agent.obstacles.velocity.any(axis=1)))
    alone = agent.horizon.control_points(agent.solo.x, agent.solo.u)
    if not len(still.paths) or len(agent.nominal.u) == 0 or is_path_clear(alone, still):
        return agent
    target = agent.horizon.scale_points(agent.target_state[: alone.shape[-1]])
    way = find_route(alone[0, 0], target, still)
    if way is None:
        return agent
    route = follow_route(way, alone)
    return agent._replace(route=route, control_points=route, has_converged=False)


def find_route(
    start: Float[Array, " d"], target: Float[Array, " d"], obstacles: ObstaclePaths
) -> Float[Array, "corners d"] | None:
    """Find the shortest way of straight lines around obstacles at rest; None without any."""
    ends = np.stack([start, target])
    if segments_clear(ends[:1], ends[1:], obstacles)[0]:
        return ends
    parts = obstacles.paths[:, 0, 0], obstacles.corners, obstacles.clearance
    roadmap = _remember_roadmap(*((part.tobytes(), part.shape) for part in parts))
    points = np.concatenate([roadmap.points, ends])
    n = len(roadmap.points)
    one, other = np.repeat([n, n + 1], n), np.tile(np.arange(n), 2)
    seen = segments_clear(points[one], points[other], obstacles)
    one, other = one[seen], other[seen]
    begin = np.concatenate([roadmap.begin, one])
    end = np.concatenate([roadmap.end, other])
    away = np.linalg.norm(points[one] - points[other], axis=1)
    graph = csr_array((np.append(roadmap.length, away), (begin, end)), shape=(n + 2, n + 2))
    distance, before = dijkstra(graph, directed=False, indices=n, return_predecessors=True)
    if not np.isfinite(distance[n + 1]):
        return None
    places = [n + 1]
    while places[-1] != n:
        places.append(int(before[places[-1]]))
    return np.asarray(points[places[::-1]])


def follow_route(way: Float[Array, "corners d"], alone: ControlPath) -> ControlPath:
    """Return control points along a way, at the pace of a path that is flown alone."""
    steps = np.linalg.norm(np.diff(alone.reshape(-1, alone.shape[-1]), axis=0), axis=1)
    passed = np.append(0.0, np.cumsum(steps))
    share = passed / passed[-1]
    legs = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(way, axis=0), axis=1)))
    along = [np.interp(share * legs[-1], legs, axis) for axis in way.T]
    return np.stack(along, axis=1).reshape(alone.shape)


@lru_cache(maxsize=MAX_ROADMAPS)
def _remember_roadmap(*parts: tuple[bytes, tuple[int, ...]]) -> Roadmap:
    place, corners, clearance = (np.frombuffer(own).reshape(shape) for own, shape in parts)
    return build_roadmap(place, corners, clearance)


def build_roadmap(
    place: Float[Array, "obstacles d"],
    corners: Float[Array, "obstacles corners d"],
    clearance: Float[Array, " obstacles"],
) -> Roadmap:
    """Build the roadmap among obstacles at rest: of a point and corners from it [m] each.

    A distance is kept from each [m].
    """
    d = place.shape[1]
    ways = polytope_about_ball(d)
    unit = ways / np.linalg.norm(ways, axis=1, keepdims=True)
    farthest = np.einsum("ocd,wd->owc", corners, unit).argmax(axis=2)
    at_corner = np.take_along_axis(corners, farthest[..., None], axis=1)
    # A polytope about the ball is a little larger, so that its sides keep the distance.
    about = place[:, None] + at_corner + ROOM * clearance[:, None, None] * ways
    points = about.reshape(-1, d)
    paths = np.broadcast_to(place[:, None, None], (len(place), 1, 4, d))
    obstacles = ObstaclePaths(paths, corners, clearance, np.zeros_like(place))
    points = np.unique(points[segments_clear(points, points, obstacles)], axis=0)
    k = min(NEIGHBORS + 1, len(points))
    near = cKDTree(points).query(points, k=k)[1].reshape(len(points), -1)
    pairs = np.stack([np.repeat(np.arange(len(points)), near.shape[1]), near.flatten()], axis=1)
    pairs = np.unique(np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1), axis=0)
    pairs = pairs[segments_clear(points[pairs[:, 0]], points[pairs[:, 1]], obstacles)]
    length = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    return Roadmap(points, pairs[:, 0], pairs[:, 1], length)
