"""Closest approach of vehicles that fly straight from each instant to the next."""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array


class ClosestPair(NamedTuple):
    """Closest approach of two vehicles."""

    distance: float  # in the plane [m]; infinite for fewer than two vehicles
    piece: int  # instant before it
    pair: tuple[int, int]


def find_closest_approach(position: Float[Array, "instants agents 2"]) -> ClosestPair:
    """Find the closest approach of all pairs, from positions in the plane [m]."""
    if position.shape[1] < 2 or not len(position):
        return ClosestPair(np.inf, -1, (-1, -1))
    # The last instant is repeated, so that it counts where there is no other.
    square, k, i, j = _closest_approach(np.concatenate([position, position[-1:]]))
    return ClosestPair(float(np.sqrt(square)), int(k), (int(i), int(j)))


@no_type_check
@numba.njit(cache=True)
def _closest_approach(p):
    least, at, one, other = np.inf, 0, 0, 0
    for k in range(len(p) - 1):
        for i in range(p.shape[1]):
            for j in range(i):
                x, y = p[k, i, 0] - p[k, j, 0], p[k, i, 1] - p[k, j, 1]
                d_x = p[k + 1, i, 0] - p[k + 1, j, 0] - x
                d_y = p[k + 1, i, 1] - p[k + 1, j, 1] - y
                far = d_x * d_x + d_y * d_y
                s = -(x * d_x + y * d_y) / far if far > 0 else 0.0
                s = min(1.0, max(0.0, s))
                square = (x + s * d_x) ** 2 + (y + s * d_y) ** 2
                if square < least:
                    least, at, one, other = square, k, j, i
    return least, at, one, other
