"""λ₂ and its eigenvectors of one graph after another, each little different from the last.

Inverse iteration on three vectors, from where the last graph left them, is several times as fast
as all eigenvectors of a hundred robots; and one factorisation shows that nothing was missed.
"""

from typing import no_type_check

import numba
import numpy as np

from problems.interaction_graph import MULTIPLICITY_TOLERANCE

DENSE_MAX_AGENTS = 20  # robots up to which all eigenvectors together are as fast
SHIFT_FACTOR = 0.95  # of λ₂ as the last vectors have it: no eigenvalue may lie below
RESIDUAL_TOLERANCE = 1e-7  # |L v − λ v| with which an eigenvector is taken
MAX_ITERATIONS = 12  # of the iteration before it is given up for all eigenvectors


@no_type_check
@numba.njit
def fiedler_vectors(L, basis):
    """λ₂ of a Laplacian, and its eigenvectors.

    That no eigenvalue lies below 0.95 of what is found, the constant vector's aside, is proven by
    a Cholesky factorisation of L − 0.95 λ₂ I. Where there is none, the graph has changed much
    since the last time, and all eigenvectors are computed.

    Args:
        L: The Laplacian, of two robots or more, (m, m).
        basis: The eigenvectors after the constant one as they were of the last graph, or
            anything, (3, m). Changed in place: those of this graph, if there are so many.

    Returns:
        λ₂, and an orthonormal basis of its eigenvectors, (s, m).
    """
    m, three = len(L), np.full(3, np.inf)
    if m > DENSE_MAX_AGENTS and _inverse_iteration(L, basis, three):
        same = _multiplicity(three)
        if same < 3:
            return three[0], basis[:same].copy()
    value, vector = np.linalg.eigh(L)
    above = np.ascontiguousarray(vector[:, 1:].T)
    for k in range(min(3, m - 1)):
        basis[k] = above[k]
    return value[1], above[: _multiplicity(value[1:])]


@no_type_check
@numba.njit
def _multiplicity(value):
    # How many of them, in order, are the first one, but for rounding.
    same = 1
    while same < len(value) and value[same] - value[0] <= MULTIPLICITY_TOLERANCE * max(
        1.0, value[0]
    ):
        same += 1
    return same


# Sums may be taken in any order: they are four times as fast.
_njit = numba.njit(fastmath={"reassoc", "contract"})


@no_type_check
@_njit
def _inverse_iteration(L, basis, value):
    # Whether λ₂ was found from the last eigenvectors, and proven.
    m = len(L)
    image = np.empty((3, m))
    if not _orthonormalize(basis):
        return False
    _rayleigh_ritz(L, basis, image, value)
    factor = L.copy()
    shift, lift = SHIFT_FACTOR * value[0], max(1.0, np.trace(L)) / (m * m)
    for i in range(m):
        factor[i, i] -= shift
        for j in range(i + 1):
            factor[i, j] += lift
    if not _factor_cholesky(factor):
        return False
    for _ in range(MAX_ITERATIONS):
        _solve_cholesky(factor, basis)
        if not _orthonormalize(basis):
            return False
        _rayleigh_ritz(L, basis, image, value)
        worst = 0.0
        for k in range(_multiplicity(value)):
            off = image[k] - value[k] * basis[k]
            worst = max(worst, np.sqrt(_dot(off, off)))
        if worst <= RESIDUAL_TOLERANCE:
            return True
    return False


@no_type_check
@_njit
def _orthonormalize(basis):
    # Gram and Schmidt, twice over, the constant vector first; False if nothing is left of one.
    for k in range(3):
        v = basis[k]
        for _ in range(2):
            v -= v.sum() / len(v)
            for j in range(k):
                v -= _dot(basis[j], v) * basis[j]
            size = np.sqrt(_dot(v, v))
            if not size > 0.0:
                return False
            v /= size
    return True


@no_type_check
@_njit
def _rayleigh_ritz(L, basis, image, value):
    # The best that can be made of a basis: its eigenvectors of L, in order, and their images.
    small = np.zeros((3, 3))
    for k in range(3):
        for i in range(len(L)):
            image[k, i] = _dot(L[i], basis[k])
        for j in range(k + 1):
            small[k, j] = small[j, k] = _dot(basis[j], image[k])
    found, turn = np.linalg.eigh(small)
    value[:] = found
    basis[:] = turn.T @ basis
    image[:] = turn.T @ image


@no_type_check
@_njit
def _dot(x, y):
    total = 0.0
    for i in range(len(x)):
        total += x[i] * y[i]
    return total


@no_type_check
@_njit
def _factor_cholesky(lower):
    # Cholesky, in place of the lower triangle. False if a pivot is not positive.
    for i in range(len(lower)):
        for j in range(i):
            rest = lower[i, j]
            for k in range(j):
                rest -= lower[i, k] * lower[j, k]
            lower[i, j] = rest / lower[j, j]
        pivot = lower[i, i]
        for k in range(i):
            pivot -= lower[i, k] * lower[i, k]
        if not pivot > 0.0:
            return False
        lower[i, i] = np.sqrt(pivot)
    return True


@no_type_check
@_njit
def _solve_cholesky(lower, basis):
    # For three right sides at once, in place of them.
    x, y, z = basis
    for i in range(len(lower)):
        a, b, c = x[i], y[i], z[i]
        for k in range(i):
            a -= lower[i, k] * x[k]
            b -= lower[i, k] * y[k]
            c -= lower[i, k] * z[k]
        x[i], y[i], z[i] = a / lower[i, i], b / lower[i, i], c / lower[i, i]
    for i in range(len(lower) - 1, -1, -1):
        x[i], y[i], z[i] = x[i] / lower[i, i], y[i] / lower[i, i], z[i] / lower[i, i]
        for v in basis:
            for k in range(i):
                v[k] -= lower[i, k] * v[i]
