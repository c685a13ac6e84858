"""Orders of points in which every prefix keeps the shape [Gonzalez1985]."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

TIE = 1e-9  # relative: distances closer than this are equal, whatever the machine's rounding


class Selection(NamedTuple):
    """Some of many points, each the farthest from all those before it."""

    rows: Int[Array, " count"]
    distance: Float[Array, " count"]  # of each from the nearest before it; infinite for the first

    @property
    def spacing(self) -> Float[Array, " count"]:
        """Least distance between two points of each prefix; infinite for a single one."""
        return np.asarray(np.minimum.accumulate(self.distance))


def farthest(points: Float[Array, "k d"], count: int) -> Selection:
    """Choose points one by one, each as far as can be from those already chosen.

    The first is the point farthest from the middle of the bounding box. Ties go to the smallest
    index. What is left over is never farther from the chosen ones than the last of them was,
    and that is their least distance: the gap of every prefix is at most 1.
    """
    axes = np.ascontiguousarray(points.T)
    middle = (axes.min(axis=1) + axes.max(axis=1)) / 2
    chosen = _first_largest(_squares(axes, middle))
    squared = np.full(len(points), np.inf)  # distance of each point to the nearest chosen one
    rows, reached = np.empty(count, dtype=np.int64), np.empty(count)
    for i in range(count):
        rows[i], reached[i] = chosen, squared[chosen]
        np.minimum(squared, _squares(axes, axes[:, chosen]), out=squared)
        squared[chosen] = -1.0  # never again, even where another point lies on top of it
        chosen = _first_largest(squared)
    return Selection(rows, np.sqrt(reached))


def in_order(points: Float[Array, "k d"]) -> Int[Array, " k"]:
    """Permutation that puts points in an order in which every prefix keeps the shape.

    Farthest-point order: the gap of every prefix is at most 1. Ties go to the smaller index.
    """
    if len(points) == 0:
        return np.empty(0, dtype=np.int64)
    if not np.isfinite(points).all():
        raise ValueError(f"point {_first_not_finite(points)} is not finite, so it has no place")
    return farthest(points, len(points)).rows


def spread(count: int) -> Int[Array, " count"]:
    """Permutation whose every prefix is spread evenly over the indices.

    Points listed in it break the ties of a regular shape everywhere alike, and not from one end.
    The multiples of the golden ratio do it (the three-gap theorem).
    """
    golden = (np.sqrt(5) - 1) / 2
    return np.asarray(np.argsort(np.arange(count) * golden % 1, kind="stable"))


def gap_of_prefixes(points: Float[Array, "k d"]) -> Float[Array, " prefixes"]:
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
        np.minimum(squared, _squares(axes, axes[:, i]), out=squared)
        worst[i] = squared.max()
    spacing = np.minimum.accumulate(nearest)[1:]
    gap = np.full(len(spacing), np.inf)
    np.divide(worst[1:], spacing, out=gap, where=spacing > 0)
    return np.asarray(np.sqrt(gap))


def _squares(axes: Float[Array, "d k"], point: Float[Array, " d"]) -> Float[Array, " k"]:
    total = np.zeros(axes.shape[1])
    for axis, value in zip(axes, point, strict=True):
        away = axis - value
        away *= away
        total += away
    return total


def _first_largest(squared: Float[Array, " k"]) -> int:
    return int(np.argmax(squared >= squared.max() * (1 - 2 * TIE)))


def _first_not_finite(points: Float[Array, "k d"]) -> int:
    return int(np.argmin(np.isfinite(points).all(axis=1)))
