"""From a nearby answer to the exact one by Newton's method, compiled.

Cutting planes come near quickly and then gain a factor of four a round. What they tell by
then is which controls x_F are inside their bounds and which speeds are at the limit, and
with that guess the optimum is a root of

    w_j sign_j − q_jᵀλ + Σ_k μ_k g_kjᵀ y_k = 0   for j in F,      y_k = s_k + Σ_j g_kj x_j,
    Σ_j q_j x_j = b,     ‖y_k‖² = 1,

which Newton's method finds in three or four steps. Whether it is the optimum, and the
guess was right, is for `proof` to say.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from numpy import ndarray as Array

from problems.tableau import dot

STEPS = 6
CLOSE = 1e-13  # of a root
LOST = 10.0  # a residual from which nothing good comes


class Guess(NamedTuple):
    """Which controls and speeds take part, and their values; changed in place."""

    parts: Array  # [controls, speeds]
    free: Array  # controls inside their bounds, those with which the list begins
    sign: Array  # of these
    limited: Array  # steps at the speed limit, those with which the list begins
    x: Array
    λ: Array
    μ: Array  # of the limited steps
    velocity: Array  # at these
    matrix: Array  # the other fields are scratch
    right: Array
    push: Array


@numba.njit(error_model="numpy")
@no_type_check
def guess(n, m, K, d):
    """An empty guess."""
    size = n + m + K
    parts, free, limited = np.zeros(2, np.int64), np.zeros(n, np.int64), np.zeros(K, np.int64)
    sign, x, λ, μ, velocity = np.zeros(n), np.zeros(n), np.zeros(m), np.zeros(K), np.zeros((K, d))
    matrix, right, push = np.empty((size, size)), np.empty(size), np.empty((K, d, n))
    return Guess(parts, free, sign, limited, x, λ, μ, velocity, matrix, right, push)


@numba.njit(error_model="numpy")
@no_type_check
def polish(g, shared, question):
    """Improve a guess to the root; False where it leads nowhere."""
    m, axes = len(g.λ), g.velocity.shape[1]
    F, K = g.parts
    size = F + m + K
    if F > len(g.x) or size > len(g.right):
        return False
    _gather(g, shared, question)
    for step in range(STEPS):
        worst = _residuals(g, shared, question)
        if worst < CLOSE or (step == STEPS - 1 and worst < 1e3 * CLOSE):
            return True
        if not worst < LOST or not _solve(g.matrix, g.right, size):
            return False
        for f in range(F):
            g.x[g.free[f]] += g.right[f]
        for a in range(m):
            g.λ[a] += g.right[F + a]
        for i in range(K):
            g.μ[i] += g.right[F + m + i]
            for c in range(axes):
                for f in range(F):
                    g.velocity[i, c] += g.push[i, c, f] * g.right[f]
    return False


@numba.njit(error_model="numpy")
@no_type_check
def _gather(g, shared, question):
    F, K = g.parts
    for i in range(K):
        k = g.limited[i]
        for c in range(g.velocity.shape[1]):
            g.velocity[i, c] = question.free[k, c] + dot(shared.push[k, c], g.x, len(g.x))
            for f in range(F):
                g.push[i, c, f] = shared.push[k, c, g.free[f]]


@numba.njit(error_model="numpy")
@no_type_check
def _residuals(g, shared, question):
    # Fills the matrix and the right-hand side of a Newton step; returns the largest residual.
    m = len(g.λ)
    F, K = g.parts
    size = F + m + K
    A, r = g.matrix, g.right
    A[:size, :size] = 0.0
    for i in range(K):
        square = 0.0
        for c in range(g.velocity.shape[1]):
            y = g.velocity[i, c]
            square += y * y
            for f in range(F):
                A[F + m + i, f] += y * g.push[i, c, f]
            for f in range(F):
                part = g.μ[i] * g.push[i, c, f]
                for h in range(F):
                    A[f, h] += part * g.push[i, c, h]
        r[F + m + i] = (1 - square) / 2
    for a in range(m):
        r[F + a] = question.b[a] - dot(shared.rows[a], g.x, len(g.x))
        for f in range(F):
            A[F + a, f] = shared.rows[a, g.free[f]]
            A[f, F + a] = -A[F + a, f]
    for f in range(F):
        r[f] = -shared.w[g.free[f]] * g.sign[f]
        for a in range(m):
            r[f] += A[F + a, f] * g.λ[a]
        for i in range(K):
            A[f, F + m + i] = A[F + m + i, f]
            r[f] -= A[F + m + i, f] * g.μ[i]
    return np.abs(r[:size]).max()


@numba.njit(error_model="numpy")
@no_type_check
def _solve(A, r, size):
    # Gauss with partial pivoting, in place.
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
