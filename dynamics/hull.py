"""The point of a tetrahedron that is nearest the origin, for very many of them.

The best direction stands square on a vertex, an edge or a face, so all of them are tried.
"""

from typing import no_type_check

import numba
import numpy as np


@numba.njit(cache=True)
@no_type_check
def min_norm_points(points):
    """Distance and nearest point of each hull of four points, see `path.hull_distance`."""
    count, _, d = points.shape
    distance, nearest = np.zeros(count), np.zeros((count, d))
    best, n = np.empty(d), np.empty(d)
    for q in range(count):
        b = points[q]
        least = 0.0
        best[:] = 0.0
        for i in range(4):
            n[:] = b[i]
            least = _update_best_normal(b, n, least, best)
            for j in range(i):
                if d == 2:
                    n[0], n[1] = b[j, 1] - b[i, 1], b[i, 0] - b[j, 0]
                    least = _update_best_normal(b, n, least, best)
                    continue
                n[:] = b[i]
                _orthogonalize(n, b[j] - b[i])
                least = _update_best_normal(b, n, least, best)
                for m in range(j):
                    e, f = b[j] - b[i], b[m] - b[i]
                    n[0] = e[1] * f[2] - e[2] * f[1]
                    n[1] = e[2] * f[0] - e[0] * f[2]
                    n[2] = e[0] * f[1] - e[1] * f[0]
                    least = _update_best_normal(b, n, least, best)
        distance[q] = least
        nearest[q] = least * best
    return distance, nearest


@numba.njit(cache=True)
@no_type_check
def _orthogonalize(n, e):
    # Take from n what lies along e; twice, so that what is left is square to rounding.
    size = (e * e).sum()
    if size > 0.0:
        for _ in range(2):
            n -= e * ((n * e).sum() / size)


@numba.njit(cache=True)
@no_type_check
def _update_best_normal(b, n, least, best):
    # Both sides of the line or plane square to n.
    size = np.sqrt((n * n).sum())
    if size < 1e-150:
        return least
    low, high = np.inf, -np.inf
    for i in range(4):
        along = 0.0
        for a in range(len(n)):
            along += n[a] / size * b[i, a]
        low, high = min(low, along), max(high, along)
    if low > least:
        best[:] = n / size
        return low
    if -high > least:
        best[:] = -n / size
        return -high
    return least
