"""What an answer or a verdict is worth, recomputed from its numbers alone, compiled.

    minimise  Σ_j w_j |x_j|  subject to  Q x = b,  |x_j| ≤ 1,  ‖s_k + P_k x‖₂ ≤ 1

with velocities s_k + P_k x, everything in units of the limits. For any λ and p_k whatever

    λᵀb + Σ_k (p_kᵀs_k − ‖p_k‖₂) − Σ_j max(0, |v_j| − w_j),   v = Qᵀλ − Σ_k P_kᵀp_k

is a lower bound on the cost; and where it is positive with w = 0, no x keeps the limits.
"""

from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.tableau import dot_prefix

CERTIFICATE_TOLERANCE = 1e-9  # relative; an answer with a larger residual or gap is not proven
GAP_TOLERANCE = 3e-8  # the same for the gap where speeds are at the limit; most have 1e-14

OPTIMAL, INFEASIBLE, UNCERTIFIED = 0, 1, 2


class TransferProgram(NamedTuple):
    """What many questions have in common: all but b and s."""

    rows: Float[Array, "m N"]  # Q, of orthonormal rows
    w: Float[Array, " N"]
    velocity_response: Float[
        Array, "K d N"
    ]  # P, with zeros for what is burnt later; K = 0 without a limit


class RightHandSide(NamedTuple):
    """What one question asks for."""

    b: Float[Array, " m"]
    free_velocity: Float[Array, "K d"]  # s, the velocities without control


@numba.njit(error_model="numpy")
@no_type_check
def certify_optimality(shared, question, x, λ, p):
    """Whether controls keep every limit and cost what the bound says, and the bound."""
    rows, b = shared.rows, question.b
    bound, _ = _dual_bound(shared, question, λ, p, 1.0)
    price, missing, most = 0.0, 0.0, 0.0
    for a in range(len(b)):
        missing = max(missing, abs(b[a] - dot_prefix(rows[a], x, len(x))))
        most = max(most, abs(b[a]))
    for j in range(len(x)):
        if abs(x[j]) > 1:
            return UNCERTIFIED, bound
        price += shared.w[j] * abs(x[j])
    gap = GAP_TOLERANCE if p.any() else CERTIFICATE_TOLERANCE
    proven = (
        missing <= CERTIFICATE_TOLERANCE * (1 + most)
        and abs(price - bound) <= CERTIFICATE_TOLERANCE + gap * price
    )
    if proven and len(p) > 0:
        proven = (
            compute_velocities(shared, question, x, np.empty(p.shape)) <= 1 + CERTIFICATE_TOLERANCE
        )
    return (OPTIMAL if proven else UNCERTIFIED), bound


@numba.njit(error_model="numpy")
@no_type_check
def certifies_infeasibility(shared, question, λ, p):
    """Whether the dual grows without bound along a direction."""
    value, size = _dual_bound(shared, question, λ, p, 0.0)
    return value > 1e-13 * size


@numba.njit(error_model="numpy")
@no_type_check
def compute_velocities(shared, question, x, velocity):
    """The largest speed under given controls; the velocities are written in place."""
    K, d, n = shared.velocity_response.shape
    largest = 0.0
    for k in range(K):
        square = 0.0
        for c in range(d):
            velocity[k, c] = question.free_velocity[k, c] + dot_prefix(
                shared.velocity_response[k, c], x, n
            )
            square += velocity[k, c] ** 2
        largest = max(largest, square)
    return np.sqrt(largest)


@numba.njit(error_model="numpy")
@no_type_check
def _dual_bound(shared, question, λ, p, weight):
    # The bound with weights times a number, and the sum of the sizes of its terms.
    rows, b, (m, n) = shared.rows, question.b, shared.rows.shape
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
            value += p[k, c] * question.free_velocity[k, c]
            size += abs(p[k, c] * question.free_velocity[k, c])
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
