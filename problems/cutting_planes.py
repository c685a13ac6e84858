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

from problems.certificates import (
    CERTIFICATE_TOLERANCE,
    INFEASIBLE,
    OPTIMAL,
    UNCERTIFIED,
    RightHandSide,
    certifies_infeasibility,
    certify_optimality,
    compute_velocities,
)
from problems.dual_simplex import PRIMAL_TOLERANCE, maximize_dual
from problems.polish import allocate_newton, polish
from problems.tableau import (
    add_row,
    allocate_tableau,
    copy_prefix,
    dot_prefix,
    drop_row,
    extract_controls,
)

MAX_ROUNDS = 100
MAX_REPAIRS = 10  # of a basis that has lost its accuracy
CUT_CAPACITY = 100  # for cuts, and three more a step
NEWTON_THRESHOLD = 1e-2  # by which speeds may be above the limit when Newton's method is tried
BOUND_TOLERANCE_RATIO = 1e-4  # of that, by which the bounds of controls may be broken meanwhile
MIN_ROW_NORM = 1e-100  # size of a row that no control changes; it shows out of reach by itself


class Cuts(NamedTuple):
    """Which step each added row limits, and how; changed in place."""

    step: Array
    normal: Array
    row_norm: Array  # of the row before it was made one long


class SpeedConstraints(NamedTuple):
    """What the speed limit says at some point; changed in place."""

    velocity: Array
    multipliers: Array  # what the multipliers of its cuts come to at each step
    newton_normal: (
        Array  # where Newton's method would have the velocity; zero where it says nothing
    )


@numba.njit(error_model="numpy")
@no_type_check
def _solve_with_cuts(shared, question, d, g, cuts, limits, pivots, basis, sign, x):
    # Climb and cut until no speed is above the limit.
    m, repairs, last, exact = len(question.b), 0, np.inf, PRIMAL_TOLERANCE
    for turn in range(MAX_ROUNDS):
        ended = maximize_dual(d, m, pivots, exact)
        if turn == 0:
            copy_prefix(basis, d.basis, m)
            copy_prefix(sign, d.basic_sign, m)
        extract_controls(d, x)
        if ended == INFEASIBLE:
            _sum_multipliers(d, cuts, m, d.ρ, limits.multipliers)
            if certifies_infeasibility(shared, question, d.ρ, limits.multipliers):
                return INFEASIBLE, np.inf, turn
        if ended != OPTIMAL or (d.row_count[0] > m and _is_inaccurate(d, x, exact)):
            repairs += 1
            if repairs > MAX_REPAIRS:
                return UNCERTIFIED, np.nan, turn
            if ended == UNCERTIFIED:
                exact *= 10
                _restore_basis(d, basis, sign, m)
            d.needs_refactorization[0] = True
            continue
        over = compute_velocities(shared, question, x, limits.velocity) - 1.0
        _sum_multipliers(d, cuts, m, d.λ, limits.multipliers)
        if over <= CERTIFICATE_TOLERANCE:
            verdict, bound = certify_optimality(shared, question, x, d.λ, limits.multipliers)
            if verdict == OPTIMAL or exact == PRIMAL_TOLERANCE:
                return verdict, bound, turn
            exact = PRIMAL_TOLERANCE
            continue
        limits.newton_normal[:] = 0.0
        if over < NEWTON_THRESHOLD and over < last / 2:
            last = over
            verdict, bound = _try_newton(shared, question, d, g, limits, x)
            if verdict == OPTIMAL:
                return verdict, bound, turn
        _drop_inactive_cuts(d, cuts, m)
        if not _add_cuts(shared, question, d, cuts, limits):
            break
        exact = max(PRIMAL_TOLERANCE, BOUND_TOLERANCE_RATIO * over)
    return UNCERTIFIED, np.nan, MAX_ROUNDS


@numba.njit(error_model="numpy")
@no_type_check
def _is_inaccurate(d, x, exact):
    # Whether rows do not hold that should at this basis.
    worst = 0.0
    for a in range(d.row_count[0]):
        rest = d.b[a] - dot_prefix(d.rows[a], x, d.row_end[a])
        worst = max(worst, -rest if d.is_slack_basic[a] else abs(rest))
    return worst > 1e-9 + 100 * exact


@numba.njit(error_model="numpy")
@no_type_check
def _restore_basis(d, basis, sign, m):
    # To a basis without cuts; these stay, with their slacks basic.
    d.needs_refactorization[0] = True
    copy_prefix(d.basis, basis, m)
    copy_prefix(d.basic_sign, sign, m)
    for a in range(m, d.row_count[0]):
        d.basis[a], d.basic_sign[a] = len(d.w) + a, 1.0


@numba.njit(error_model="numpy")
@no_type_check
def _sum_multipliers(d, cuts, m, λ, p):
    p[:] = 0.0
    for i in range(d.row_count[0] - m):
        part = min(λ[m + i], 0.0) / cuts.row_norm[i]
        for c in range(p.shape[1]):
            p[cuts.step[i], c] -= part * cuts.normal[i, c]


