"""Closest approach of cubic pieces: the least distance of relative Bézier curves from the origin.

The squared distance of a cubic piece is a sextic. Its Bernstein coefficients bound it from below;
subdivision isolates the minimum, and Newton's method refines it [Farin2002].
"""

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

SLACK = 4e-15  # relative: coefficients that are less by rounding alone
LEAST_WIDTH = 1e-9  # of an interval that is halved
MAX_NEWTON_STEPS = 6

# (3 over i)(3 over j) / (6 over i + j) of the product of two coefficients, in the sum i + j.
_BINOMIALS = np.array([1.0, 3.0, 3.0, 1.0])
_PRODUCTS = np.zeros((4, 4, 7))
for _i, _j in np.ndindex(4, 4):
    _PRODUCTS[_i, _j, _i + _j] = _BINOMIALS[_i] * _BINOMIALS[_j] / [1, 6, 15, 20, 15, 6, 1][_i + _j]


def closest_approaches(
    relative: Float[Array, "pieces 4 d"], group: Int[Array, " pieces"]
) -> tuple[Float[Array, " pieces"], Float[Array, " pieces"]]:
    """Return the least distance of pieces from the origin, and its fraction of the piece.

    Pieces are Bézier points. The distance is exact for the nearest of each group; of others it may
    be infinite.
    """
    c = np.einsum("qid,qjd,ijk->qk", relative, relative, _PRODUCTS, optimize=True)
    value, fraction = np.minimum(c[:, 0], c[:, 6]), np.where(c[:, 0] <= c[:, 6], 0.0, 1.0)
    least = np.full(group.max(initial=-1) + 1, np.inf)
    np.minimum.at(least, group, value)
    slack = SLACK * np.abs(c).max(axis=1)
    is_near = c.min(axis=1) <= least[group] + slack
    piece = np.flatnonzero(is_near)
    part, start, width = c[piece], np.zeros(len(piece)), 1.0
    while len(piece) and width > LEAST_WIDTH:
        width /= 2
        halves = _halve(part)
        middle = halves[1][:, 0]
        np.minimum.at(value, piece, middle)
        is_best = middle == value[piece]
        fraction[piece[is_best]] = start[is_best] + width
        np.minimum.at(least, group[piece], middle)
        part, piece = np.concatenate(halves), np.tile(piece, 2)
        start = np.concatenate([start, start + width])
        keep = part.min(axis=1) < least[group[piece]] - slack[piece]
        part, piece, start = part[keep], piece[keep], start[keep]
    distance = np.full(len(relative), np.inf)
    distance[is_near], fraction[is_near] = _refine(relative[is_near], fraction[is_near])
    return distance, fraction


def _halve(c: Float[Array, "k 7"]) -> tuple[Float[Array, "k 7"], Float[Array, "k 7"]]:
    # De Casteljau's algorithm.
    left, right = np.empty_like(c), c.copy()
    for m in range(7):
        left[:, m] = right[:, 0]
        right[:, : 6 - m] = (right[:, : 6 - m] + right[:, 1 : 7 - m]) / 2
    return left, right


def _refine(r: Float[Array, "k 4 d"], t: Float[Array, " k"]) -> tuple[Array, Array]:
    # Newton's method on r·ṙ = 0, which is well conditioned where |r|² is flat.
    best, at = np.full(len(t), np.inf), t
    for _ in range(MAX_NEWTON_STEPS):
        s, u = (1 - t)[:, None], t[:, None]
        p = s**3 * r[:, 0] + 3 * s * s * u * r[:, 1] + 3 * s * u * u * r[:, 2] + u**3 * r[:, 3]
        size = np.linalg.norm(p, axis=1)
        at, best = np.where(size < best, t, at), np.minimum(size, best)
        steps = np.diff(r, axis=1)
        v = 3 * (s * s * steps[:, 0] + 2 * s * u * steps[:, 1] + u * u * steps[:, 2])
        bends = np.diff(steps, axis=1)
        w = 6 * (s * bends[:, 0] + u * bends[:, 1])
        curve = (v * v).sum(axis=1) + (p * w).sum(axis=1)
        step = np.where(curve > 0, (p * v).sum(axis=1) / np.where(curve > 0, curve, 1.0), 0.0)
        t = np.clip(t - step, 0.0, 1.0)
    return best, at
