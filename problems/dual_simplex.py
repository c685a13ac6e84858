"""Dual simplex method with the long-step rule for many programs, compiled [Maros2003].

    minimize  Σ_j w_j |x_j|   subject to  Q x = b,  |x_j| ≤ 1,  Q of orthonormal rows

`minimum_fuel` explains the choice of method. The optimal basis of a program is the start of the
next in its batch. All that is compiled together stands in this file, which numba's cache watches.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from numpy import ndarray as Array

from problems.kernels import compiled

OPTIMAL, INFEASIBLE, STOPPED = 0, 1, 2

PRIMAL_TOLERANCE = 1e-11  # largest violation of a bound, relative
ZERO_SLOPE = 1e-11  # a slope of the dual that counts as zero, for rows of norm 1
SINGULAR_PIVOT = 1e-14  # largest pivot, for rows of norm 1, of a singular basis
# Smallest pivot relative to its column; after a smaller one the tableau is refactorized.
MIN_RELATIVE_PIVOT = 1e-7


class Tableau(NamedTuple):
    """Working data of one program; all fields are changed in entries."""

    rows: Array  # Q
    w: Array
    b: Array
    basis: Array  # column at each position
    basic_sign: Array  # of the basic controls
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


def choose_basis(rows: Array) -> Array:
    """Return as many columns as rows, each the farthest from the span of those before."""
    rest, basis = rows.copy(), np.empty(len(rows), np.int64)
    for i in range(len(rows)):
        size = np.linalg.norm(rest, axis=0)
        basis[i] = size.argmax()
        axis = rest[:, basis[i]] / size[basis[i]]
        rest -= np.outer(axis, axis @ rest)
    return basis


@compiled(nogil=True, error_model="numpy")
@no_type_check
def solve_batches(rows, first_basis, w, b, starts, max_pivots, x, λ, status):
    """Solve every program; those of other batches do not change a bit of its solution.

    Q are the rows, and b has one a program. Each batch starts at one, with columns as of
    `choose_basis`. Written are the controls x, the status, and the duals λ, or the direction
    along which the dual grows without bound.
    """
    m, n = rows.shape
    for batch in range(len(starts) - 1):
        basis, sign, inverse = np.empty(m, np.int64), np.ones(m), np.empty((m, m))
        _copy(basis, first_basis)
        v, value, α = np.zeros(n), np.zeros(n), np.zeros(n)
        residual, basic_value, ρ = np.zeros(m), np.zeros(m), np.zeros(m)
        column, norm = np.zeros(m), np.zeros(m)
        kinks, index = np.zeros(2 * n), np.zeros(2 * n, np.int64)
        for q in range(starts[batch], starts[batch + 1]):
            factor, point = (basis, sign, inverse), (λ[q], v, value, residual, basic_value)
            scratch = α, ρ, column, norm, kinks, index
            d = Tableau(rows, w, b[q], *factor, *point, *scratch)
            status[q] = _maximize_dual(d, max_pivots)
            if status[q] == INFEASIBLE:
                _copy(λ[q], ρ)
            elif status[q] == STOPPED:
                _copy(basis, first_basis)
            _copy(x[q], value)
            for i in range(m):
                x[q, basis[i]] = min(max(basic_value[i], -1.0), 1.0)


@numba.njit(error_model="numpy")
@no_type_check
def _maximize_dual(d, max_pivots):
    # Ascends from the basis of the tableau; where unbounded, the direction is in ρ.
    (m, n), largest, is_stale = d.rows.shape, 0.0, True
    for a in range(m):
        largest = max(largest, abs(d.b[a]))
    basis, sign, rows, α, ρ = d.basis, d.basic_sign, d.rows, d.α, d.ρ
    for _ in range(max_pivots):
        if is_stale and not _refactorize(d):
            break
        leaving, worst, up = _select_leaving(d, PRIMAL_TOLERANCE * (1 + largest))
        if leaving < 0:
            return OPTIMAL
        left = basis[leaving]
        direction = sign[leaving] if up else -sign[leaving]
        for j in range(n):
            α[j] = 0.0
        for a in range(m):
            ρ[a] = direction * d.basis_inverse[a, leaving]
            for j in range(n):
                α[j] += rows[a, j] * ρ[a]
        for i in range(m):
            α[basis[i]] = 0.0
        # The leaving control is a kink too, where it may go to zero and on to the other bound.
        α[left] = direction
        d.v[left] = sign[leaving] * d.w[left]
        if up:
            _set_nonbasic(d, left, sign[leaving])
        enter, t = _select_entering(d, worst, np.sqrt(d.row_norm[leaving]))
        if enter < 0:
            return INFEASIBLE
        for j in range(n):
            d.v[j] += t * α[j]
        for a in range(m):
            d.λ[a] += t * ρ[a]
        sense = 1.0 if α[enter] > 0 else -1.0
        sign[leaving] = d.nonbasic_value[enter] if d.nonbasic_value[enter] != 0.0 else sense
        _set_nonbasic(d, enter, 0.0)
        basis[leaving] = enter
        is_stale = _pivot(d, enter, leaving) < MIN_RELATIVE_PIVOT
    return STOPPED


@numba.njit(error_model="numpy")
@no_type_check
def _select_leaving(d, tolerance):
    # Steepest ascent: violation of a bound over the norm of its direction.
    m, y, norm = len(d.b), d.basic_value, d.row_norm
    for i in range(m):
        y[i], norm[i] = 0.0, 0.0
    for a in range(m):
        for i in range(m):
            y[i] += d.basis_inverse[a, i] * d.residual[a]
            norm[i] += d.basis_inverse[a, i] ** 2
    leaving, worst, up, steepest = -1, 0.0, False, 0.0
    for i in range(m):
        violation = -y[i] * d.basic_sign[i]
        over = -violation - 1.0 > violation
        violation = -violation - 1.0 if over else violation
        if violation > tolerance and violation**2 > steepest * norm[i]:
            leaving, worst, up, steepest = i, violation, over, violation**2 / norm[i]
    return leaving, worst, up


@numba.njit(error_model="numpy")
@no_type_check
def _select_entering(d, slope, length):
    # Passes kinks of the dual, the nearest first, for as long as the slope stays positive.
    w, v, α, state, step, kink = d.w, d.v, d.α, d.nonbasic_value, d.kink_step, d.kink_index
    kinks = 0
    for j in range(len(w)):
        if abs(α[j]) < ZERO_SLOPE * length:
            continue
        sense = 1.0 if α[j] > 0 else -1.0
        if state[j] == 0.0:
            step[kinks], kink[kinks] = max(0.0, (sense * w[j] - v[j]) / α[j]), j
            kinks += 1
        elif state[j] != sense:
            step[kinks], kink[kinks] = max(0.0, (-sense * w[j] - v[j]) / α[j]), j
            step[kinks + 1], kink[kinks + 1] = max(0.0, (sense * w[j] - v[j]) / α[j]), j
            kinks += 2
    for i in range(kinks // 2 - 1, -1, -1):
        _sift_down(step, kink, i, kinks)
    while kinks > 0:
        j = kink[0]
        slope -= abs(α[j])
        if slope <= 0.0:
            return j, step[0]
        kinks -= 1
        step[0], kink[0] = step[kinks], kink[kinks]
        _sift_down(step, kink, 0, kinks)
        # Passing the kink moves the control from a bound to zero, or from zero to a bound.
        sense = 1.0 if α[j] > 0 else -1.0
        _set_nonbasic(d, j, sense if state[j] == 0.0 else 0.0)
    return -1, 0.0


@numba.njit(error_model="numpy")
@no_type_check
def _sift_down(step, kink, i, count):
    t, j = step[i], kink[i]
    while 2 * i + 1 < count:
        child = 2 * i + 1
        if child + 1 < count and step[child + 1] < step[child]:
            child += 1
        if step[child] >= t:
            break
        step[i], kink[i] = step[child], kink[child]
        i = child
    step[i], kink[i] = t, j


@numba.njit(error_model="numpy")
@no_type_check
def _refactorize(d):
    # Recomputes all from rows, basis and signs; False where the basis is singular.
    (m, n), rows, inverse = d.rows.shape, d.rows, d.basis_inverse
    basis, sign = d.basis, d.basic_sign
    for a in range(m):
        for i in range(m):
            inverse[a, i] = 1.0 if a == i else 0.0
    for i in range(m):
        # Gauss–Jordan inversion, with the column of largest pivot next.
        best, size = i, -1.0
        for k in range(i, m):
            along = 0.0
            for a in range(m):
                along += inverse[a, i] * rows[a, basis[k]]
            if abs(along) > size:
                best, size = k, abs(along)
        if not size > SINGULAR_PIVOT:
            return False
        basis[i], basis[best] = basis[best], basis[i]
        sign[i], sign[best] = sign[best], sign[i]
        _pivot(d, basis[i], i)
    w, v, λ, state = d.w, d.v, d.λ, d.nonbasic_value
    for j in range(n):
        v[j] = 0.0
    for a in range(m):
        λ[a] = 0.0
        for i in range(m):
            λ[a] += sign[i] * w[basis[i]] * inverse[a, i]
        for j in range(n):
            v[j] += rows[a, j] * λ[a]
    for j in range(n):
        state[j] = 1.0 if v[j] > w[j] else -1.0 if v[j] < -w[j] else 0.0
    for i in range(m):
        state[basis[i]] = 0.0
    for a in range(m):
        d.residual[a] = d.b[a] - _dot(rows[a], state)
    return True


@numba.njit(error_model="numpy")
@no_type_check
def _pivot(d, column, out):
    # Exchanges a basic column; returns the pivot relative to the largest entry of its column.
    m, inverse, entries = len(d.b), d.basis_inverse, d.pivot_column
    for i in range(m):
        entries[i] = 0.0
    for a in range(m):
        for i in range(m):
            entries[i] += inverse[a, i] * d.rows[a, column]
    pivot, largest = entries[out], 0.0
    for i in range(m):
        largest = max(largest, abs(entries[i]))
    entries[out] = 0.0
    for a in range(m):
        part = inverse[a, out] / pivot
        for i in range(m):
            inverse[a, i] -= entries[i] * part
        inverse[a, out] = part
    return abs(pivot) / largest


@numba.njit(error_model="numpy")
@no_type_check
def _set_nonbasic(d, j, new):
    step = new - d.nonbasic_value[j]
    for a in range(len(d.b)):
        d.residual[a] -= step * d.rows[a, j]
    d.nonbasic_value[j] = new


@numba.njit(error_model="numpy")
@no_type_check
def _copy(into, source):
    # Assigning a slice takes a hundred times as long to compile.
    for i in range(len(source)):
        into[i] = source[i]


@numba.njit(error_model="numpy", fastmath={"reassoc"})  # lets the compiler vectorize the sum
@no_type_check
def _dot(a, b):
    total = 0.0
    for j in range(len(a)):
        total += a[j] * b[j]
    return total
