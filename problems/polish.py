"""Newton's method from a nearby point to the exact optimum, compiled.

Cutting planes come near quickly and then gain a factor of four a round. By then they tell which
controls x_F are inside their bounds and which speeds are at the limit, and with this active set
the optimum is a root of

    w_j sign_j − q_jᵀλ + Σ_k μ_k g_kjᵀ y_k = 0   for j in F,      y_k = s_k + Σ_j g_kj x_j,
    Σ_j q_j x_j = b,     ‖y_k‖² = 1,

which Newton's method finds in three or four steps. `certificates` verifies the result, and with
it the active set.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from numpy import ndarray as Array

from problems.tableau import dot_prefix

MAX_STEPS = 6
CONVERGED = 1e-13  # residual of a root
DIVERGED = 10.0  # residual at which the method is stopped


class NewtonState(NamedTuple):
    """Active set and the values of its unknowns; changed in place."""

    counts: Array  # [controls, speeds]
    free_controls: Array  # indices of controls inside their bounds, at the beginning
    sign: Array  # of these
    active_steps: Array  # indices of steps at the speed limit, at the beginning
    x: Array
    λ: Array
    μ: Array  # multipliers of the active steps
    velocity: Array  # at these
    matrix: Array  # the other fields are scratch
    rhs: Array
    velocity_response: Array


@numba.njit(error_model="numpy")
@no_type_check
def allocate_newton(n, m, K, d):
    """Allocate the state of Newton's method."""
    size = n + m + K
    counts, free, active = np.zeros(2, np.int64), np.zeros(n, np.int64), np.zeros(K, np.int64)
    sign, x, λ, μ, velocity = np.zeros(n), np.zeros(n), np.zeros(m), np.zeros(K), np.zeros((K, d))
    matrix, rhs, velocity_response = np.empty((size, size)), np.empty(size), np.empty((K, d, n))
    unknowns = x, λ, μ, velocity
    return NewtonState(counts, free, sign, active, *unknowns, matrix, rhs, velocity_response)


@numba.njit(error_model="numpy")
@no_type_check
def polish(g, shared, rhs):
    """Improve a point to the root; return False where it does not converge."""
    m, axes = len(g.λ), g.velocity.shape[1]
    F, K = g.counts
    size = F + m + K
    if F > len(g.x) or size > len(g.rhs):
        return False
    _restrict_to_active(g, shared, rhs)
    for step in range(MAX_STEPS):
        worst = _assemble_newton_system(g, shared, rhs)
        if worst < CONVERGED or (step == MAX_STEPS - 1 and worst < 1e3 * CONVERGED):
            return True
        if not worst < DIVERGED or not _eliminate(g.matrix, g.rhs, size):
            return False
        for f in range(F):
            g.x[g.free_controls[f]] += g.rhs[f]
        for a in range(m):
            g.λ[a] += g.rhs[F + a]
        for i in range(K):
            g.μ[i] += g.rhs[F + m + i]
            for c in range(axes):
                for f in range(F):
                    g.velocity[i, c] += g.velocity_response[i, c, f] * g.rhs[f]
    return False


@numba.njit(error_model="numpy")
@no_type_check
def _restrict_to_active(g, shared, rhs):
    F, K = g.counts
    for i in range(K):
        k = g.active_steps[i]
        for c in range(g.velocity.shape[1]):
            added = dot_prefix(shared.velocity_response[k, c], g.x, len(g.x))
            g.velocity[i, c] = rhs.free_velocity[k, c] + added
            for f in range(F):
                g.velocity_response[i, c, f] = shared.velocity_response[k, c, g.free_controls[f]]


@numba.njit(error_model="numpy")
@no_type_check
def _assemble_newton_system(g, shared, rhs):
    # Fills the matrix and right-hand side of a Newton step; returns the largest residual.
    m = len(g.λ)
    F, K = g.counts
    size = F + m + K
    A, r = g.matrix, g.rhs
    A[:size, :size] = 0.0
    for i in range(K):
        square = 0.0
        for c in range(g.velocity.shape[1]):
            y = g.velocity[i, c]
            square += y * y
            for f in range(F):
                A[F + m + i, f] += y * g.velocity_response[i, c, f]
            for f in range(F):
                part = g.μ[i] * g.velocity_response[i, c, f]
                for h in range(F):
                    A[f, h] += part * g.velocity_response[i, c, h]
        r[F + m + i] = (1 - square) / 2
    for a in range(m):
        r[F + a] = rhs.b[a] - dot_prefix(shared.rows[a], g.x, len(g.x))
        for f in range(F):
            A[F + a, f] = shared.rows[a, g.free_controls[f]]
            A[f, F + a] = -A[F + a, f]
    for f in range(F):
        r[f] = -shared.w[g.free_controls[f]] * g.sign[f]
        for a in range(m):
            r[f] += A[F + a, f] * g.λ[a]
        for i in range(K):
            A[f, F + m + i] = A[F + m + i, f]
            r[f] -= A[F + m + i, f] * g.μ[i]
    return np.abs(r[:size]).max()


@numba.njit(error_model="numpy")
@no_type_check
def _eliminate(A, r, size):
    # Gaussian elimination with partial pivoting, in place.
    for c in range(size):
        p = c
        for i in range(c + 1, size):
            if abs(A[i, c]) > abs(A[p, c]):
                p = i
        if not abs(A[p, c]) > 1e-13:
            return False
        if p != c:
            for j in range(c, size):
                A[c, j], A[p, j] = A[p, j], A[c, j]
            r[c], r[p] = r[p], r[c]
        for i in range(c + 1, size):
            part = A[i, c] / A[c, c]
            if part != 0.0:
                for j in range(c + 1, size):
                    A[i, j] -= part * A[c, j]
                r[i] -= part * r[c]
    for c in range(size - 1, -1, -1):
        for j in range(c + 1, size):
            r[c] -= A[c, j] * r[j]
        r[c] /= A[c, c]
    return True
