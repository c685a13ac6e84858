"""Orders of points in which every prefix keeps the shape [Gonzalez1985]."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

TIE_TOLERANCE = (
    1e-9  # relative: distances closer than this are equal, whatever the machine's rounding
)


class FarthestPoints(NamedTuple):
    """Some of many points, each the farthest from all those before it."""

    indices: Int[Array, " count"]
    distances: Float[Array, " count"]  # of each from the nearest before it; infinite for the first

    @property
    def spacings(self) -> Float[Array, " count"]:
        """Least distance between two points of each prefix; infinite for a single one."""
        return np.asarray(np.minimum.accumulate(self.distances))


def farthest_point_sampling(points: Float[Array, "k d"], count: int) -> FarthestPoints:
    """Choose points one by one, each as far as can be from those already chosen.

    The first is the point farthest from the middle of the bounding box. Ties go to the smallest
    index. What is left over is never farther from the chosen ones than the last of them was,
    and that is their least distance: the gap of every prefix is at most 1.
    """
    axes = np.ascontiguousarray(points.T)
    middle = (axes.min(axis=1) + axes.max(axis=1)) / 2
    chosen = _argmax_with_ties(_squared_distances(axes, middle))
    squared = np.full(len(points), np.inf)  # distance of each point to the nearest chosen one
    rows, reached = np.empty(count, dtype=np.int64), np.empty(count)
    for i in range(count):
        rows[i], reached[i] = chosen, squared[chosen]
        np.minimum(squared, _squared_distances(axes, axes[:, chosen]), out=squared)
        squared[chosen] = -1.0  # never again, even where another point lies on top of it
        chosen = _argmax_with_ties(squared)
    return FarthestPoints(rows, np.sqrt(reached))


def farthest_point_order(points: Float[Array, "k d"]) -> Int[Array, " k"]:
    """Permutation that puts points in an order in which every prefix keeps the shape.

    Farthest-point order: the gap of every prefix is at most 1. Ties go to the smaller index.
    """
    if len(points) == 0:
        return np.empty(0, dtype=np.int64)
    if not np.isfinite(points).all():
        raise ValueError(f"point {_first_nonfinite(points)} is not finite, so it has no place")
    return farthest_point_sampling(points, len(points)).indices


def golden_ratio_order(count: int) -> Int[Array, " count"]:
    """Permutation whose every prefix is spread evenly over the indices.

    Points listed in it break the ties of a regular shape everywhere alike, and not from one end.
    The multiples of the golden ratio do it (the three-gap theorem).
    """
    golden = (np.sqrt(5) - 1) / 2
    return np.asarray(np.argsort(np.arange(count) * golden % 1, kind="stable"))


def prefix_gaps(points: Float[Array, "k d"]) -> Float[Array, " prefixes"]:
    """Gap of every prefix of two points or more.

    The gap is the largest distance from a point of the full list to the nearest point of the
    prefix, over the least distance between two points of the prefix; infinite where two
    of the prefix coincide.
    """
    axes = np.ascontiguousarray(points.T)
    squared = np.full(len(points), np.inf)
    nearest, worst = np.empty(len(points)), np.empty(len(points))
    for i in range(len(points)):
        nearest[i] = squared[i]
        np.minimum(squared, _squared_distances(axes, axes[:, i]), out=squared)
        worst[i] = squared.max()
    spacing = np.minimum.accumulate(nearest)[1:]
    gap = np.full(len(spacing), np.inf)
    np.divide(worst[1:], spacing, out=gap, where=spacing > 0)
    return np.asarray(np.sqrt(gap))


def _squared_distances(axes: Float[Array, "d k"], point: Float[Array, " d"]) -> Float[Array, " k"]:
    total = np.zeros(axes.shape[1])
    for axis, value in zip(axes, point, strict=True):
        away = axis - value
        away *= away
        total += away
    return total


def _argmax_with_ties(squared: Float[Array, " k"]) -> int:
    return int(np.argmax(squared >= squared.max() * (1 - 2 * TIE_TOLERANCE)))


def _first_nonfinite(points: Float[Array, "k d"]) -> int:
    return int(np.argmin(np.isfinite(points).all(axis=1)))
