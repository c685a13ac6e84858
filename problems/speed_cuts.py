"""Least fuel within a speed limit, by cutting planes in the dual simplex method, compiled.

The programme stands in `proof`. The limit is left out at first. Wherever it is broken
then, a half-space is added that touches the ball of allowed velocities in the direction
flown [Kelley1960]; the basis found is a point of the new dual too, and the climb goes on
from there. The value never rises above the optimum. Once all speeds are near the limit,
`polish` looks for the optimum itself. What is found, or said to be out of reach, is judged
by `proof` before it counts.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from numpy import ndarray as Array

from problems.dual_simplex import EXACT, climb
from problems.polish import guess, polish
from problems.proof import (
    ANSWERED,
    OUT_OF_REACH,
    PROVEN,
    UNPROVEN,
    Question,
    judge,
    shows_out_of_reach,
    speeds,
)
from problems.tableau import add_row, desk, dot, drop_row, read

ROUNDS = 200
REPAIRS = 10  # of a basis that has lost its accuracy
ROOM = 100  # for cuts, and three more a step
NEAR = 1e-2  # by which speeds may be above the limit when Newton's method is tried
SHARE = 1e-4  # of that, by which the bounds of controls may be broken meanwhile
NOTHING = 1e-100  # size of a row that no control changes; it shows out of reach by itself


class Cuts(NamedTuple):
    """Which step each added row limits, and how; changed in place."""

    step: Array
    normal: Array
    size: Array  # of the row before it was made one long


class Limits(NamedTuple):
    """What the speed limit says at some point; changed in place."""

    velocity: Array
    p: Array  # what the multipliers of its cuts come to at each step
    normal: Array  # where Newton's method would have the velocity; zero where it says nothing


@numba.njit
@no_type_check
def solve_lot(shared, b, free, pivots, x, bound, status, rounds):
    """Answer one question after the other, each from where the one before began its cuts."""
    (m, n), (K, axes, _) = shared.rows.shape, shared.push.shape
    room = ROOM + 3 * K if K > 0 else 0
    d, g = desk(shared.rows, shared.w, room), guess(n, m, K, axes)
    cuts = Cuts(np.zeros(room, np.int64), np.zeros((room, axes)), np.ones(room))
    limits = Limits(np.zeros((K, axes)), np.zeros((K, axes)), np.zeros((K, axes)))
    basis, sign = d.basis[:m].copy(), d.sign[:m].copy()
    for q in range(len(b)):
        d.used[0], d.worn[0] = m, True
        d.basis[:m], d.sign[:m], d.b[:m] = basis, sign, b[q]
        question = Question(b[q], free[q])
        status[q], bound[q], rounds[q] = _solve(
            shared, question, d, g, cuts, limits, pivots, basis, sign, x[q]
        )
        if status[q] != ANSWERED:
            x[q] = np.nan


@numba.njit
@no_type_check
def _solve(shared, question, d, g, cuts, limits, pivots, basis, sign, x):
    # Climb and cut until no speed is above the limit.
    m, repairs, last, exact = len(question.b), 0, np.inf, EXACT
    for turn in range(ROUNDS):
        ended = climb(d, m, pivots, exact)
        if turn == 0:
            basis[:], sign[:] = d.basis[:m], d.sign[:m]
        read(d, x)
        if ended == OUT_OF_REACH:
            _together(d, cuts, m, d.ρ, limits.p)
            if shows_out_of_reach(shared, question, d.ρ, limits.p):
                return OUT_OF_REACH, np.inf, turn
        if ended != ANSWERED or (d.used[0] > m and _drifted(d, x, exact)):
            repairs += 1
            if repairs > REPAIRS:
                return UNPROVEN, np.nan, turn
            if ended == UNPROVEN:
                exact *= 10
                _back(d, basis, sign)
            d.worn[0] = True
            continue
        over = speeds(shared, question, x, limits.velocity) - 1.0
        _together(d, cuts, m, d.λ, limits.p)
        if over <= PROVEN:
            verdict, bound = judge(shared, question, x, d.λ, limits.p)
            if verdict == ANSWERED or exact == EXACT:
                return verdict, bound, turn
            exact = EXACT
            continue
        limits.normal[:] = 0.0
        if over < NEAR and over < last / 2:
            last = over
            verdict, bound = _jump(shared, question, d, g, limits, x)
            if verdict == ANSWERED:
                return verdict, bound, turn
        _drop(d, cuts, m)
        if not _cut(shared, question, d, cuts, limits):
            break
        exact = max(EXACT, SHARE * over)
    return UNPROVEN, np.nan, ROUNDS


@numba.njit
@no_type_check
def _drifted(d, x, exact):
    # Whether rows do not hold that should at this basis.
    worst = 0.0
    for a in range(d.used[0]):
        rest = d.b[a] - dot(d.rows[a], x, d.reach[a])
        worst = max(worst, -rest if d.loose[a] else abs(rest))
    return worst > 1e-9 + 100 * exact


@numba.njit
@no_type_check
def _back(d, basis, sign):
    # To the basis without cuts; these stay, with their slacks basic.
    m = len(basis)
    d.basis[:m], d.sign[:m] = basis, sign
    for a in range(m, d.used[0]):
        d.basis[a], d.sign[a] = len(d.w) + a, 1.0


@numba.njit
@no_type_check
def _together(d, cuts, m, λ, p):
    p[:] = 0.0
    for i in range(d.used[0] - m):
        part = min(λ[m + i], 0.0) / cuts.size[i]
        for c in range(p.shape[1]):
            p[cuts.step[i], c] -= part * cuts.normal[i, c]


@numba.njit
@no_type_check
def _jump(shared, question, d, g, limits, x):
    # To where Newton's method leads; the controls are changed only if that is the answer.
    m, (K, axes) = len(question.b), limits.p.shape
    g.x[:], g.λ[:] = x, d.λ[:m]
    controls, limited = 0, 0
    for i in range(d.used[0]):
        if d.basis[i] < len(x):
            g.free[controls], g.sign[controls] = d.basis[i], d.sign[i]
            controls += 1
    for k in range(K):
        size = 0.0
        for c in range(axes):
            size += limits.p[k, c] ** 2
        if size > 0.0:
            g.limited[limited], g.μ[limited] = k, np.sqrt(size)
            limited += 1
    g.parts[0], g.parts[1] = controls, limited
    if not polish(g, shared, question):
        return UNPROVEN, np.nan
    limits.p[:] = 0.0
    right = True
    for i in range(limited):
        k = g.limited[i]
        right &= g.μ[i] >= 0.0
        limits.normal[k] = g.velocity[i]
        limits.p[k] = g.μ[i] * g.velocity[i]
    for j in range(len(x)):
        right &= abs(g.x[j]) <= 1 + PROVEN
        g.x[j] = min(max(g.x[j], -1.0), 1.0)
    if not right:
        return UNPROVEN, np.nan
    verdict, bound = judge(shared, question, g.x, g.λ, limits.p)
    if verdict == ANSWERED:
        x[:] = g.x
    return verdict, bound


@numba.njit
@no_type_check
def _drop(d, cuts, m):
    # Cuts that the velocity does not touch; it comes back to few of them.
    n = len(d.w)
    for i in range(d.used[0] - 1, -1, -1):
        row = d.basis[i] - n
        if row >= m and d.y[i] > EXACT:
            end = d.used[0] - 1
            d.y[i] = d.y[end]
            drop_row(d, row)
            cuts.step[row - m], cuts.size[row - m] = cuts.step[end - m], cuts.size[end - m]
            cuts.normal[row - m] = cuts.normal[end - m]


@numba.njit
@no_type_check
def _cut(shared, question, d, cuts, limits):
    # One half-space for each speed above the limit; False where there is no room.
    m, (K, axes, n) = len(question.b), shared.push.shape
    for k in range(K):
        square, along = 0.0, 0.0
        for c in range(axes):
            square += limits.velocity[k, c] ** 2
            along += limits.velocity[k, c] * limits.normal[k, c]
        speed = np.sqrt(square)
        if speed <= 1 + PROVEN / 2:
            continue
        M = d.used[0]
        if M >= len(d.b):
            return False
        normal, row = cuts.normal[M - m], d.rows[M]
        row[:], d.b[M], d.reach[M] = 0.0, 1.0, (k + 1) * (n // (K + 1))
        for c in range(axes):
            # Where Newton's method would go is where the limit will be met.
            better = along > 1 + PROVEN / 2
            normal[c] = limits.normal[k, c] if better else limits.velocity[k, c] / speed
            d.b[M] -= normal[c] * question.free[k, c]
            for j in range(d.reach[M]):
                row[j] += normal[c] * shared.push[k, c, j]
        size = np.sqrt(dot(row, row, n))
        size = size if size > NOTHING else 1.0
        for j in range(n):
            row[j] /= size
        d.b[M] /= size
        cuts.step[M - m], cuts.size[M - m] = k, size
        add_row(d)
    return True