@numba.njit(error_model="numpy")
@no_type_check
def _try_newton(shared, question, d, g, limits, x):
    # To where Newton's method leads; the controls are changed only if that is the answer.
    m, (K, axes) = len(question.b), limits.multipliers.shape
    copy_prefix(g.x, x, len(x))
    copy_prefix(g.λ, d.λ, m)
    controls, limited = 0, 0
    for i in range(d.row_count[0]):
        if d.basis[i] < len(x):
            g.free_controls[controls], g.sign[controls] = d.basis[i], d.basic_sign[i]
            controls += 1
    for k in range(K):
        size = 0.0
        for c in range(axes):
            size += limits.multipliers[k, c] ** 2
        if size > 0.0:
            g.active_steps[limited], g.μ[limited] = k, np.sqrt(size)
            limited += 1
    g.counts[0], g.counts[1] = controls, limited
    if not polish(g, shared, question):
        return UNCERTIFIED, np.nan
    limits.multipliers[:] = 0.0
    right = True
    for i in range(limited):
        k = g.active_steps[i]
        right &= g.μ[i] >= 0.0
        for c in range(axes):
            limits.newton_normal[k, c] = g.velocity[i, c]
            limits.multipliers[k, c] = g.μ[i] * g.velocity[i, c]
    for j in range(len(x)):
        right &= abs(g.x[j]) <= 1 + CERTIFICATE_TOLERANCE
        g.x[j] = min(max(g.x[j], -1.0), 1.0)
    if not right:
        return UNCERTIFIED, np.nan
    verdict, bound = certify_optimality(shared, question, g.x, g.λ, limits.multipliers)
    if verdict == OPTIMAL:
        copy_prefix(x, g.x, len(x))
    return verdict, bound


@numba.njit(error_model="numpy")
@no_type_check
def _drop_inactive_cuts(d, cuts, m):
    # Cuts that the velocity does not touch; it comes back to few of them.
    n = len(d.w)
    for i in range(d.row_count[0] - 1, -1, -1):
        row = d.basis[i] - n
        if row >= m and d.basic_value[i] > PRIMAL_TOLERANCE:
            end = d.row_count[0] - 1
            d.basic_value[i] = d.basic_value[end]
            drop_row(d, row)
            cuts.step[row - m], cuts.row_norm[row - m] = cuts.step[end - m], cuts.row_norm[end - m]
            copy_prefix(cuts.normal[row - m], cuts.normal[end - m], cuts.normal.shape[1])


@numba.njit(error_model="numpy")
@no_type_check
def _add_cuts(shared, question, d, cuts, limits):
    # One half-space for each speed above the limit; False where there is no room.
    m, (K, axes, n) = len(question.b), shared.velocity_response.shape
    for k in range(K):
        square, along = 0.0, 0.0
        for c in range(axes):
            square += limits.velocity[k, c] ** 2
            along += limits.velocity[k, c] * limits.newton_normal[k, c]
        speed = np.sqrt(square)
        if speed <= 1 + CERTIFICATE_TOLERANCE / 2:
            continue
        M = d.row_count[0]
        if M >= len(d.b):
            return False
        normal, row = cuts.normal[M - m], d.rows[M]
        row[:], d.b[M], d.row_end[M] = 0.0, 1.0, (k + 1) * (n // (K + 1))
        for c in range(axes):
            # Where Newton's method would go is where the limit will be met.
            better = along > 1 + CERTIFICATE_TOLERANCE / 2
            normal[c] = limits.newton_normal[k, c] if better else limits.velocity[k, c] / speed
            d.b[M] -= normal[c] * question.free_velocity[k, c]
            for j in range(d.row_end[M]):
                row[j] += normal[c] * shared.velocity_response[k, c, j]
        size = np.sqrt(dot_prefix(row, row, n))
        size = size if size > MIN_ROW_NORM else 1.0
        for j in range(n):
            row[j] /= size
        d.b[M] /= size
        cuts.step[M - m], cuts.row_norm[M - m] = k, size
        add_row(d)
    return True


def _compile_kernel(stamp: int) -> Any:
    # Numba compiles anew when the file of a function changes, or what it closes over. The
    # stamp is of all the files that are compiled into this one function.
    @numba.njit(cache=True, nogil=True, error_model="numpy")
    @no_type_check
    def solve_lots(shared, b, free, first, pivots, x, bound, status, rounds):
        (m, n), (K, axes, _) = shared.rows.shape, shared.velocity_response.shape
        room = CUT_CAPACITY + 3 * K if K > 0 else 0
        for lot in range(len(first) - 1 if stamp >= 0 else 0):
            d, g = allocate_tableau(shared.rows, shared.w, room), allocate_newton(n, m, K, axes)
            cuts = Cuts(np.zeros(room, np.int64), np.zeros((room, axes)), np.ones(room))
            limits = SpeedConstraints(np.zeros((K, axes)), np.zeros((K, axes)), np.zeros((K, axes)))
            basis, sign = d.basis.copy(), d.basic_sign.copy()
            for q in range(first[lot], first[lot + 1]):
                # From where the one before in the lot began its cuts.
                d.row_count[0] = m
                _restore_basis(d, basis, sign, m)
                copy_prefix(d.b, b[q], m)
                question = RightHandSide(b[q], free[q])
                status[q], bound[q], rounds[q] = _solve_with_cuts(
                    shared, question, d, g, cuts, limits, pivots, basis, sign, x[q]
                )
                if status[q] != OPTIMAL:
                    x[q] = np.nan

    return solve_lots


KERNEL_FILES = ("certificates", "cutting_planes", "dual_simplex", "polish", "tableau")
_KERNEL_SOURCES = (Path(__file__).with_name(f"{name}.py").read_bytes() for name in KERNEL_FILES)
solve_batch_kernel = _compile_kernel(crc32(b"".join(_KERNEL_SOURCES)))
