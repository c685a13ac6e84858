"""Convex obstacles over a horizon: distances of paths from them, and half-spaces about them.

An obstacle is the convex hull of its corners, which moves without turning. A path keeps the
distance over a piece where the hull of its control points does, from the hull of the corners, in
the frame of the obstacle.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.convex_hulls import body_distances
from problems.convexify import (
    SEPARATION_TOLERANCE,
    PassingSide,
    across_motion,
    choose_normals,
    rise_before,
)
from problems.path_separation import are_balls_separated

ControlPath = Float[Array, "pieces 4 d"]  # control points of a path [m]

INSIDE = 1e-9  # of the clearance: a path that is nearer than this is taken as inside


class ObstaclePaths(NamedTuple):
    """Convex obstacles and their motion over a horizon, as an agent knows them."""

    paths: Float[Array, "obstacles pieces 4 d"]  # control points of a point of each [m]
    corners: Float[Array, "obstacles corners d"]  # from that point [m]
    clearance: Float[Array, " obstacles"]  # that the agent keeps from the hull of the corners [m]
    velocity: Float[Array, "obstacles d"]  # now [m/s]

    @property
    def size(self) -> Float[Array, " obstacles"]:
        """Largest distance of a corner from the point that moves [m]."""
        return np.asarray(np.linalg.norm(self.corners, axis=2).max(axis=1))

    def select(self, rows: Array) -> "ObstaclePaths":
        """Keep some obstacles, by a mask or by index."""
        return ObstaclePaths(*(part[rows] for part in self))

    def join_points(
        self, paths: Float[Array, "points pieces 4 d"], clearance: Float[Array, " points"]
    ) -> "ObstaclePaths":
        """Return the same, and points with the distances to keep from each [m]."""
        corners = np.zeros((len(paths), *self.corners.shape[1:]))
        more = ObstaclePaths(paths, corners, clearance, np.zeros((len(paths), paths.shape[-1])))
        return ObstaclePaths(*(np.concatenate(both) for both in zip(self, more, strict=True)))

    def held_after(self, count: int) -> "ObstaclePaths":
        """Return the same, as if obstacles stood still after the first pieces."""
        paths = self.paths.copy()
        paths[:, count:] = self.paths[:, count - 1 : count, -1:]
        return self._replace(paths=paths)

    def after_pieces(self, count: int) -> "ObstaclePaths":
        """Return the same, later by some pieces."""
        return self._replace(paths=self.paths[:, count:])


def measure_gaps(
    path: Float[Array, "obstacles pieces k d"], obstacles: ObstaclePaths
) -> tuple[Float[Array, "obstacles pieces"], Float[Array, "obstacles pieces d"]]:
    """Measure the distance of each piece of a path from each obstacle, 0 inside [m].

    Return also the vector from the nearest point. Paths are in the frame of each obstacle.
    """
    shape, hull = path.shape[:2], path.shape[2:]
    body, d = np.repeat(np.arange(shape[0]), shape[1]), hull[1]
    gap, vector = body_distances(path.reshape(-1, *hull), obstacles.corners, body)
    return gap.reshape(shape), vector.reshape(*shape, d)


def are_pieces_clear(
    path: ControlPath, obstacles: ObstaclePaths
) -> Bool[Array, "obstacles pieces"]:
    """Tell which pieces of a path keep the distance from each obstacle."""
    relative = path - obstacles.paths
    clear = are_balls_separated(relative, obstacles.clearance + obstacles.size)
    if not clear.all():
        body, _ = np.nonzero(~clear)
        gap, _ = body_distances(relative[~clear], obstacles.corners, body)
        clear[~clear] = gap >= obstacles.clearance[body]
    return clear


def are_points_clear(
    points: Float[Array, "ways pieces d"], obstacles: ObstaclePaths, one: int
) -> Bool[Array, "ways pieces"]:
    """Tell which points, at the beginnings of pieces, keep the distance from an obstacle."""
    relative, corners = points - obstacles.paths[one, :, 0], obstacles.corners[one : one + 1]
    away = np.linalg.norm(relative, axis=-1)
    clear = np.asarray(away >= obstacles.clearance[one] + obstacles.size[one])
    if corners.any() and not clear.all():
        near = relative[~clear][:, None]
        gap, _ = body_distances(near, corners, np.zeros(len(near), dtype=int))
        clear[~clear] = gap.ravel() >= obstacles.clearance[one]
    return clear


def select_near(path: ControlPath, obstacles: ObstaclePaths, factor: float) -> ObstaclePaths:
    """Keep the obstacles that a path may come nearer to than the clearance, times a factor."""
    wide = factor * obstacles.clearance + obstacles.size
    is_far = are_balls_separated(path - obstacles.paths, wide).all(axis=1)
    return obstacles.select(np.asarray(~is_far))


def is_path_clear(path: ControlPath, obstacles: ObstaclePaths | None) -> bool:
    """Tell whether a path keeps the distance from all obstacles."""
    return obstacles is None or bool(are_pieces_clear(path, obstacles).all())


def violation(path: ControlPath, obstacles: ObstaclePaths | None) -> float:
    """Compute by how much a path lacks the distance from an obstacle at most [m]."""
    if obstacles is None:
        return 0.0
    gap, _ = measure_gaps(path - obstacles.paths, obstacles)
    return float((obstacles.clearance[:, None] - gap).max(initial=0.0))


def nearest_points(
    path: ControlPath, obstacles: ObstaclePaths
) -> Float[Array, "obstacles pieces d"]:
    """Find the points of the obstacles that are nearest to the beginnings of the pieces of a path.

    For a path inside, the points through which obstacles move.
    """
    gap, vector = measure_gaps(path[:, :1] - obstacles.paths[:, :, :1], obstacles)
    inside = gap <= INSIDE * obstacles.clearance[:, None]
    return np.where(inside[..., None], obstacles.paths[:, :, 0], path[:, 0] - vector)


def support_obstacles(
    nominal: ControlPath, obstacles: ObstaclePaths, side: PassingSide = "same"
) -> tuple[Float[Array, "obstacles pieces 4 d"], Float[Array, "obstacles pieces d"]]:
    """Choose half-spaces between a nominal path and obstacles, one a piece and an obstacle.

    As `convexify.choose_normals` for other agents: a nominal that keeps the distance satisfies
    them, and for one in conflict they belong to a path that is displaced sideways until it passes.

    Returns:
        Control points of the corner of each obstacle that supports the half-space, and the unit
        normals; a path on the far side of these by the clearance is clear of the whole obstacle.
    """
    relative = nominal - obstacles.paths
    required = obstacles.clearance * (1 + SEPARATION_TOLERANCE)
    gap, vector = measure_gaps(relative, obstacles)
    met = np.flatnonzero((gap < required[:, None]).any(axis=1))
    if len(met):
        relative = relative.copy()
        for a in met.tolist():
            own = obstacles.corners[a], float(required[a])
            relative[a] += _pass_by(relative[a], gap[a], vector[a], *own, side)
        gap[met], vector[met] = measure_gaps(relative[met], obstacles.select(met))
    inside = gap <= INSIDE * required[:, None]
    vector[inside] = relative[inside].mean(axis=-2)
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    normal = vector / np.maximum(length, 1e-300)
    normal[length[..., 0] == 0.0, 0] = 1.0
    corner = np.einsum("ovd,opd->opv", obstacles.corners, normal).argmax(axis=2)
    support = np.take_along_axis(obstacles.corners, corner[..., None], axis=1)
    return obstacles.paths + support[:, :, None], normal


def choose_half_spaces(
    nominal: ControlPath,
    others: Float[Array, "others pieces 4 d"],
    required: Float[Array, " others"],
    obstacles: ObstaclePaths | None,
    side: PassingSide = "same",
) -> tuple[Float[Array, "all pieces 4 d"], Float[Array, "all pieces d"], Float[Array, " all"]]:
    """Choose half-spaces between a nominal path, other agents and then obstacles.

    Args:
        nominal: Control points [m].
        others: Control points of the other agents [m].
        required: Distance that planned trajectories keep from each [m].
        obstacles: Obstacles.
        side: Side on which to pass those that the nominal meets.

    Returns:
        Control points, unit normals and required distances, as `convexify` takes them.
    """
    normals = choose_normals(nominal - others, required, side)
    if obstacles is None:
        return others, normals, required
    support, across = support_obstacles(nominal, obstacles, side)
    kept = np.append(required, obstacles.clearance * (1 + SEPARATION_TOLERANCE))
    return np.concatenate([others, support]), np.concatenate([normals, across]), kept


def _pass_by(
    relative: ControlPath,
    gap: Float[Array, " pieces"],
    vector: Float[Array, "pieces d"],
    corners: Float[Array, "corners d"],
    required: float,
    side: PassingSide,
) -> ControlPath:
    """Displace a path sideways, gradually before it is nearest, until it passes an obstacle."""
    p = int(np.argmin(gap))
    if gap[p] <= INSIDE * required:  # the piece that is deepest inside
        p = int(np.linalg.norm(relative.mean(axis=1), axis=1).argmin())
        vector = np.zeros_like(vector)
    way = across_motion(relative[p], vector[p], side)
    lacking = float((corners @ way).max()) + required - float((relative[p] @ way).min())
    return rise_before(p, len(relative)) * (max(lacking, 0.0) * way)


def pad_corners(each: Sequence[Float[Array, "_ d"]]) -> Float[Array, "obstacles corners d"]:
    """Stack corners, with the first ones repeated up to the largest number."""
    most = max(map(len, each))
    return np.stack([np.concatenate([c, np.repeat(c[:1], most - len(c), axis=0)]) for c in each])


def segments_clear(
    begin: Float[Array, "segments d"], end: Float[Array, "segments d"], obstacles: ObstaclePaths
) -> Bool[Array, " segments"]:
    """Tell which straight ways keep the distance from obstacles as they stand at first."""
    points = begin[:, None] + np.linspace(0.0, 1.0, 4)[:, None] * (end - begin)[:, None]
    still = obstacles._replace(paths=np.repeat(obstacles.paths[:, :1, :1], 4, axis=2))
    return np.asarray(are_pieces_clear(points, still).all(axis=0))
