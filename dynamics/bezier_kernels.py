"""How close two cubic pieces come: the least of a sextic, found by halving and polished."""

from typing import no_type_check

import numba
import numpy as np

# (3 over i)(3 over j) / (6 over i + j)
_PRODUCT_WEIGHTS = np.outer([1.0, 3.0, 3.0, 1.0], [1.0, 3.0, 3.0, 1.0]) / np.array(
    [[1, 6, 15, 20], [6, 15, 20, 15], [15, 20, 15, 6], [20, 15, 6, 1]]
)


@numba.njit(cache=True)
@no_type_check
def closest_pair(b, pairs):
    """Least distance of any pair, when it is, and which pair of the list.

    Args:
        b: Bézier points of every agent's piece.
        pairs: Numbers of the agents to compare.
    """
    # Squared distance as a sextic in Bernstein form: its coefficients bound it from below.
    least, fraction, best = np.inf, 0.0, 0
    for q in range(len(pairs)):
        r = b[pairs[q, 1]] - b[pairs[q, 0]]
        c = np.zeros(7)
        for i in range(4):
            for j in range(4):
                c[i + j] += _PRODUCT_WEIGHTS[i, j] * (r[i] * r[j]).sum()
        if c.min() >= least * least:
            continue
        value, t = _min_norm_of_sextic(c, r)
        if value < least:
            least, fraction, best = value, t, q
    return least, fraction, best


@numba.njit(cache=True)
@no_type_check
def _min_norm_of_sextic(c, r):
    # Halve where the coefficients leave room for less than what was met, then polish.
    slack = 1e-15 * np.abs(c).max()
    least, t = (c[0], 0.0) if c[0] <= c[6] else (c[6], 1.0)
    stack, low, width = np.empty((64, 7)), np.empty(64), np.empty(64)
    stack[0], low[0], width[0] = c, 0.0, 1.0
    top = 1
    while top > 0:
        top -= 1
        a, start, half = stack[top].copy(), low[top], width[top] / 2
        if a.min() >= least - slack or half < 1e-9:
            continue
        left = np.empty(7)
        for m in range(7):
            left[m] = a[0]
            for i in range(6 - m):
                a[i] = (a[i] + a[i + 1]) / 2
        # De Casteljau leaves the right half's coefficients in place, in order.
        if a[0] < least:
            least, t = a[0], start + half
        stack[top], low[top], width[top] = left, start, half
        stack[top + 1], low[top + 1], width[top + 1] = a, start + half, half
        top += 2
    return _refine_by_newton(r, t)


@numba.njit(cache=True)
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
