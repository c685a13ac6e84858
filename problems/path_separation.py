"""Separation of paths: pieces keep a distance where the hulls of their control points do."""

from typing import Annotated

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.convex_hulls import are_outside
from dynamics.doors import MAY_BE_NAN, checked
from dynamics.trajectory_geometry import hull_distance

ControlPoints = Float[Array, "*pairs 4 d"]  # of relative trajectories
Members = Int[Array, " pairs"]  # one path of each pair, by its number
Separation = float | Float[Array, " others"]  # of all others, or of each [m]

MAX_COORDINATES = 100_000  # of paths that are compared at once, which stay in the cache of a core
BOX_PIECES = 8  # of a path, about which one box is compared with those of others
ROUNDING = 1e-9  # relative, of distances


@checked
def are_hulls_separated(
    relative: Annotated[ControlPoints, MAY_BE_NAN], radius: Separation, is_exact: bool = True
) -> Bool[Array, "*pairs"]:
    """Return True where the hull of the control points lies outside the circle.

    Where there are several radii, others come first. If not exact, a ball stands for the hull.
    """
    shape, (corners, d) = relative.shape[:-2], relative.shape[-2:]
    per_piece = _per_piece(radius, shape).reshape(-1)
    return are_outside(relative.reshape(-1, corners, d), per_piece, is_exact).reshape(shape)


def separation_violation(relative: ControlPoints, radius: Separation) -> float:
    """Compute by how much the hulls of the control points enter the circle at most [m]."""
    near = ~are_balls_separated(relative, radius)
    inside = _per_piece(radius, near.shape)[near] - hull_distance(relative[near])[0]
    return float(inside.max(initial=0.0))


def _per_piece(radius: Separation, shape: tuple[int, ...]) -> Array:
    each = np.reshape(radius, np.shape(radius) + (1,) * (len(shape) - np.ndim(radius)))
    return np.broadcast_to(each, shape)


def are_balls_separated(relative: ControlPoints, radius: Separation) -> Bool[Array, "*pairs"]:
    """Return True where a ball about the control points lies outside the circle.

    Sufficient for `are_hulls_separated`, and much faster.
    """
    return are_hulls_separated(relative, radius, is_exact=False)


def are_paths_separated(
    paths: Float[Array, "k pieces 4 d"], i: Members, j: Members, radius: Float[Array, " pairs"]
) -> Bool[Array, " pairs"]:
    """Return True where all pieces of the pairs i, j of paths keep their distances [m]."""
    separated = np.ones(len(i), dtype=bool)
    separated[find_meetings(paths, i, j, radius)[0]] = False
    return separated


def find_meetings(
    paths: Float[Array, "k pieces 4 d"], i: Members, j: Members, radius: Float[Array, " pairs"]
) -> tuple[Int[Array, " met"], Int[Array, " met"]]:
    """List the pieces in which numbered pairs do not keep their distances, in little memory."""
    if not len(i):
        return np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    middle, extent = enclosing_balls(paths)
    apart = np.linalg.norm(middle[i] - middle[j], axis=1)
    near = np.flatnonzero(~(apart > extent[i] + extent[j] + radius))  # also what is not finite
    pair, piece = near_pieces(paths, i[near], j[near], radius[near])
    pair, is_met = near[pair], np.zeros(len(pair), dtype=bool)
    count = max(1, MAX_COORDINATES // paths[0, 0].size)
    for begin in range(0, len(pair), count):
        some = slice(begin, begin + count)
        relative = paths[i[pair[some]], piece[some]] - paths[j[pair[some]], piece[some]]
        is_met[some] = ~are_hulls_separated(relative, radius[pair[some]])
    return pair[is_met], piece[is_met]


def near_pieces(
    paths: Float[Array, "k pieces points d"], i: Members, j: Members, radius: Float[Array, " pairs"]
) -> tuple[Int[Array, " near"], Int[Array, " near"]]:
    """List the pieces of pairs of paths whose points may be nearer than a distance.

    Boxes about several pieces of each path are compared, which leaves out nearly all.

    Args:
        paths: Points of each piece [m].
        i: First path of each pair.
        j: Second one.
        radius: Distance of each pair [m].

    Returns:
        Number of the pair, and the piece, of all that are left.
    """
    pieces, corners, d = paths.shape[1:]
    compared, place = np.unique([i, j], return_inverse=True)
    i, j = place.reshape(2, -1)
    first = np.arange(0, pieces, BOX_PIECES)
    low, high = np.empty((2, d, len(compared), len(first)))
    for axis in range(d):  # each by itself is far faster
        own = paths[compared, ..., axis].reshape(len(compared), pieces * corners)
        low[axis] = np.minimum.reduceat(own, first * corners, axis=1)
        high[axis] = np.maximum.reduceat(own, first * corners, axis=1)
    most, found = (radius * (1 + ROUNDING)) ** 2, []
    count = max(1, MAX_COORDINATES // max(1, len(first)))
    for begin in range(0, len(i), count):
        some = slice(begin, begin + count)
        square = 0.0
        for below, above in zip(low, high, strict=True):
            gap = np.maximum(below[i[some]] - above[j[some]], below[j[some]] - above[i[some]])
            square = square + np.square(np.maximum(gap, 0.0))
        found.append(np.argwhere(~(square > most[some, None])) + np.array([begin, 0]))
    pair, box = np.concatenate(found or [np.zeros((0, 2), dtype=int)]).T
    piece = box[:, None] * BOX_PIECES + np.arange(BOX_PIECES)
    is_there = piece < pieces
    return np.broadcast_to(pair[:, None], piece.shape)[is_there], piece[is_there]


def enclosing_balls(
    paths: Float[Array, "k *points d"],
) -> tuple[Float[Array, "k d"], Float[Array, " k"]]:
    """Return the center and the radius of a ball about all points of each path [m]."""
    points = paths.reshape(len(paths), -1, paths.shape[-1])
    middle, square = np.empty(points[:, 0].shape), np.empty(len(points))
    count = max(1, MAX_COORDINATES // max(1, points[:1].size))
    for first in range(0, len(points), count):
        few = slice(first, first + count)
        axes = np.ascontiguousarray(np.moveaxis(points[few], 2, 0))
        middle[few] = axes.mean(axis=2).T
        axes -= middle[few].T[..., None]
        square[few] = np.einsum("dkp,dkp->kp", axes, axes).max(axis=1)
    return middle, np.sqrt(square)
