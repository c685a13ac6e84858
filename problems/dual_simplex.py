"""The dual simplex method with the long-step rule, compiled [Maros2003].

What is answered, and why this way, stands in `least_fuel`. Columns are rows here: Q is
(columns, rows of the programme), with orthonormal columns.
"""

from typing import no_type_check

import numba
import numpy as np

PROVEN = 1e-9  # relative; an answer with a larger residual or gap is not proven

ANSWERED, OUT_OF_REACH, UNPROVEN = 0, 1, 2


@numba.njit(cache=True, parallel=True)
@no_type_check
def solve_all(Q, b, U, w, lots, pivots):
    """Answer every question, lot by lot.

    Returns u, the dual values and how each question ended.
    """
    questions, n = len(b), len(Q)
    u = np.empty((questions, n))
    dual = np.empty(questions)
    status = np.empty(questions, np.int64)
    rows = np.ascontiguousarray(Q.T)
    for lot in numba.prange(lots):
        # Within a lot each question starts from the basis that answered the one before.
        basis, sign = _first_basis(Q)
        for q in range(lot * questions // lots, (lot + 1) * questions // lots):
            status[q], dual[q] = _solve(Q, rows, b[q], U, w, basis, sign, pivots, u[q])
    return u, dual, status


@numba.njit(cache=True)
@no_type_check
def _first_basis(Q):
    # Greedy: each column is the one that reaches furthest out of the span of those before.
    n, m = Q.shape
    rest = Q.copy()
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
    return basis, np.ones(m)


@numba.njit(cache=True)
@no_type_check
def _solve(Q, rows, b, U, w, basis, sign, pivots, u):
    """Answer one question; `basis` and `sign` are the start and become the end.

    Returns how it ended and the dual value: infinity, and u = NaN, where b is out of reach.
    """
    n, m = Q.shape
    tolerance = 1e-11 * (U + np.abs(b).max())
    inverse, λ, v, state = _start(Q, rows, w, basis, sign)
    r = b.copy()
    for j in range(n):
        if state[j] != 0.0:
            for a in range(m):
                r[a] -= U * state[j] * Q[j, a]
    α = np.empty(n)
    when = np.empty(2 * n)
    who = np.empty(2 * n, np.int64)
    for _ in range(pivots):
        # The basic control that breaks its bounds by most.
        out, worst, up = -1, tolerance, False
        for i in range(m):
            y = 0.0
            for a in range(m):
                y += inverse[i, a] * r[a]
            y *= sign[i]
            if -y > worst:
                out, worst, up = i, -y, False
            if y - U > worst:
                out, worst, up = i, y - U, True
        if out < 0:
            return _finish(rows, b, U, w, basis, inverse, λ, state, r, u, α)
        turn = sign[out] if up else -sign[out]
        kinks = 0
        α[:] = 0.0
        for a in range(m):
            for j in range(n):
                α[j] += rows[a, j] * inverse[out, a]
        for j in range(n):
            α[j] *= turn
        for i in range(m):
            α[basis[i]] = 0.0
        # The column let go is a kink ahead too, where it is let go towards zero and beyond.
        left = basis[out]
        α[left] = turn
        v[left] = sign[out] * w[left]
        if up:
            state[left] = sign[out]
            for a in range(m):
                r[a] -= U * sign[out] * Q[left, a]
        for j in range(n):
            if abs(α[j]) < 1e-13:
                continue
            ahead = 1.0 if α[j] > 0 else -1.0
            if state[j] == 0.0:
                when[kinks], who[kinks] = max(0.0, (ahead * w[j] - v[j]) / α[j]), j
                kinks += 1
            elif state[j] != ahead:
                when[kinks], who[kinks] = max(0.0, (-ahead * w[j] - v[j]) / α[j]), j
                when[kinks + 1], who[kinks + 1] = max(0.0, (ahead * w[j] - v[j]) / α[j]), j
                kinks += 2
        _heapify(when, who, kinks)
        slope, enter = worst, -1
        while kinks > 0:
            j = who[0]
            slope -= U * abs(α[j])
            if slope <= 0.0:
                enter = j
                break
            kinks -= 1
            when[0], who[0] = when[kinks], who[kinks]
            _sink(when, who, 0, kinks)
            # Passed: the control flips from one bound to nothing, or from nothing to a bound.
            ahead = 1.0 if α[j] > 0 else -1.0
            new = ahead if state[j] == 0.0 else 0.0
            for a in range(m):
                r[a] -= U * (new - state[j]) * Q[j, a]
            state[j] = new
        if enter < 0:
            u[:] = np.nan
            return _beyond(rows, b, U, turn * inverse[out], α), np.inf
        j, t = enter, when[0]
        for k in range(n):
            v[k] += t * α[k]
        for a in range(m):
            λ[a] += t * turn * inverse[out, a]
        ahead = 1.0 if α[j] > 0 else -1.0
        if state[j] != 0.0:
            for a in range(m):
                r[a] += U * state[j] * Q[j, a]
            sign[out] = state[j]
        else:
            sign[out] = ahead
        state[j] = 0.0
        basis[out] = j
        _exchange(inverse, Q[j], out)
    u[:] = np.nan
    return UNPROVEN, np.nan


@numba.njit(cache=True)
@no_type_check
def _heapify(when, who, count):
    for i in range(count // 2 - 1, -1, -1):
        _sink(when, who, i, count)


@numba.njit(cache=True)
@no_type_check
def _sink(when, who, i, count):
    t, j = when[i], who[i]
    while 2 * i + 1 < count:
        child = 2 * i + 1
        if child + 1 < count and when[child + 1] < when[child]:
            child += 1
        if when[child] >= t:
            break
        when[i], who[i] = when[child], who[child]
        i = child
    when[i], who[i] = t, j


@numba.njit(cache=True)
@no_type_check
def _start(Q, rows, w, basis, sign):
    n, m = Q.shape
    inverse = np.eye(m)
    for i in range(m):
        # Columns enter one by one where they pivot best: the inverse, by Gauss and Jordan.
        best, size = i, 0.0
        for k in range(i, m):
            along = 0.0
            for a in range(m):
                along += inverse[i, a] * Q[basis[k], a]
            if abs(along) > size:
                best, size = k, abs(along)
        basis[i], basis[best] = basis[best], basis[i]
        sign[i], sign[best] = sign[best], sign[i]
        _exchange(inverse, Q[basis[i]], i)
    λ = np.zeros(m)
    for i in range(m):
        for a in range(m):
            λ[a] += sign[i] * w[basis[i]] * inverse[i, a]
    v, state = np.zeros(n), np.zeros(n)
    for a in range(m):
        for j in range(n):
            v[j] += rows[a, j] * λ[a]
    for j in range(n):
        if v[j] > w[j]:
            state[j] = 1.0
        elif v[j] < -w[j]:
            state[j] = -1.0
    for i in range(m):
        state[basis[i]] = 0.0
    return inverse, λ, v, state


@numba.njit(cache=True)
@no_type_check
def _exchange(inverse, column, out):
    m = len(column)
    coordinates = np.zeros(m)
    for i in range(m):
        for a in range(m):
            coordinates[i] += inverse[i, a] * column[a]
    for a in range(m):
        inverse[out, a] /= coordinates[out]
    for i in range(m):
        if i != out:
            for a in range(m):
                inverse[i, a] -= coordinates[i] * inverse[out, a]


@numba.njit(cache=True)
@no_type_check
def _finish(rows, b, U, w, basis, inverse, λ, state, r, u, over):
    m, n = rows.shape
    for j in range(n):
        u[j] = U * state[j]
    for i in range(m):
        y = 0.0
        for a in range(m):
            y += inverse[i, a] * r[a]
        u[basis[i]] = min(max(y, -U), U)
    # Recomputed from u and λ alone, whatever has drifted on the way.
    dual, price, missing, most = 0.0, 0.0, 0.0, 0.0
    over[:] = 0.0
    for a in range(m):
        dual += λ[a] * b[a]
        rest = b[a]
        for j in range(n):
            over[j] += rows[a, j] * λ[a]
            rest -= rows[a, j] * u[j]
        missing, most = max(missing, abs(rest)), max(most, abs(b[a]))
    for j in range(n):
        dual -= U * max(0.0, abs(over[j]) - w[j])
        price += w[j] * abs(u[j])
    proven = missing <= PROVEN * (U + most) and abs(price - dual) <= PROVEN * (U + price)
    return (ANSWERED if proven else UNPROVEN), dual


@numba.njit(cache=True)
@no_type_check
def _beyond(rows, b, U, ray, along):
    """Whether the dual grows without bound along a direction."""
    m, n = rows.shape
    gain, most = 0.0, 0.0
    along[:] = 0.0
    for a in range(m):
        gain += ray[a] * b[a]
        for j in range(n):
            along[j] += rows[a, j] * ray[a]
    for j in range(n):
        most += U * abs(along[j])
    return OUT_OF_REACH if gain - most > 1e-13 * (abs(gain) + most) else UNPROVEN
