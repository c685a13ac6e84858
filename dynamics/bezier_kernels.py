"""Compiled kernels for Bézier curves: closest approach of two, distance of a hull, of a body."""

from typing import no_type_check

import numba
import numpy as np

ROUNDING = 1e-15  # relative: a distance that is this near to that of a corner is that of the corner
BODY_PRECISION = 1e-14  # relative, of the distance of a hull from a body
MAX_CORNERS = 8  # of a body's surface that are nearest, kept at once
MAX_SUPPORTS = 100  # corners that are looked for, after which the distance is only a lower bound

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


@numba.njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def min_norm_points(points):
    """Return the distance of each hull of four points from the origin, and its nearest point."""
    count, _, d = points.shape
    distance, nearest = np.zeros(count), np.zeros((count, d))
    scratch = np.empty((4, d))
    for q in range(count):
        least = _hull_distance(points[q], np.inf, nearest[q], scratch)
        distance[q] = least
        for a in range(d):
            nearest[q, a] *= least
    return distance, nearest


@numba.njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def are_outside(points, radius, is_exact):
    """Return True where the hull of four points, or else a ball about it, is outside a circle.

    Args:
        points: Corners of each hull, (hulls, 4, d).
        radius: Radius of the circle about the origin, of each hull.
        is_exact: True where hulls are to be compared, False for balls.
    """
    count, _, d = points.shape
    outside = np.empty(count, np.bool_)
    best, scratch = np.empty(d), np.empty((4, d))
    for q in range(count):
        outside[q] = _is_ball_outside(points[q], radius[q])
        if is_exact and not outside[q]:
            outside[q] = _hull_distance(points[q], radius[q], best, scratch) >= radius[q]
    return outside


@numba.njit(error_model="numpy")
@no_type_check
def _is_ball_outside(b, radius):
    # The ball is about the mean of the points.
    d, extent, distance = b.shape[1], 0.0, 0.0
    for i in range(4):
        square = 0.0
        for a in range(d):
            middle = (b[0, a] + b[1, a] + b[2, a] + b[3, a]) / 4
            square += (b[i, a] - middle) ** 2
            if i == 0:
                distance += middle**2
        extent = max(extent, square)
    return np.sqrt(distance) - np.sqrt(extent) >= radius


@numba.njit(error_model="numpy")
@no_type_check
def _hull_distance(b, enough, best, scratch):
    # The best normal is written. The search ends at a distance that is enough; no point of the
    # hull is nearer than the nearest corner if that is the best.
    d, least, n = b.shape[1], 0.0, scratch[0]
    e, f, unit = scratch[1], scratch[2], scratch[3]
    for a in range(d):
        best[a] = 0.0
    corners = len(b)
    for i in range(corners):
        square = 0.0
        for a in range(d):
            square += b[i, a] ** 2
        if not square < np.inf:
            return 0.0  # not a number, of which nothing is known
        enough = min(enough, np.sqrt(square) * (1 - ROUNDING))
    for i in range(corners):
        least = _update_best_normal(b, b[i], least, best, unit)
    for i in range(corners):
        for j in range(i):
            if least >= enough:
                return least
            for a in range(d):
                e[a], n[a] = b[j, a] - b[i, a], b[i, a]
            if d == 2:
                n[0], n[1] = e[1], -e[0]
                least = _update_best_normal(b, n, least, best, unit)
                continue
            _orthogonalize(n, e)
            least = _update_best_normal(b, n, least, best, unit)
            for m in range(j):
                for a in range(d):
                    f[a] = b[m, a] - b[i, a]
                n[0] = e[1] * f[2] - e[2] * f[1]
                n[1] = e[2] * f[0] - e[0] * f[2]
                n[2] = e[0] * f[1] - e[1] * f[0]
                least = _update_best_normal(b, n, least, best, unit)
    return least


@numba.njit(error_model="numpy")
@no_type_check
def _orthogonalize(n, e):
    # Subtract the projection of n on e; twice, so that n is orthogonal to rounding.
    size = 0.0
    for a in range(len(e)):
        size += e[a] * e[a]
    if size > 0.0:
        for _ in range(2):
            along = 0.0
            for a in range(len(e)):
                along += n[a] * e[a]
            for a in range(len(e)):
                n[a] -= e[a] * (along / size)


@numba.njit(error_model="numpy")
@no_type_check
def _update_best_normal(b, n, least, best, unit):
    # Both sides of the line or plane with normal n.
    square = 0.0
    for a in range(len(n)):
        square += n[a] * n[a]
    size = np.sqrt(square)
    if size < 1e-150:
        return least
    for a in range(len(n)):
        unit[a] = n[a] / size
    low, high = np.inf, -np.inf
    for i in range(len(b)):
        projection = 0.0
        for a in range(len(n)):
            projection += unit[a] * b[i, a]
        low, high = min(low, projection), max(high, projection)
    found = max(low, -high)
    if found > least:
        sense = 1.0 if low > least else -1.0
        for a in range(len(n)):
            best[a] = sense * unit[a]
        return low if low > least else -high
    return least


@numba.njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def body_distances(points, corners, body):
    """Return the distance of hulls of points from bodies, and the vector of that length.

    The vector leads from the nearest point of the body to that of the hull. No distance is above
    the true one, by the algorithm of Gilbert, Johnson and Keerthi: n·(b − c) ≥ distance for all
    points b and corners c, with n the direction of the vector.

    Args:
        points: Corners of each hull, (hulls, points, d).
        corners: Corners of each body, of which it is the hull, (bodies, corners, d).
        body: Index of the body of each hull.
    """
    count, size, d = points.shape
    distance, nearest = np.zeros(count), np.zeros((count, d))
    n, scratch, kept = np.empty(d), np.empty((4, d)), np.empty((MAX_CORNERS, d))
    for q in range(count):
        b, c = points[q], corners[body[q]]
        for a in range(d):
            n[a] = b[:, a].mean() - c[:, a].mean()
        total, least, found = 0, 0.0, 0.0
        for _ in range(MAX_SUPPORTS):
            length = np.sqrt((n * n).sum())
            if length == 0.0:
                n[0] = length = 1.0
            low, high, first, last = np.inf, -np.inf, 0, 0
            for i in range(size):
                along = (n * b[i]).sum() / length
                if along < low:
                    low, first = along, i
            for i in range(len(c)):
                along = (n * c[i]).sum() / length
                if along > high:
                    high, last = along, i
            if low - high > least * (1 - BODY_PRECISION):  # later normals are more precise
                least = max(low - high, 0.0)
                for a in range(d):
                    nearest[q, a] = n[a] * (least / length)
            is_known = total == MAX_CORNERS
            for a in range(d):
                scratch[0, a] = b[first, a] - c[last, a]
            for i in range(total):
                is_same = True
                for a in range(d):
                    is_same = is_same and kept[i, a] == scratch[0, a]
                is_known = is_known or is_same
            if is_known:
                break
            _copy(kept[total], scratch[0])
            total += 1
            found = _hull_distance(kept[:total], np.inf, n, scratch)
            if found == 0.0:
                break
            left = 0  # those on the face that is nearest stay
            for i in range(total):
                if (n * kept[i]).sum() <= found * (1 + 1e-9):
                    _copy(kept[left], kept[i])
                    left += 1
            total = left
        distance[q] = least
    return distance, nearest


@numba.njit(error_model="numpy")
@no_type_check
def _copy(into, source):
    # Assigning a slice takes a hundred times as long to compile.
    for a in range(len(source)):
        into[a] = source[a]
