"""Orders of points in which every prefix keeps the shape [Gonzalez1985]."""

from math import isqrt

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.doors import checked

# Relative: distances that differ by less are equal, so that rounding on a machine decides nothing.
TIE_TOLERANCE = 1e-9
MAX_DISTANCES = 2 * 10**8  # computed for an order: 10 s or so


@checked
def farthest_point_sampling(points: Float[Array, "k d"], count: int) -> Int[Array, " count"]:
    """Choose points one by one, each as far as possible from those already chosen.

    The first is the point farthest from the middle of the bounding box. Ties go to the smallest
    index. No remaining point is farther from the chosen ones than their own least distance, so
    every prefix covers the points as evenly as it can.
    """
    if count * len(points) > MAX_DISTANCES:
        most = min(count - 1, MAX_DISTANCES // len(points), isqrt(MAX_DISTANCES))
        reason = f"{count} of {len(points)} points are too many to put in order"
        raise ValueError(f"{reason}; {most} would do")
    axes = np.ascontiguousarray(points.T)
    middle = (axes.min(axis=1) + axes.max(axis=1)) / 2
    chosen = _argmax_with_ties(_squared_distances(axes, middle))
    squared = np.full(len(points), np.inf)  # distance of each point to the nearest chosen one
    indices = np.empty(count, dtype=np.int64)
    for i in range(count):
        indices[i] = chosen
        np.minimum(squared, _squared_distances(axes, axes[:, chosen]), out=squared)
        squared[chosen] = -1.0  # never chosen again, even where another point coincides with it
        chosen = _argmax_with_ties(squared)
    return indices


@checked
def golden_ratio_order(count: int) -> Int[Array, " count"]:
    """Return the permutation whose every prefix is spread evenly over the indices.

    It sorts the multiples of the golden ratio, modulo 1 (three-gap theorem). Points listed in
    this order break the ties of a regular shape evenly everywhere instead of from one end.
    """
    golden = (np.sqrt(5) - 1) / 2
    return np.asarray(np.argsort(np.arange(count) * golden % 1, kind="stable"))


def _squared_distances(axes: Float[Array, "d k"], point: Float[Array, " d"]) -> Float[Array, " k"]:
    return np.asarray(((axes - point[:, None]) ** 2).sum(axis=0))


def _argmax_with_ties(squared: Float[Array, " k"]) -> int:
    return int(np.argmax(squared >= squared.max() * (1 - 2 * TIE_TOLERANCE)))
