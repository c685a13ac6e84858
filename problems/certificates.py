"""Certificates of optimality and infeasibility of transfers, compiled.

    minimize  Σ_j w_j |x_j|  subject to  Q x = b,  |x_j| ≤ 1,  ‖s_k + P_k x‖₂ ≤ 1

with velocities s_k + P_k x, everything in units of the limits. For any λ and p_k

    λᵀb + Σ_k (p_kᵀs_k − ‖p_k‖₂) − Σ_j max(0, |v_j| − w_j),   v = Qᵀλ − Σ_k P_kᵀp_k

is a lower bound of the cost; where it is positive with w = 0, no x keeps the limits.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.tableau import dot_prefix

CERTIFICATE_TOLERANCE = 1e-9  # relative, of residuals and gap
GAP_TOLERANCE = 3e-8  # of the gap where the speed limit is active; mostly it is 1e-14

OPTIMAL, INFEASIBLE, UNCERTIFIED = 0, 1, 2


class TransferProgram(NamedTuple):
    """Data that many programs have in common: all but b and s."""

    rows: Float[Array, "m N"]  # Q, of orthonormal rows
    w: Float[Array, " N"]
    velocity_response: Float[Array, "K d N"]  # P, zero for later controls; K = 0 without a limit


class RightHandSide(NamedTuple):
    """Data of one program."""

    b: Float[Array, " m"]
    free_velocity: Float[Array, "K d"]  # s, the velocities without control


@numba.njit(error_model="numpy")
@no_type_check
def certify_optimality(shared, rhs, x, λ, p):
    """Verify that controls keep every limit at the cost of the dual bound; return both."""
    rows, b = shared.rows, rhs.b
    bound, _ = _dual_bound(shared, rhs, λ, p, 1.0)
    cost, residual, largest_b = 0.0, 0.0, 0.0
    for a in range(len(b)):
        residual = max(residual, abs(b[a] - dot_prefix(rows[a], x, len(x))))
        largest_b = max(largest_b, abs(b[a]))
    for j in range(len(x)):
        if abs(x[j]) > 1:
            return UNCERTIFIED, bound
        cost += shared.w[j] * abs(x[j])
    gap = GAP_TOLERANCE if p.any() else CERTIFICATE_TOLERANCE
    certified = (
        residual <= CERTIFICATE_TOLERANCE * (1 + largest_b)
        and abs(cost - bound) <= CERTIFICATE_TOLERANCE + gap * cost
    )
    if certified and len(p) > 0:
        speed = compute_velocities(shared, rhs, x, np.empty(p.shape))
        certified = speed <= 1 + CERTIFICATE_TOLERANCE
    return (OPTIMAL if certified else UNCERTIFIED), bound


@numba.njit(error_model="numpy")
@no_type_check
def certifies_infeasibility(shared, rhs, λ, p):
    """Verify that the dual grows without bound along a direction."""
    value, size = _dual_bound(shared, rhs, λ, p, 0.0)
    return value > 1e-13 * size


@numba.njit(error_model="numpy")
@no_type_check
def compute_velocities(shared, rhs, x, velocity):
    """Return the largest speed under given controls; write the velocities in place."""
    K, d, n = shared.velocity_response.shape
    largest = 0.0
    for k in range(K):
        square = 0.0
        for c in range(d):
            added = dot_prefix(shared.velocity_response[k, c], x, n)
            velocity[k, c] = rhs.free_velocity[k, c] + added
            square += velocity[k, c] ** 2
        largest = max(largest, square)
    return np.sqrt(largest)


@numba.njit(error_model="numpy")
@no_type_check
def _dual_bound(shared, rhs, λ, p, weight):
    # The bound with scaled weights, and the sum of the magnitudes of its terms.
    rows, b, (m, n) = shared.rows, rhs.b, shared.rows.shape
    v = np.zeros(n)
    value, size = 0.0, 0.0
    for a in range(m):
        value += λ[a] * b[a]
        size += abs(λ[a] * b[a])
        for j in range(n):
            v[j] += rows[a, j] * λ[a]
    for k in range(len(p)):
        square = 0.0
        for c in range(p.shape[1]):
            square += p[k, c] ** 2
            value += p[k, c] * rhs.free_velocity[k, c]
            size += abs(p[k, c] * rhs.free_velocity[k, c])
            if p[k, c] != 0.0:
                for j in range(n):
                    v[j] -= shared.velocity_response[k, c, j] * p[k, c]
        value -= np.sqrt(square)
        size += np.sqrt(square)
    for j in range(n):
        over = max(0.0, abs(v[j]) - weight * shared.w[j])
        value -= over
        size += over
    return value, size
