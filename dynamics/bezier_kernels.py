"""Compiled kernels for Bézier curves: closest approach of two, distance of a hull."""

from typing import no_type_check

import numba
import numpy as np

# (3 over i)(3 over j) / (6 over i + j)
_PRODUCT_WEIGHTS = np.outer([1.0, 3.0, 3.0, 1.0], [1.0, 3.0, 3.0, 1.0]) / np.array(
    [[1, 6, 15, 20], [6, 15, 20, 15], [15, 20, 15, 6], [20, 15, 6, 1]]
)


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def closest_pair(b, pairs):
    """Return the minimum distance of any pair, its fraction of the piece, and its pair.

    The squared distance of two cubic pieces is a sextic. Its Bernstein coefficients bound
    it from below; subdivision isolates the minimum and Newton's method refines it.

    Args:
        b: Bézier points of every agent's piece, (agents, 4, d).
        pairs: Indices of the agents of each pair.
    """
    least, fraction, best = np.inf, 0.0, 0
    for q in range(len(pairs)):
        r = b[pairs[q, 1]] - b[pairs[q, 0]]
        c = np.zeros(7)
        for i in range(4):
            for j in range(4):
                c[i + j] += _PRODUCT_WEIGHTS[i, j] * (r[i] * r[j]).sum()
        if min(c) >= least * least:
            continue
        value, t = _min_norm_of_sextic(c, r)
        if value < least:
            least, fraction, best = value, t, q
    return least, fraction, best


@numba.njit(error_model="numpy")
@no_type_check
def _min_norm_of_sextic(c, r):
    # Subdivide where the coefficients allow a value below the least one found so far.
    slack = 1e-15 * max(max(c), -min(c))
    least, t = (c[0], 0.0) if c[0] <= c[6] else (c[6], 1.0)
    stack, low, width = np.empty((64, 7)), np.empty(64), np.empty(64)
    low[0], width[0] = 0.0, 1.0
    _copy(stack[0], c)
    top = 1
    while top > 0:
        top -= 1
        a, start, half = stack[top].copy(), low[top], width[top] / 2
        if min(a) >= least - slack or half < 1e-9:
            continue
        left = np.empty(7)
        for m in range(7):
            left[m] = a[0]
            for i in range(6 - m):
                a[i] = (a[i] + a[i + 1]) / 2
        # De Casteljau's algorithm leaves the coefficients of the right half in a, in order.
        if a[0] < least:
            least, t = a[0], start + half
        low[top], width[top] = start, half
        low[top + 1], width[top + 1] = start + half, half
        _copy(stack[top], left)
        _copy(stack[top + 1], a)
        top += 2
    return _refine_by_newton(r, t)


@numba.njit(error_model="numpy")
@no_type_check
def _refine_by_newton(r, t):
    # Newton's method on r·ṙ = 0, which is well conditioned where |r|² is flat.
    best, at = np.inf, t
    for _ in range(6):
        s = 1.0 - t
        p = s**3 * r[0] + 3 * s * s * t * r[1] + 3 * s * t * t * r[2] + t**3 * r[3]
        size = np.sqrt((p * p).sum())
        if size >= best:
            break
        best, at = size, t
        v = 3 * (s * s * (r[1] - r[0]) + 2 * s * t * (r[2] - r[1]) + t * t * (r[3] - r[2]))
        w = 6 * (s * (r[2] - 2 * r[1] + r[0]) + t * (r[3] - 2 * r[2] + r[1]))
        curve = (v * v).sum() + (p * w).sum()
        if curve <= 0.0:
            break
        t = min(max(t - (p * v).sum() / curve, 0.0), 1.0)
    return best, at


@numba.njit(cache=True, error_model="numpy")
@no_type_check
def min_norm_points(points):
    """Return the distance of each hull of four points from the origin, and its nearest point."""
    count, _, d = points.shape
    distance, nearest = np.zeros(count), np.zeros((count, d))
    best, n, zero = np.empty(d), np.empty(d), np.zeros(d)
    for q in range(count):
        b = points[q]
        least = 0.0
        _copy(best, zero)
        for i in range(4):
            _copy(n, b[i])
            least = _update_best_normal(b, n, least, best)
            for j in range(i):
                if d == 2:
                    n[0], n[1] = b[j, 1] - b[i, 1], b[i, 0] - b[j, 0]
                    least = _update_best_normal(b, n, least, best)
                    continue
                _copy(n, b[i])
                _orthogonalize(n, b[j] - b[i])
                least = _update_best_normal(b, n, least, best)
                for m in range(j):
                    e, f = b[j] - b[i], b[m] - b[i]
                    n[0] = e[1] * f[2] - e[2] * f[1]
                    n[1] = e[2] * f[0] - e[0] * f[2]
                    n[2] = e[0] * f[1] - e[1] * f[0]
                    least = _update_best_normal(b, n, least, best)
        distance[q] = least
        for a in range(d):
            nearest[q, a] = least * best[a]
    return distance, nearest


@numba.njit(error_model="numpy")
@no_type_check
def _orthogonalize(n, e):
    # Subtract the projection of n on e; twice, so that n is orthogonal to rounding.
    size = (e * e).sum()
    if size > 0.0:
        for _ in range(2):
            n -= e * ((n * e).sum() / size)


@numba.njit(error_model="numpy")
@no_type_check
def _update_best_normal(b, n, least, best):
    # Both sides of the line or plane with normal n.
    size = np.sqrt((n * n).sum())
    if size < 1e-150:
        return least
    low, high = np.inf, -np.inf
    for i in range(4):
        projection = 0.0
        for a in range(len(n)):
            projection += n[a] / size * b[i, a]
        low, high = min(low, projection), max(high, projection)
    found = max(low, -high)
    if found > least:
        sense = size if low > least else -size
        for a in range(len(n)):
            best[a] = n[a] / sense
        return low if low > least else -high
    return least


@numba.njit(error_model="numpy")
@no_type_check
def _copy(into, source):
    # Assigning a slice takes a hundred times as long to compile.
    for a in range(len(source)):
        into[a] = source[a]
