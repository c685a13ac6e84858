"""What the dual simplex method works on: rows that may be added, and a basis, compiled.

    minimise  Σ_j w_j |x_j|   subject to  a_iᵀx = b_i  in the first rows,
                                          a_iᵀx ≤ b_i  in those added later,  |x_j| ≤ 1

A column below the number of controls is a control, others are the slacks of added rows.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from numpy import ndarray as Array

SINGULAR_PIVOT = 1e-14  # a pivot, of rows of length one, with which a basis is none


class Tableau(NamedTuple):
    """What one programme is worked on with; all fields are changed in place."""

    rows: Array  # a_i, one after the other; there is room for more
    row_end: Array  # of each row, the controls from which on it is zero
    b: Array
    row_count: Array  # [rows in use]
    needs_refactorization: Array  # [whether to compute everything anew before going on]
    w: Array
    basis: Array  # the column in each place
    basic_sign: Array  # of the basic controls
    is_slack_basic: Array  # whether the slack of a row is basic
    basis_inverse: Array  # of the basis, transposed: places are along the second axis
    λ: Array
    v: Array  # Σ_i λ_i a_i
    nonbasic_value: Array  # of the controls that are not basic: −1, 0 or 1
    residual: Array  # b less what those controls use of it
    basic_value: Array  # what is in each place
    α: Array  # the other fields are scratch
    ρ: Array
    pivot_column: Array
    row_norm: Array
    kink_step: Array
    kink_index: Array


@numba.njit(error_model="numpy")
@no_type_check
def copy_prefix(into, source, count):
    """The first so many numbers; assigning a slice takes a hundred times as long to compile."""
    for i in range(count):
        into[i] = source[i]


@numba.njit(error_model="numpy", fastmath={"reassoc"})  # any order: several terms at a time
@no_type_check
def dot_prefix(a, b, count):
    """Σ_j a_j b_j over the first so many."""
    total = 0.0
    for j in range(count):
        total += a[j] * b[j]
    return total


@numba.njit(error_model="numpy")
@no_type_check
def allocate_tableau(first, w, room):
    """An empty desk for equations with given coefficients, with room for more rows."""
    m, n = first.shape
    size = m + room
    rows, inverse, lines = np.zeros((size, n)), np.empty((size, size)), np.zeros((7, size))
    basis, kinks = np.zeros(size, np.int64), 2 * n + size
    for a in range(m):
        copy_prefix(rows[a], first[a], n)
    copy_prefix(basis, initial_basis(first), m)
    return Tableau(
        rows,
        np.full(size, n),
        lines[0],
        np.full(1, m),
        np.ones(1, np.bool_),
        w,
        basis,
        np.ones(size),
        np.zeros(size, np.bool_),
        inverse,
        lines[1],
        np.zeros(n),
        np.zeros(n),
        lines[2],
        lines[3],
        np.zeros(n),
        lines[4],
        lines[5],
        lines[6],
        np.empty(kinks),
        np.empty(kinks, np.int64),
    )


@numba.njit(error_model="numpy")
@no_type_check
def initial_basis(rows):
    """Greedy: each column is the one that reaches furthest out of the span of those before."""
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
    """Everything anew from rows, basis and signs; False where that is no basis."""
    M, n, rows, inverse, basis, sign = (
        d.row_count[0],
        len(d.w),
        d.rows,
        d.basis_inverse,
        d.basis,
        d.basic_sign,
    )
    for a in range(M):
        for i in range(M):
            inverse[a, i] = 1.0 if a == i else 0.0
    for i in range(M):
        # Columns enter one by one where they pivot best: the inverse, by Gauss and Jordan.
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
    w, v, λ, state, loose = d.w, d.v, d.λ, d.nonbasic_value, d.is_slack_basic
    v[:] = 0.0
    for a in range(M):
        λ[a], loose[a] = 0.0, False
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
            loose[basis[i] - n] = True
    for a in range(M):
        d.residual[a] = d.b[a] - dot_prefix(rows[a], state, d.row_end[a])
    d.needs_refactorization[0] = False
    return True


@numba.njit(error_model="numpy")
@no_type_check
def add_row(d):
    """Take into use the row that was written after the last one, a_iᵀx ≤ b_i."""
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
    """Forget an added row whose slack is basic; the last row takes its number."""
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
    d.b[row], d.λ[row], d.residual[row], d.is_slack_basic[row] = (
        d.b[end],
        d.λ[end],
        d.residual[end],
        d.is_slack_basic[end],
    )
    for i in range(end):
        if d.basis[i] == n + end:
            d.basis[i] = n + row
    d.row_count[0] = end


@numba.njit(error_model="numpy")
@no_type_check
def pivot(d, column, out):
    """Let a column into a basis; how small the pivot is against its neighbours."""
    M, rows, inverse, place = d.row_count[0], d.rows, d.basis_inverse, d.pivot_column
    if column < len(d.w):
        for i in range(M):
            place[i] = 0.0
        for a in range(M):
            for i in range(M):
                place[i] += inverse[a, i] * rows[a, column]
    else:
        copy_prefix(place, inverse[column - len(d.w)], M)
    pivot, largest = place[out], 0.0
    for i in range(M):
        largest = max(largest, abs(place[i]))
    place[out] = 0.0
    for a in range(M):
        part = inverse[a, out] / pivot
        for i in range(M):
            inverse[a, i] -= place[i] * part
        inverse[a, out] = part
    return abs(pivot) / largest


@numba.njit(error_model="numpy")
@no_type_check
def set_nonbasic(d, j, new):
    """Put a control that is not basic at another of −1, 0 and 1."""
    change = new - d.nonbasic_value[j]
    for a in range(d.row_count[0]):
        d.residual[a] -= change * d.rows[a, j]
    d.nonbasic_value[j] = new


@numba.njit(error_model="numpy")
@no_type_check
def extract_controls(d, x):
    """The controls at this basis, within their bounds."""
    copy_prefix(x, d.nonbasic_value, len(x))
    for i in range(d.row_count[0]):
        if d.basis[i] < len(x):
            x[d.basis[i]] = min(max(d.basic_value[i], -1.0), 1.0)
