"""Tracking of λ₂ and its eigenvectors over slowly changing graphs.

Inverse iteration on three vectors, from those of the last graph, is several times as fast
as a full eigendecomposition for a hundred agents. One Cholesky factorization proves the
result.
"""

from typing import no_type_check

import numba
import numpy as np

from problems.interaction_graph import MULTIPLICITY_TOLERANCE

DENSE_MAX_AGENTS = 20  # up to here a full eigendecomposition is as fast
SHIFT_FACTOR = 0.95  # of the first Rayleigh quotient: no eigenvalue may lie below
RESIDUAL_TOLERANCE = 1e-7  # ‖L v − λ v‖ of an accepted eigenvector
MAX_ITERATIONS = 12  # inverse iterations before a full eigendecomposition


@no_type_check
@numba.njit
def fiedler_vectors(L, basis):
    """Compute λ₂ of a Laplacian and its eigenvectors.

    A Cholesky factorization of L − 0.95 λ₂ I proves that no eigenvalue lies below 0.95 λ₂,
    except for that of the constant vector. Where it fails, the graph has changed much since
    the last call, and all eigenvectors are computed.

    Args:
        L: Laplacian of two agents or more, (m, m).
        basis: Initial vectors, for example the eigenvectors of the last graph after the
            constant one, (3, m). Changed in place to those of this graph.

    Returns:
        λ₂ and an orthonormal basis of its eigenvectors, (s, m).
    """
    m, ritz_values = len(L), np.full(3, np.inf)
    if m > DENSE_MAX_AGENTS and _inverse_iteration(L, basis, ritz_values):
        count = _multiplicity(ritz_values)
        if count < 3:
            return ritz_values[0], basis[:count].copy()
    value, vector = np.linalg.eigh(L)
    following = np.ascontiguousarray(vector[:, 1:].T)
    for k in range(min(3, m - 1)):
        basis[k] = following[k]
    return value[1], following[: _multiplicity(value[1:])]


@no_type_check
@numba.njit
def _multiplicity(value):
    # Number of ascending eigenvalues that equal the first one but for rounding.
    count = 1
    while count < len(value) and value[count] - value[0] <= MULTIPLICITY_TOLERANCE * max(
        1.0, value[0]
    ):
        count += 1
    return count


# Sums in any order are four times as fast.
_njit = numba.njit(fastmath={"reassoc", "contract"})


@no_type_check
@_njit
def _inverse_iteration(L, basis, value):
    # True where λ₂ was found from the initial vectors, and proven.
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
        max_residual = 0.0
        for k in range(_multiplicity(value)):
            residual = image[k] - value[k] * basis[k]
            max_residual = max(max_residual, np.sqrt(_dot(residual, residual)))
        if max_residual <= RESIDUAL_TOLERANCE:
            return True
    return False


@no_type_check
@_njit
def _orthonormalize(basis):
    # Gram–Schmidt twice, after the constant vector; False where the vectors are dependent.
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
    # Ritz vectors of L in the span of the basis, ascending, and their images under L.
    projected = np.zeros((3, 3))
    for k in range(3):
        for i in range(len(L)):
            image[k, i] = _dot(L[i], basis[k])
        for j in range(k + 1):
            projected[k, j] = projected[j, k] = _dot(basis[j], image[k])
    ritz_values, rotation = np.linalg.eigh(projected)
    value[:] = ritz_values
    basis[:] = rotation.T @ basis
    image[:] = rotation.T @ image


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
    # Cholesky factorization in the lower triangle; False where a pivot is not positive.
    for i in range(len(lower)):
        for j in range(i):
            entry = lower[i, j]
            for k in range(j):
                entry -= lower[i, k] * lower[j, k]
            lower[i, j] = entry / lower[j, j]
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
    # Solve for three right-hand sides in place.
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
