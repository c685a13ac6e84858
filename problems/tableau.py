"""Tableau of the dual simplex method: rows, to which more may be added, and a basis, compiled.

    minimize  Σ_j w_j |x_j|   subject to  a_iᵀx = b_i  in the first rows,
                                          a_iᵀx ≤ b_i  in those added later,  |x_j| ≤ 1

Columns below the number of controls are controls, the others slacks of added rows.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from numpy import ndarray as Array

SINGULAR_PIVOT = 1e-14  # largest pivot, for rows of norm 1, of a singular basis


class Tableau(NamedTuple):
    """Working data of one program; all fields are changed in entries."""

    rows: Array  # a_i, with room for more
    row_end: Array  # first control from which on each row is zero
    b: Array
    row_count: Array  # [rows in use]
    needs_refactorization: Array  # [True before the next step]
    w: Array
    basis: Array  # column at each position
    basic_sign: Array  # of the basic controls
    is_slack_basic: Array  # of each row
    basis_inverse: Array  # transposed: positions are along the second axis
    λ: Array
    v: Array  # Σ_i λ_i a_i
    nonbasic_value: Array  # of the other controls: −1, 0 or 1
    residual: Array  # b minus the contribution of the nonbasic controls
    basic_value: Array  # at each position
    α: Array  # the other fields are scratch
    ρ: Array
    pivot_column: Array
    row_norm: Array
    kink_step: Array
    kink_index: Array


@numba.njit(error_model="numpy")
@no_type_check
def copy_prefix(into, source, count):
    """Copy the first numbers; assigning a slice takes a hundred times as long to compile."""
    for i in range(count):
        into[i] = source[i]


@numba.njit(error_model="numpy", fastmath={"reassoc"})  # lets the compiler vectorize the sum
@no_type_check
def dot_prefix(a, b, count):
    """Compute Σ_j a_j b_j over the first numbers."""
    total = 0.0
    for j in range(count):
        total += a[j] * b[j]
    return total


@numba.njit(error_model="numpy")
@no_type_check
def allocate_tableau(first, w, room):
    """Allocate a tableau for equations, with room for more rows."""
    m, n = first.shape
    size = m + room
    rows, inverse, lines = np.zeros((size, n)), np.empty((size, size)), np.zeros((7, size))
    basis, kinks = np.zeros(size, np.int64), 2 * n + size
    for a in range(m):
        copy_prefix(rows[a], first[a], n)
    copy_prefix(basis, initial_basis(first), m)
    λ, residual, basic_value, ρ, pivot_column, row_norm = lines[1:7]
    row_end, b, count, stale = np.full(size, n), lines[0], np.full(1, m), np.ones(1, np.bool_)
    program = rows, row_end, b, count, stale, w
    factor = basis, np.ones(size), np.zeros(size, np.bool_), inverse
    point = λ, np.zeros(n), np.zeros(n), residual, basic_value
    scratch = np.zeros(n), ρ, pivot_column, row_norm, np.empty(kinks), np.empty(kinks, np.int64)
    return Tableau(*program, *factor, *point, *scratch)


@numba.njit(error_model="numpy")
@no_type_check
def initial_basis(rows):
    """Choose columns greedily, each the farthest from the span of those before."""
    m, n = rows.shape
    rest = rows.T.copy()
    basis = np.empty(m, np.int64)
    for i in range(m):
        best, size = 0, -1.0
        for j in range(n):
            norm = 0.0
            for a in range(m):
                norm += rest[j, a] ** 2
            if norm > size:
                best, size = j, norm
        basis[i] = best
        axis = rest[best] / np.sqrt(size)
        for j in range(n):
            along = 0.0
            for a in range(m):
                along += rest[j, a] * axis[a]
            for a in range(m):
                rest[j, a] -= along * axis[a]
    return basis


@numba.njit(error_model="numpy")
@no_type_check
def refactorize(d):
    """Recompute the tableau from rows, basis and signs; False where the basis is singular."""
    M, n, rows, inverse = d.row_count[0], len(d.w), d.rows, d.basis_inverse
    basis, sign = d.basis, d.basic_sign
    for a in range(M):
        for i in range(M):
            inverse[a, i] = 1.0 if a == i else 0.0
    for i in range(M):
        # Gauss–Jordan inversion, with the column of largest pivot next.
        best, size = i, -1.0
        for k in range(i, M):
            j, along = basis[k], 0.0
            if j < n:
                for a in range(M):
                    along += inverse[a, i] * rows[a, j]
            else:
                along = inverse[j - n, i]
            if abs(along) > size:
                best, size = k, abs(along)
        if not size > SINGULAR_PIVOT:
            return False
        basis[i], basis[best] = basis[best], basis[i]
        sign[i], sign[best] = sign[best], sign[i]
        pivot(d, basis[i], i)
    w, v, λ, state, is_slack_basic = d.w, d.v, d.λ, d.nonbasic_value, d.is_slack_basic
    v[:] = 0.0
    for a in range(M):
        λ[a], is_slack_basic[a] = 0.0, False
        for i in range(M):
            if basis[i] < n:
                λ[a] += sign[i] * w[basis[i]] * inverse[a, i]
        for j in range(d.row_end[a]):
            v[j] += rows[a, j] * λ[a]
    for j in range(n):
        state[j] = 1.0 if v[j] > w[j] else -1.0 if v[j] < -w[j] else 0.0
    for i in range(M):
        if basis[i] < n:
            state[basis[i]] = 0.0
        else:
            is_slack_basic[basis[i] - n] = True
    for a in range(M):
        d.residual[a] = d.b[a] - dot_prefix(rows[a], state, d.row_end[a])
    d.needs_refactorization[0] = False
    return True


@numba.njit(error_model="numpy")
@no_type_check
def add_row(d):
    """Add the row a_iᵀx ≤ b_i that was written after the last one."""
    M, n = d.row_count[0], len(d.w)
    for a in range(M + 1):
        d.basis_inverse[a, M] = d.basis_inverse[M, a] = 0.0
    for i in range(M):
        if d.basis[i] < n:
            along = d.rows[M, d.basis[i]]
            for a in range(M):
                d.basis_inverse[a, M] -= along * d.basis_inverse[a, i]
    d.basis_inverse[M, M] = 1.0
    d.basis[M], d.basic_sign[M], d.λ[M], d.is_slack_basic[M] = n + M, 1.0, 0.0, True
    d.residual[M] = d.b[M] - dot_prefix(d.rows[M], d.nonbasic_value, d.row_end[M])
    d.row_count[0] = M + 1


@numba.njit(error_model="numpy")
@no_type_check
def drop_row(d, row):
    """Drop an added row whose slack is basic; the last row takes its index."""
    M, n = d.row_count[0], len(d.w)
    end, out = M - 1, -1
    for i in range(M):
        if d.basis[i] == n + row:
            out = i
    d.basis[out], d.basic_sign[out] = d.basis[end], d.basic_sign[end]
    for a in range(M):
        d.basis_inverse[a, out] = d.basis_inverse[a, end]
    copy_prefix(d.basis_inverse[row], d.basis_inverse[end], end)
    copy_prefix(d.rows[row], d.rows[end], n)
    d.row_end[row] = d.row_end[end]
    d.b[row], d.λ[row], d.residual[row] = d.b[end], d.λ[end], d.residual[end]
    d.is_slack_basic[row] = d.is_slack_basic[end]
    for i in range(end):
        if d.basis[i] == n + end:
            d.basis[i] = n + row
    d.row_count[0] = end


@numba.njit(error_model="numpy")
@no_type_check
def pivot(d, column, out):
    """Exchange a basic column; return the pivot relative to the largest entry of its column."""
    M, rows, inverse, entries = d.row_count[0], d.rows, d.basis_inverse, d.pivot_column
    if column < len(d.w):
        for i in range(M):
            entries[i] = 0.0
        for a in range(M):
            for i in range(M):
                entries[i] += inverse[a, i] * rows[a, column]
    else:
        copy_prefix(entries, inverse[column - len(d.w)], M)
    pivot, largest = entries[out], 0.0
    for i in range(M):
        largest = max(largest, abs(entries[i]))
    entries[out] = 0.0
    for a in range(M):
        part = inverse[a, out] / pivot
        for i in range(M):
            inverse[a, i] -= entries[i] * part
        inverse[a, out] = part
    return abs(pivot) / largest


@numba.njit(error_model="numpy")
@no_type_check
def set_nonbasic(d, j, new):
    """Set a nonbasic control to another of −1, 0 and 1."""
    step = new - d.nonbasic_value[j]
    for a in range(d.row_count[0]):
        d.residual[a] -= step * d.rows[a, j]
    d.nonbasic_value[j] = new


@numba.njit(error_model="numpy")
@no_type_check
def extract_controls(d, x):
    """Write the controls of this basis, clipped to their bounds."""
    copy_prefix(x, d.nonbasic_value, len(x))
    for i in range(d.row_count[0]):
        if d.basis[i] < len(x):
            x[d.basis[i]] = min(max(d.basic_value[i], -1.0), 1.0)
