"""Least fuel within a speed limit, by cutting planes in the dual simplex method, compiled.

The programme stands in `proof`. The limit is left out at first. Wherever it is broken
then, a half-space is added that touches the ball of allowed velocities in the direction
flown [Kelley1960]; the basis found is a point of the new dual too, and the climb goes on
from there. The value never rises above the optimum. Once all speeds are near the limit,
`polish` looks for the optimum itself. What is found, or said to be out of reach, is judged
by `proof` before it counts.
"""

from pathlib import Path
from typing import Any, NamedTuple, no_type_check
from zlib import crc32

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
from problems.tableau import add_row, copy, desk, dot, drop_row, read

ROUNDS = 100
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


@numba.njit(error_model="numpy")
@no_type_check
def _solve(shared, question, d, g, cuts, limits, pivots, basis, sign, x):
    # Climb and cut until no speed is above the limit.
    m, repairs, last, exact = len(question.b), 0, np.inf, EXACT
    for turn in range(ROUNDS):
        ended = climb(d, m, pivots, exact)
        if turn == 0:
            copy(basis, d.basis, m)
            copy(sign, d.sign, m)
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
                _back(d, basis, sign, m)
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


@numba.njit(error_model="numpy")
@no_type_check
def _drifted(d, x, exact):
    # Whether rows do not hold that should at this basis.
    worst = 0.0
    for a in range(d.used[0]):
        rest = d.b[a] - dot(d.rows[a], x, d.reach[a])
        worst = max(worst, -rest if d.loose[a] else abs(rest))
    return worst > 1e-9 + 100 * exact


@numba.njit(error_model="numpy")
@no_type_check
def _back(d, basis, sign, m):
    # To a basis without cuts; these stay, with their slacks basic.
    d.worn[0] = True
    copy(d.basis, basis, m)
    copy(d.sign, sign, m)
    for a in range(m, d.used[0]):
        d.basis[a], d.sign[a] = len(d.w) + a, 1.0


@numba.njit(error_model="numpy")
@no_type_check
def _together(d, cuts, m, λ, p):
    p[:] = 0.0
    for i in range(d.used[0] - m):
        part = min(λ[m + i], 0.0) / cuts.size[i]
        for c in range(p.shape[1]):
            p[cuts.step[i], c] -= part * cuts.normal[i, c]


@numba.njit(error_model="numpy")
@no_type_check
def _jump(shared, question, d, g, limits, x):
    # To where Newton's method leads; the controls are changed only if that is the answer.
    m, (K, axes) = len(question.b), limits.p.shape
    copy(g.x, x, len(x))
    copy(g.λ, d.λ, m)
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
        for c in range(axes):
            limits.normal[k, c] = g.velocity[i, c]
            limits.p[k, c] = g.μ[i] * g.velocity[i, c]
    for j in range(len(x)):
        right &= abs(g.x[j]) <= 1 + PROVEN
        g.x[j] = min(max(g.x[j], -1.0), 1.0)
    if not right:
        return UNPROVEN, np.nan
    verdict, bound = judge(shared, question, g.x, g.λ, limits.p)
    if verdict == ANSWERED:
        copy(x, g.x, len(x))
    return verdict, bound


@numba.njit(error_model="numpy")
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
            copy(cuts.normal[row - m], cuts.normal[end - m], cuts.normal.shape[1])


@numba.njit(error_model="numpy")
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


def _kernel(stamp: int) -> Any:
    # Numba compiles anew when the file of a function changes, or what it closes over. The
    # stamp is of all the files that are compiled into this one function.
    @numba.njit(cache=True, nogil=True, error_model="numpy")
    @no_type_check
    def solve_lots(shared, b, free, first, pivots, x, bound, status, rounds):
        (m, n), (K, axes, _) = shared.rows.shape, shared.push.shape
        room = ROOM + 3 * K if K > 0 else 0
        for lot in range(len(first) - 1 if stamp >= 0 else 0):
            d, g = desk(shared.rows, shared.w, room), guess(n, m, K, axes)
            cuts = Cuts(np.zeros(room, np.int64), np.zeros((room, axes)), np.ones(room))
            limits = Limits(np.zeros((K, axes)), np.zeros((K, axes)), np.zeros((K, axes)))
            basis, sign = d.basis.copy(), d.sign.copy()
            for q in range(first[lot], first[lot + 1]):
                # From where the one before in the lot began its cuts.
                d.used[0] = m
                _back(d, basis, sign, m)
                copy(d.b, b[q], m)
                question = Question(b[q], free[q])
                status[q], bound[q], rounds[q] = _solve(
                    shared, question, d, g, cuts, limits, pivots, basis, sign, x[q]
                )
                if status[q] != ANSWERED:
                    x[q] = np.nan

    return solve_lots


FILES = ("dual_simplex", "polish", "proof", "speed_cuts", "tableau")
_SOURCES = (Path(__file__).with_name(f"{name}.py").read_bytes() for name in FILES)
solve_lots = _kernel(crc32(b"".join(_SOURCES)))
