"""Least fuel within a speed limit: cutting planes in the dual simplex method, compiled.

`certificates` states the program. The limit is left out at first. Wherever it is violated
then, a half-space is added that touches the ball of allowed velocities in the direction of the
velocity [Kelley1960]; the basis found is a point of the new dual too, and the ascent continues
from there. The value never rises above the optimum. Once all speeds are near the limit, Newton's
method finds the optimum itself (`polish`). Every result is certified before it is returned.
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
MAX_REPAIRS = 10  # refactorizations of an inaccurate basis
CUT_CAPACITY = 100  # cuts, and three more for each step
NEWTON_THRESHOLD = 1e-2  # largest excess of speed at which Newton's method is tried
# Violation of control bounds that is allowed until then, relative to that excess.
BOUND_TOLERANCE_RATIO = 1e-4
MIN_ROW_NORM = 1e-100  # a row of smaller norm is independent of the controls


class Cuts(NamedTuple):
    """Step and normal of each added row; changed in place."""

    step: Array
    normal: Array
    row_norm: Array  # of the row before it was normalized


class SpeedConstraints(NamedTuple):
    """Velocities and multipliers of the speed limit; changed in place."""

    velocity: Array
    multipliers: Array  # summed over the cuts of each step
    newton_normal: Array  # direction of the velocity after Newton's method; zero where unknown


@numba.njit(error_model="numpy")
@no_type_check
def _solve_with_cuts(shared, rhs, d, g, cuts, limits, pivots, basis, sign, x):
    # Maximizes the dual and adds cuts until no speed is above the limit.
    m, repairs, last, exact = len(rhs.b), 0, np.inf, PRIMAL_TOLERANCE
    for cut_round in range(MAX_ROUNDS):
        status = maximize_dual(d, m, pivots, exact)
        if cut_round == 0:
            copy_prefix(basis, d.basis, m)
            copy_prefix(sign, d.basic_sign, m)
        extract_controls(d, x)
        if status == INFEASIBLE:
            _sum_multipliers(d, cuts, m, d.ρ, limits.multipliers)
            if certifies_infeasibility(shared, rhs, d.ρ, limits.multipliers):
                return INFEASIBLE, np.inf
        if status != OPTIMAL or (d.row_count[0] > m and _is_inaccurate(d, x, exact)):
            repairs += 1
            if repairs > MAX_REPAIRS:
                return UNCERTIFIED, np.nan
            if status == UNCERTIFIED:
                exact *= 10
                _restore_basis(d, basis, sign, m)
            d.needs_refactorization[0] = True
            continue
        excess = compute_velocities(shared, rhs, x, limits.velocity) - 1.0
        _sum_multipliers(d, cuts, m, d.λ, limits.multipliers)
        if excess <= CERTIFICATE_TOLERANCE:
            status, bound = certify_optimality(shared, rhs, x, d.λ, limits.multipliers)
            if status == OPTIMAL or exact == PRIMAL_TOLERANCE:
                return status, bound
            exact = PRIMAL_TOLERANCE
            continue
        limits.newton_normal[:] = 0.0
        if excess < NEWTON_THRESHOLD and excess < last / 2:
            last = excess
            status, bound = _try_newton(shared, rhs, d, g, limits, x)
            if status == OPTIMAL:
                return status, bound
        _drop_inactive_cuts(d, cuts, m)
        if not _add_cuts(shared, rhs, d, cuts, limits):
            break
        exact = max(PRIMAL_TOLERANCE, BOUND_TOLERANCE_RATIO * excess)
    return UNCERTIFIED, np.nan


@numba.njit(error_model="numpy")
@no_type_check
def _is_inaccurate(d, x, exact):
    # Tells whether rows are violated that should hold at this basis.
    worst = 0.0
    for a in range(d.row_count[0]):
        rest = d.b[a] - dot_prefix(d.rows[a], x, d.row_end[a])
        worst = max(worst, -rest if d.is_slack_basic[a] else abs(rest))
    return worst > 1e-9 + 100 * exact


@numba.njit(error_model="numpy")
@no_type_check
def _restore_basis(d, basis, sign, m):
    # Returns to a basis without cuts; these stay, with their slacks basic.
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
        multiplier = min(λ[m + i], 0.0) / cuts.row_norm[i]
        for c in range(p.shape[1]):
            p[cuts.step[i], c] -= multiplier * cuts.normal[i, c]


@numba.njit(error_model="numpy")
@no_type_check
def _try_newton(shared, rhs, d, g, limits, x):
    # Applies Newton's method; the controls are changed only if the result is certified.
    m, (K, axes) = len(rhs.b), limits.multipliers.shape
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
    if not polish(g, shared, rhs):
        return UNCERTIFIED, np.nan
    limits.multipliers[:] = 0.0
    is_valid = True
    for i in range(limited):
        k = g.active_steps[i]
        is_valid &= g.μ[i] >= 0.0
        for c in range(axes):
            limits.newton_normal[k, c] = g.velocity[i, c]
            limits.multipliers[k, c] = g.μ[i] * g.velocity[i, c]
    for j in range(len(x)):
        is_valid &= abs(g.x[j]) <= 1 + CERTIFICATE_TOLERANCE
        g.x[j] = min(max(g.x[j], -1.0), 1.0)
    if not is_valid:
        return UNCERTIFIED, np.nan
    status, bound = certify_optimality(shared, rhs, g.x, g.λ, limits.multipliers)
    if status == OPTIMAL:
        copy_prefix(x, g.x, len(x))
    return status, bound


@numba.njit(error_model="numpy")
@no_type_check
def _drop_inactive_cuts(d, cuts, m):
    # Drops cuts that are inactive; few of them become active again.
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
def _add_cuts(shared, rhs, d, cuts, limits):
    # Adds a half-space for each speed above the limit; returns False where there is no room.
    m, (K, axes, n) = len(rhs.b), shared.velocity_response.shape
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
            # Newton's method predicts the direction in which the limit will be active.
            better = along > 1 + CERTIFICATE_TOLERANCE / 2
            normal[c] = limits.newton_normal[k, c] if better else limits.velocity[k, c] / speed
            d.b[M] -= normal[c] * rhs.free_velocity[k, c]
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
    # Numba caches by this function's file alone. The stamp, a checksum of all files that are
    # compiled into it, makes it compile again when any of them changes.
    @numba.njit(cache=True, nogil=True, error_model="numpy")
    @no_type_check
    def solve_batches(shared, b, free_velocity, starts, pivots, x, bound, status):
        (m, n), (K, axes, _) = shared.rows.shape, shared.velocity_response.shape
        room = CUT_CAPACITY + 3 * K if K > 0 else 0
        for batch in range(len(starts) - 1 if stamp >= 0 else 0):
            d, g = allocate_tableau(shared.rows, shared.w, room), allocate_newton(n, m, K, axes)
            cuts = Cuts(np.zeros(room, np.int64), np.zeros((room, axes)), np.ones(room))
            limits = SpeedConstraints(np.zeros((K, axes)), np.zeros((K, axes)), np.zeros((K, axes)))
            basis, sign = d.basis.copy(), d.basic_sign.copy()
            for q in range(starts[batch], starts[batch + 1]):
                # Starts from the basis before the first cuts of the program before.
                d.row_count[0] = m
                _restore_basis(d, basis, sign, m)
                copy_prefix(d.b, b[q], m)
                rhs = RightHandSide(b[q], free_velocity[q])
                status[q], bound[q] = _solve_with_cuts(
                    shared, rhs, d, g, cuts, limits, pivots, basis, sign, x[q]
                )
                if status[q] != OPTIMAL:
                    x[q] = np.nan

    return solve_batches


KERNEL_FILES = ("certificates", "cutting_planes", "dual_simplex", "polish", "tableau")
_KERNEL_SOURCES = (Path(__file__).with_name(f"{name}.py").read_bytes() for name in KERNEL_FILES)
solve_batch_kernel = _compile_kernel(crc32(b"".join(_KERNEL_SOURCES)))
