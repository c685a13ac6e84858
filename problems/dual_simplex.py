"""Dual simplex method with the long-step rule, compiled [Maros2003].

`minimum_fuel` explains the choice of method, and `tableau` states the program. Every basis is a
point of the dual, also after a row is added: the ascent continues from the optimum before.
"""

from typing import no_type_check

import numba
import numpy as np

from problems.certificates import INFEASIBLE, OPTIMAL, UNCERTIFIED
from problems.tableau import pivot, refactorize, set_nonbasic

PRIMAL_TOLERANCE = 1e-11  # largest violation of a bound
ZERO_SLOPE = 1e-11  # a slope of the dual that counts as zero, for rows of norm 1
# Smallest pivot relative to its column; after a smaller one the tableau is refactorized.
MIN_RELATIVE_PIVOT = 1e-7
# Smallest component of the direction, relative to its norm, with which a slack may enter.
MIN_SLACK_PIVOT = 1e-8


@numba.njit(error_model="numpy")
@no_type_check
def maximize_dual(d, equations, pivots, exact):
    """Maximize the dual from the basis of the tableau d.

    Returns OPTIMAL, or INFEASIBLE with the direction of unbounded ascent in `ρ`, or UNCERTIFIED
    after too many pivots.
    """
    M, n, most = d.row_count[0], len(d.w), 0.0
    for a in range(M):
        most = max(most, abs(d.b[a]))
    basis, sign, inverse, rows, α, ρ = d.basis, d.basic_sign, d.basis_inverse, d.rows, d.α, d.ρ
    for _ in range(pivots):
        if d.needs_refactorization[0] and not refactorize(d):
            break
        leaving, worst, up = _select_leaving(d, exact * (1 + most))
        if leaving < 0:
            return OPTIMAL
        left = basis[leaving]
        direction = -1.0 if left >= n else sign[leaving] if up else -sign[leaving]
        α[:] = 0.0
        for a in range(M):
            ρ[a] = direction * inverse[a, leaving]
            for j in range(d.row_end[a]):
                α[j] += rows[a, j] * ρ[a]
        for i in range(M):
            if basis[i] < n:
                α[basis[i]] = 0.0
        if left < n:
            # The leaving control is a kink too, where it may go to zero and on to the other bound.
            α[left] = direction
            d.v[left] = sign[leaving] * d.w[left]
            if up:
                set_nonbasic(d, left, sign[leaving])
        enter, t = _select_entering(d, equations, worst, np.sqrt(d.row_norm[leaving]))
        if enter < 0:
            return INFEASIBLE
        for k in range(n):
            d.v[k] += t * α[k]
        for a in range(M):
            d.λ[a] += t * ρ[a]
        if left >= n:
            d.is_slack_basic[left - n] = False
        if enter < n:
            sense = 1.0 if α[enter] > 0 else -1.0
            sign[leaving] = d.nonbasic_value[enter] if d.nonbasic_value[enter] != 0.0 else sense
            set_nonbasic(d, enter, 0.0)
        else:
            sign[leaving], d.is_slack_basic[enter - n], d.λ[enter - n] = 1.0, True, 0.0
        basis[leaving] = enter
        d.needs_refactorization[0] = pivot(d, enter, leaving) < MIN_RELATIVE_PIVOT
    return UNCERTIFIED


@numba.njit(error_model="numpy")
@no_type_check
def _select_leaving(d, tolerance):
    # Steepest ascent: violation of a bound over the norm of its direction.
    M, n, r, inverse = d.row_count[0], len(d.w), d.residual, d.basis_inverse
    y, norm = d.basic_value, d.row_norm
    for i in range(M):
        y[i], norm[i] = 0.0, 0.0
    for a in range(M):
        for i in range(M):
            y[i] += inverse[a, i] * r[a]
            norm[i] += inverse[a, i] ** 2
    basis, sign = d.basis, d.basic_sign
    leaving, worst, up, steepest = -1, 0.0, False, 0.0
    for i in range(M):
        violation, over = -y[i], False
        if basis[i] < n:
            violation *= sign[i]
            over = -violation - 1.0 > violation
            violation = -violation - 1.0 if over else violation
        if violation > tolerance and violation**2 > steepest * norm[i]:
            leaving, worst, up, steepest = i, violation, over, violation**2 / norm[i]
    return leaving, worst, up


@numba.njit(error_model="numpy")
@no_type_check
def _select_entering(d, equations, slope, length):
    M, n, kinks = d.row_count[0], len(d.w), 0
    w, v, α, state, step, kink = d.w, d.v, d.α, d.nonbasic_value, d.kink_step, d.kink_index
    for j in range(n):
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
    ρ, λ, is_slack_basic = d.ρ, d.λ, d.is_slack_basic
    for a in range(equations, M):
        if not is_slack_basic[a] and ρ[a] > MIN_SLACK_PIVOT * length:
            step[kinks], kink[kinks] = max(0.0, -λ[a] / ρ[a]), n + a
            kinks += 1
    for i in range(kinks // 2 - 1, -1, -1):
        _sift_down(step, kink, i, kinks)
    while kinks > 0:
        j = kink[0]
        if j >= n:
            return j, step[0]  # no slack may be negative: the dual falls beyond this kink
        slope -= abs(α[j])
        if slope <= 0.0:
            return j, step[0]
        kinks -= 1
        step[0], kink[0] = step[kinks], kink[kinks]
        _sift_down(step, kink, 0, kinks)
        # Passing the kink moves the control from a bound to zero, or from zero to a bound.
        sense = 1.0 if α[j] > 0 else -1.0
        set_nonbasic(d, j, sense if state[j] == 0.0 else 0.0)
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
