"""Distances of convex hulls of a few points, very many at once: from the origin, and from bodies.

The distance of a hull from the origin is max over unit n of min_i n·b_i. The best n leads to the
nearest corner, or is orthogonal to an edge or to a face. n·b_i ≥ distance holds for whatever n was
found, so that no distance is above the true one, in spite of rounding.
"""

from functools import reduce
from itertools import combinations

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

ROUNDING = 1e-15  # relative: a distance that is this near to that of a corner is that of the corner
BODY_PRECISION = 1e-14  # relative, of the distance of a hull from a body
MAX_SUPPORTS = 100  # corners that are looked for, after which the distance is only a lower bound
TINY = 1e-150  # length of a normal that counts as zero
FEW = 100  # hulls, of which all normals are tried at once: of more, first those to corners
MAX_HULLS = 4096  # that are compared at once, which stay in the cache of a core

Hulls = Float[Array, "hulls k d"]  # corners of each hull


def min_norm_points(points: Hulls) -> tuple[Float[Array, " hulls"], Float[Array, "hulls d"]]:
    """Return the distance of each hull from the origin, and its nearest point.

    The distance is 0 where the origin is inside, or where a point is not finite.
    """
    distance, nearest = np.zeros(len(points)), np.zeros((len(points), points.shape[2]))
    for first in range(0, len(points), MAX_HULLS):
        few = slice(first, first + MAX_HULLS)
        distance[few], nearest[few] = _best_normals(points[few])
    nearest *= distance[:, None]
    return distance, nearest


def _best_normals(b: Hulls) -> tuple[Array, Array]:
    """Return the distances and unit normals; zero where the origin is inside."""
    square = np.einsum("qkd,qkd->qk", b, b)
    distance, normal = np.zeros(len(b)), np.zeros((len(b), b.shape[2]))
    rest = np.arange(len(b))
    if len(b) > FEW or b.shape[1] == 1:  # to the nearest corner; else all normals at once
        nearest = square.argmin(axis=1)
        distance, normal = _support(b, b[np.arange(len(b)), nearest][:, None])
        rest = np.flatnonzero(distance < np.sqrt(square.min(axis=1)) * (1 - ROUNDING))
    if b.shape[1] > 1:
        own, orders = b[rest], range(2, min(b.shape[1:]) + 1)  # corners of an edge, of a face
        normals = [own, *(_normals_to(own, order) for order in orders)]
        distance[rest], normal[rest] = _support(own, np.concatenate(normals, axis=1))
    is_outside = (square.max(axis=1) < np.inf) & (distance > 0)  # False for what is not a number
    return np.where(is_outside, distance, 0.0), np.where(is_outside[:, None], normal, 0.0)


def _support(b: Hulls, normals: Float[Array, "hulls c d"]) -> tuple[Array, Array]:
    """Return the largest of the distances that normals show, on either side, and its normal."""
    size = np.sqrt(np.einsum("qcd,qcd->qc", normals, normals))
    unit = normals / np.maximum(size, TINY)[..., None]
    along = unit @ np.swapaxes(b, 1, 2)
    low, high = along.min(axis=2), along.max(axis=2)
    value = np.where(size > TINY, np.maximum(low, -high), -np.inf)
    best, each = value.argmax(axis=1), np.arange(len(b))
    sense = np.where(low[each, best] >= -high[each, best], 1.0, -1.0)
    return value[each, best], sense[:, None] * unit[each, best]


def _normals_to(b: Hulls, order: int) -> Float[Array, "hulls c d"]:
    """Return what is orthogonal to each edge or face, towards or away from the origin."""
    first, *others = np.array(list(combinations(range(b.shape[1]), order))).T
    base, (edge, *second) = b[:, first], [b[:, other] - b[:, first] for other in others]
    if second:
        (a, b, c), (x, y, z) = np.moveaxis(edge, 2, 0), np.moveaxis(second[0], 2, 0)
        return np.stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=2)
    if b.shape[2] == 2:
        return np.stack([edge[..., 1], -edge[..., 0]], axis=-1)
    square = np.maximum(np.einsum("qed,qed->qe", edge, edge), TINY**2)
    for _ in range(2):  # so that it is orthogonal to rounding
        base = base - edge * (np.einsum("qed,qed->qe", base, edge) / square)[..., None]
    return base


