"""The dual simplex method with the long-step rule, compiled [Maros2003].

Why this way stands in `least_fuel`, and the programme in `tableau`. Every basis is a point
of the dual, also with a row more: rows may be added at the top, and the climb goes on.
"""

from typing import no_type_check

import numba
import numpy as np

from problems.certificates import INFEASIBLE, OPTIMAL, UNCERTIFIED
from problems.tableau import pivot, refactorize, set_nonbasic

PRIMAL_TOLERANCE = 1e-11  # bounds that are broken by less are kept
ZERO_SLOPE = 1e-11  # a slope of the dual, in rows of length one, that is none
MIN_RELATIVE_PIVOT = (
    1e-7  # a pivot, against the others of its column, after which all is computed anew
)
MIN_SLACK_PIVOT = (
    1e-8  # the same for slacks, behind which there is no slope at all: too small a pivot
)


@numba.njit(error_model="numpy")
@no_type_check
def maximize_dual(d, equations, pivots, exact):
    """Walk uphill to the top of the dual, after computing everything anew where the desk is worn.

    Returns ANSWERED, or OUT_OF_REACH with the direction of endless ascent in `ρ`, or
    UNPROVEN after too many pivots.
    """
    M, n, most = d.row_count[0], len(d.w), 0.0
    for a in range(M):
        most = max(most, abs(d.b[a]))
    basis, sign, inverse, rows, α, ρ = d.basis, d.basic_sign, d.basis_inverse, d.rows, d.α, d.ρ
    for _ in range(pivots):
        if d.needs_refactorization[0] and not refactorize(d):
            break
        out, worst, up = _select_leaving(d, exact * (1 + most))
        if out < 0:
            return OPTIMAL
        left = basis[out]
        turn = -1.0 if left >= n else sign[out] if up else -sign[out]
        α[:] = 0.0
        for a in range(M):
            ρ[a] = turn * inverse[a, out]
            for j in range(d.row_end[a]):
                α[j] += rows[a, j] * ρ[a]
        for i in range(M):
            if basis[i] < n:
                α[basis[i]] = 0.0
        if left < n:
            # It is a kink ahead too, where it is let go towards zero and beyond.
            α[left] = turn
            d.v[left] = sign[out] * d.w[left]
            if up:
                set_nonbasic(d, left, sign[out])
        enter, t = _select_entering(d, equations, worst, np.sqrt(d.row_norm[out]))
        if enter < 0:
            return INFEASIBLE
        for k in range(n):
            d.v[k] += t * α[k]
        for a in range(M):
            d.λ[a] += t * ρ[a]
        if left >= n:
            d.is_slack_basic[left - n] = False
        if enter < n:
            ahead = 1.0 if α[enter] > 0 else -1.0
            sign[out] = d.nonbasic_value[enter] if d.nonbasic_value[enter] != 0.0 else ahead
            set_nonbasic(d, enter, 0.0)
        else:
            sign[out], d.is_slack_basic[enter - n], d.λ[enter - n] = 1.0, True, 0.0
        basis[out] = enter
        d.needs_refactorization[0] = pivot(d, enter, out) < MIN_RELATIVE_PIVOT
    return UNCERTIFIED


@numba.njit(error_model="numpy")
@no_type_check
def _select_leaving(d, tolerance):
    # The steepest way uphill: by how much a bound is broken, over the length of the direction.
    M, n, r, inverse, y, norm = (
        d.row_count[0],
        len(d.w),
        d.residual,
        d.basis_inverse,
        d.basic_value,
        d.row_norm,
    )
    for i in range(M):
        y[i], norm[i] = 0.0, 0.0
    for a in range(M):
        for i in range(M):
            y[i] += inverse[a, i] * r[a]
            norm[i] += inverse[a, i] ** 2
    basis, sign = d.basis, d.basic_sign
    out, worst, up, steepest = -1, 0.0, False, 0.0
    for i in range(M):
        broken, over = -y[i], False
        if basis[i] < n:
            broken *= sign[i]
            over = -broken - 1.0 > broken
            broken = -broken - 1.0 if over else broken
        if broken > tolerance and broken**2 > steepest * norm[i]:
            out, worst, up, steepest = i, broken, over, broken**2 / norm[i]
    return out, worst, up


@numba.njit(error_model="numpy")
@no_type_check
def _select_entering(d, equations, slope, length):
    M, n, kinks = d.row_count[0], len(d.w), 0
    w, v, α, state, when, who = d.w, d.v, d.α, d.nonbasic_value, d.kink_step, d.kink_index
    for j in range(n):
        if abs(α[j]) < ZERO_SLOPE * length:
            continue
        ahead = 1.0 if α[j] > 0 else -1.0
        if state[j] == 0.0:
            when[kinks], who[kinks] = max(0.0, (ahead * w[j] - v[j]) / α[j]), j
            kinks += 1
        elif state[j] != ahead:
            when[kinks], who[kinks] = max(0.0, (-ahead * w[j] - v[j]) / α[j]), j
            when[kinks + 1], who[kinks + 1] = max(0.0, (ahead * w[j] - v[j]) / α[j]), j
            kinks += 2
    ρ, λ, loose = d.ρ, d.λ, d.is_slack_basic
    for a in range(equations, M):
        if not loose[a] and ρ[a] > MIN_SLACK_PIVOT * length:
            when[kinks], who[kinks] = max(0.0, -λ[a] / ρ[a]), n + a
            kinks += 1
    for i in range(kinks // 2 - 1, -1, -1):
        _sift_down(when, who, i, kinks)
    while kinks > 0:
        j = who[0]
        if j >= n:
            return j, when[0]  # no slack is negative: behind this kink the dual falls at once
        slope -= abs(α[j])
        if slope <= 0.0:
            return j, when[0]
        kinks -= 1
        when[0], who[0] = when[kinks], who[kinks]
        _sift_down(when, who, 0, kinks)
        # Passed: the control flips from one bound to nothing, or from nothing to a bound.
        ahead = 1.0 if α[j] > 0 else -1.0
        set_nonbasic(d, j, ahead if state[j] == 0.0 else 0.0)
    return -1, 0.0


@numba.njit(error_model="numpy")
@no_type_check
def _sift_down(when, who, i, count):
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
