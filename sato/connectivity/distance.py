"""Distances, nearest points and lines of sight, at any number of instants at a time."""

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.connectivity.obstacles import Obstacles


def obstacle_distances(
    position: Float[Array, "*k 3"], obstacles: Obstacles
) -> Float[Array, "*k obstacles"]:
    """Compute the distance to each sphere, box and plane, negative inside [m]."""
    at = position[..., None, :]
    spheres = np.linalg.norm(at - obstacles.spheres[:, :3], axis=-1) - obstacles.spheres[:, 3]
    beyond = np.maximum(obstacles.boxes[:, :3] - at, at - obstacles.boxes[:, 3:])
    outside = np.linalg.norm(np.maximum(beyond, 0), axis=-1)
    boxes = outside + np.minimum(beyond.max(axis=-1), 0)
    planes = position @ obstacles.planes[:, :3].T - obstacles.planes[:, 3]
    return np.concatenate([spheres, boxes, planes], axis=-1)


def nearest_points(
    position: Float[Array, "*k 3"], obstacles: Obstacles
) -> Float[Array, "*k obstacles 3"]:
    """Find the nearest point of the surface of each sphere, box and plane [m]."""
    at, (centers, radius) = position[..., None, :], np.split(obstacles.spheres, [3], axis=1)
    far = np.linalg.norm(at - centers, axis=-1, keepdims=True)
    outwards = np.where(far > 0, at - centers, np.eye(3)[0]) / np.where(far > 0, far, 1)
    spheres = centers + radius * outwards
    low, high = obstacles.boxes[:, :3], obstacles.boxes[:, 3:]
    clipped = np.clip(at, low, high)
    # Inside of a box the nearest of its six faces counts.
    faces = np.stack([low, high], axis=-1)
    depth = np.abs(at[..., None] - faces).reshape(*clipped.shape[:-1], 6)
    nearest = np.arange(6) == depth.argmin(axis=-1)[..., None]
    nearest = nearest.reshape(*clipped.shape, 2)
    on_face = np.where(nearest.any(axis=-1), (faces * nearest).sum(axis=-1), at)
    boxes = np.where((clipped == at).all(axis=-1, keepdims=True), on_face, clipped)
    normals = obstacles.planes[:, :3]
    above = (at * normals).sum(axis=-1) - obstacles.planes[:, 3]
    planes = at - above[..., None] * normals
    return np.concatenate([spheres, boxes, planes], axis=-2)


def segments_hit_balls(
    p: Float[Array, "*#k 3"],
    q: Float[Array, "*#k 3"],
    center: Float[Array, "*#k 3"],
    radius: Float[Array, "*#k"] | float,
) -> Bool[Array, "*#k"]:
    """Tell whether the segments between two positions meet balls."""
    way = q - p
    length = (way**2).sum(axis=-1)
    along = ((center - p) * way).sum(axis=-1) / np.where(length > 0, length, 1)
    nearest = p + np.clip(along, 0, 1)[..., None] * way
    return np.asarray(((nearest - center) ** 2).sum(axis=-1) < np.square(radius))


def blocks_line_of_sight(
    p: Float[Array, "*#k 3"], q: Float[Array, "*#k 3"], obstacles: Obstacles
) -> Bool[Array, "*#k"]:
    """Tell whether an obstacle is between two positions."""
    p, q = p[..., None, :], q[..., None, :]
    spheres = segments_hit_balls(p, q, obstacles.spheres[:, :3], obstacles.spheres[:, 3])
    with np.errstate(divide="ignore", invalid="ignore"):  # along an axis: ±∞, NaN on a face
        ends = (obstacles.boxes.reshape(-1, 2, 3) - p[..., None, :]) / (q - p)[..., None, :]
    enters, leaves = ends.min(axis=-2).max(axis=-1), ends.max(axis=-2).min(axis=-1)
    boxes = np.maximum(enters, 0) < np.minimum(leaves, 1)
    normals, offset = obstacles.planes[:, :3], obstacles.planes[:, 3]
    planes = np.minimum((p * normals).sum(axis=-1), (q * normals).sum(axis=-1)) < offset
    return np.asarray(np.concatenate([spheres, boxes, planes], axis=-1).any(axis=-1))


def nearest_agent_distance(
    there: Float[Array, "instants agents 3"],
) -> Float[Array, "instants agents"]:
    """Compute the distance of each agent to the nearest other [m]; NaN where its position is."""
    found = np.full(there.shape[:2], np.inf)
    for j in range(there.shape[1]):
        away = np.linalg.norm(there - there[:, j : j + 1], axis=2)
        away[:, j] = np.inf
        found = np.fmin(found, away)
    return np.where(np.isfinite(there[..., 0]) & np.isfinite(found), found, np.nan)


def min_obstacle_distance(
    position: Float[Array, "instants agents 3"],
    alive: Bool[Array, "instants agents"],
    obstacles: Obstacles,
) -> float:
    """Compute the least distance of a live agent on straight lines between instants [m].

    Obstacles are convex, so the distance to one falls and then rises along a line: a ternary
    search finds its minimum to 1e-9 of the length. Distance changes by no more than the length
    of the line, so few lines can lead closer than their ends.

    Args:
        position: Positions at each instant [m].
        alive: True for agents that take part.
        obstacles: Obstacles.
    """
    away = obstacle_distances(position, obstacles)
    least = float(away[alive].min(initial=np.inf))
    far = np.linalg.norm(np.diff(position, axis=0), axis=2)[..., None]
    near = (away[1:] + away[:-1] - far) / 2 < least
    k, i, which = np.nonzero(near & (alive[1:] & alive[:-1])[..., None])

    def at(share: Float[Array, " ways"]) -> Float[Array, " ways"]:
        places = position[k, i] + share[:, None] * (position[k + 1, i] - position[k, i])
        return obstacle_distances(places, obstacles)[np.arange(len(k)), which]

    low, high = np.zeros(len(k)), np.ones(len(k))
    for _ in range(52):
        third = (high - low) / 3
        sooner = at(low + third) < at(high - third)
        low, high = np.where(sooner, low, low + third), np.where(sooner, high - third, high)
    return min(least, float(at((low + high) / 2).min(initial=np.inf)))