def are_outside(
    points: Hulls, radius: Float[Array, " hulls"], is_exact: bool
) -> Bool[Array, " hulls"]:
    """Return True where a hull, or a ball about it if not exact, is outside a circle about 0."""
    middle = np.einsum("qkd->qd", points) / points.shape[1]
    away = points - middle[:, None]
    extent = np.sqrt(reduce(np.maximum, np.einsum("qkd,qkd->kq", away, away)))
    outside = np.asarray(np.sqrt(np.einsum("qd,qd->q", middle, middle)) - extent >= radius)
    if is_exact and not outside.all():
        near = ~outside
        outside[near] = min_norm_points(points[near])[0] >= radius[near]
    return outside


def body_distances(
    points: Hulls, corners: Float[Array, "bodies corners d"], body: Int[Array, " hulls"]
) -> tuple[Float[Array, " hulls"], Float[Array, "hulls d"]]:
    """Return the distance of hulls of points from bodies, hulls of corners, and its vector.

    The vector leads from the nearest point of the body to that of the hull. No distance is above
    the true one.
    """
    is_point = (corners == corners[:, :1]).all(axis=(1, 2))
    if is_point.all():
        return min_norm_points(points - corners[body, :1])
    alone, rest = np.flatnonzero(is_point[body]), np.flatnonzero(~is_point[body])
    distance, vector = np.zeros(len(points)), np.zeros((len(points), points.shape[2]))
    if len(alone):
        distance[alone], vector[alone] = min_norm_points(points[alone] - corners[body[alone], :1])
    for first in range(0, len(rest), MAX_HULLS):
        few = rest[first : first + MAX_HULLS]
        distance[few], vector[few] = _distances_by_supports(points[few], corners[body[few]])
    return distance, vector


def _distances_by_supports(b: Hulls, c: Float[Array, "hulls corners d"]) -> tuple[Array, Array]:
    """Return distances and vectors by the algorithm of [Gilbert1988].

    Differences b − c that support the best normal so far join the d + 1 that are kept, in place of
    the one that is farthest along it, until none is nearer.
    """
    (count, _, d), each = b.shape, np.arange(len(b))
    normal = b.mean(axis=1) - c.mean(axis=1)
    normal[~normal.any(axis=1)] = np.eye(d)[0]
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    distance, vector, reached = np.zeros(count), np.zeros((count, d)), np.zeros(count)
    kept, active = np.zeros((count, d + 1, d)), each
    for turn in range(MAX_SUPPORTS):
        own = np.arange(len(active))
        n = normal[active, :, None]
        on_b, on_c = (b[active] @ n)[..., 0], (c[active] @ n)[..., 0]
        near, far = on_b.argmin(axis=1), on_c.argmax(axis=1)
        gap = on_b[own, near] - on_c[own, far]
        better = active[gap > distance[active]]
        distance[better] = gap[gap > distance[active]]
        vector[better] = normal[better] * distance[better, None]
        support = b[active, near] - c[active, far]
        if turn == 0:
            kept[:] = support[:, None]
        else:
            is_known = (kept[active] == support[:, None]).all(axis=2).any(axis=1)
            is_nearest = gap >= reached[active] * (1 - BODY_PRECISION)
            go_on = ~(is_known | is_nearest)
            active, support = active[go_on], support[go_on]
            farthest = (kept[active] @ normal[active, :, None])[..., 0].argmax(axis=1)
            kept[active, turn if turn <= d else farthest] = support
        reached[active], normal[active] = _best_normals(kept[active])
        active = active[reached[active] > 0]
        if not len(active):
            break
    return distance, vector
