"""The dual simplex method with the long-step rule, compiled [Maros2003].

Why this way stands in `least_fuel`, and the programme in `tableau`. Every basis is a point
of the dual, also with a row more: rows may be added at the top, and the climb goes on.
"""

from typing import no_type_check

import numba
import numpy as np

from problems.proof import ANSWERED, OUT_OF_REACH, UNPROVEN
from problems.tableau import exchange, flip, start

EXACT = 1e-11  # bounds that are broken by less are kept
FLAT = 1e-11  # a slope of the dual, in rows of length one, that is none
SHARP = 1e-7  # a pivot, against the others of its column, after which all is computed anew
THIN = 1e-8  # the same for slacks, behind which there is no slope at all: too small a pivot


@numba.njit
@no_type_check
def climb(d, equations, pivots, exact):
    """Walk uphill to the top of the dual, after computing everything anew where the desk is worn.

    Returns ANSWERED, or OUT_OF_REACH with the direction of endless ascent in `ρ`, or
    UNPROVEN after too many pivots.
    """
    M, n = d.used[0], len(d.w)
    most = 0.0
    for a in range(M):
        most = max(most, abs(d.b[a]))
    tolerance = exact * (1 + most)
    for _ in range(pivots):
        if d.worn[0] and not start(d):
            break
        out, worst, up = _who_leaves(d, tolerance)
        if out < 0:
            return ANSWERED
        left = d.basis[out]
        turn = -1.0 if left >= n else d.sign[out] if up else -d.sign[out]
        d.α[:] = 0.0
        for a in range(M):
            step = d.ρ[a] = turn * d.inverse[a, out]
            for j in range(d.reach[a]):
                d.α[j] += d.rows[a, j] * step
        for i in range(M):
            if d.basis[i] < n:
                d.α[d.basis[i]] = 0.0
        if left < n:
            # It is a kink ahead too, where it is let go towards zero and beyond.
            d.α[left] = turn
            d.v[left] = d.sign[out] * d.w[left]
            if up:
                flip(d, left, d.sign[out])
        enter, t = _who_enters(d, equations, worst, np.sqrt(d.norm[out]))
        if enter < 0:
            return OUT_OF_REACH
        for k in range(n):
            d.v[k] += t * d.α[k]
        for a in range(M):
            d.λ[a] += t * d.ρ[a]
        if left >= n:
            d.loose[left - n] = False
        if enter < n:
            ahead = 1.0 if d.α[enter] > 0 else -1.0
            d.sign[out] = d.state[enter] if d.state[enter] != 0.0 else ahead
            flip(d, enter, 0.0)
        else:
            d.sign[out], d.loose[enter - n], d.λ[enter - n] = 1.0, True, 0.0
        d.basis[out] = enter
        d.worn[0] = exchange(d, enter, out) < SHARP
    return UNPROVEN


@numba.njit
@no_type_check
def _who_leaves(d, tolerance):
    # The steepest way uphill: by how much a bound is broken, over the length of the direction.
    M, n = d.used[0], len(d.w)
    d.y[:M], d.norm[:M] = 0.0, 0.0
    for a in range(M):
        r = d.r[a]
        for i in range(M):
            d.y[i] += d.inverse[a, i] * r
            d.norm[i] += d.inverse[a, i] ** 2
    out, worst, up, steepest = -1, 0.0, False, 0.0
    for i in range(M):
        broken, over = -d.y[i], False
        if d.basis[i] < n:
            broken *= d.sign[i]
            over = -broken - 1.0 > broken
            broken = -broken - 1.0 if over else broken
        if broken > tolerance and broken**2 > steepest * d.norm[i]:
            out, worst, up, steepest = i, broken, over, broken**2 / d.norm[i]
    return out, worst, up


@numba.njit
@no_type_check
def _who_enters(d, equations, slope, length):
    M, n, kinks = d.used[0], len(d.w), 0
    for j in range(n):
        if abs(d.α[j]) < FLAT * length:
            continue
        ahead = 1.0 if d.α[j] > 0 else -1.0
        if d.state[j] == 0.0:
            d.when[kinks], d.who[kinks] = max(0.0, (ahead * d.w[j] - d.v[j]) / d.α[j]), j
            kinks += 1
        elif d.state[j] != ahead:
            d.when[kinks], d.who[kinks] = max(0.0, (-ahead * d.w[j] - d.v[j]) / d.α[j]), j
            d.when[kinks + 1], d.who[kinks + 1] = max(0.0, (ahead * d.w[j] - d.v[j]) / d.α[j]), j
            kinks += 2
    for a in range(equations, M):
        if not d.loose[a] and d.ρ[a] > THIN * length:
            d.when[kinks], d.who[kinks] = max(0.0, -d.λ[a] / d.ρ[a]), n + a
            kinks += 1
    for i in range(kinks // 2 - 1, -1, -1):
        _sink(d.when, d.who, i, kinks)
    while kinks > 0:
        j = d.who[0]
        if j >= n:
            return j, d.when[0]  # no slack is negative: behind this kink the dual falls at once
        slope -= abs(d.α[j])
        if slope <= 0.0:
            return j, d.when[0]
        kinks -= 1
        d.when[0], d.who[0] = d.when[kinks], d.who[kinks]
        _sink(d.when, d.who, 0, kinks)
        # Passed: the control flips from one bound to nothing, or from nothing to a bound.
        ahead = 1.0 if d.α[j] > 0 else -1.0
        flip(d, j, ahead if d.state[j] == 0.0 else 0.0)
    return -1, 0.0


@numba.njit
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
