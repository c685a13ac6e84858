"""Least ℓ₁ fuel for one system and very many end points.

    minimise  Σ_j w_j |u_j|   subject to  C u = b,  |u_j| ≤ U

Only b differs from one question to the next. The dual has as many variables as the
state and no constraints,

    maximise  λᵀb − U Σ_j max(0, |c_jᵀλ| − w_j),

so every choice of a basis (as many columns j with |c_jᵀλ| = w_j as there are rows)
is a point of it, and the best basis of one question is a start for the next. From
there the dual simplex method with the long-step rule walks uphill: it lets go of one
basic column and passes kinks of the dual for as long as the slope stays positive
[Maros2003]. It ends after a few pivots at the exact optimum, or with a direction
along which the dual grows without bound, which proves that b is out of reach.
"""

from math import isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import csc_array
from scipy.sparse.csgraph import connected_components

from dynamics import DiscreteModel
from problems.batches import solve_batches
from problems.certificates import UNCERTIFIED, TransferProgram
from problems.conic import ConicProgram, Infeasible, solve
from problems.orthonormal_rows import OrthonormalRows

MAX_PIVOTS = 10_000  # far above what any question took; one that needs more is asked of HiGHS
DEFAULT_BATCHES = 64


class MinimumFuelSolutions(NamedTuple):
    """Answers to every question, each with what proves it."""

    u: Float[Array, "questions T m"]  # [m/s²]; NaN where the end is out of reach
    fuel: Float[Array, " questions"]  # Δt Σ |u| [m/s]; infinite where out of reach
    dual_bound: Float[Array, " questions"]  # Δt × the dual value: weighted fuel is never below it


def solve_minimum_fuel(
    steps: DiscreteModel,
    displacement: Float[Array, "questions n"],
    max_control: float,
    weight: Float[Array, " T"],
    batches: int = DEFAULT_BATCHES,
) -> MinimumFuelSolutions:
    """Least fuel to displace the free motion's end, for many displacements.

    Axes that do not act on one another are separate questions, and are answered so.
    Every answer is checked by its residual and its gap, and every "out of reach" by the
    direction that proves it; what fails is asked of HiGHS.

    Args:
        steps: Dynamics, the same for all.
        displacement: x_f − Φ x₀ − (drift), one row a question.
        max_control: U, the largest |u| on each axis [m/s²].
        weight: Price of a unit of |u[k]|, near 1; a slope in it breaks ties.
        lots: Equal parts into which the questions are split, in their order. Answers do
            not depend on the questions of other lots, not even in the last bit.

    Raises:
        ValueError: There is no step to burn in, or a number that makes no sense.
        Unsolved: Not even HiGHS has an answer that can be proven.
    """
    T, m = len(steps), steps.axes
    _validate(T, displacement, max_control, weight)
    questions = len(displacement)
    u = np.zeros((questions, T, m))
    fuel, bound = np.zeros(questions), np.zeros(questions)
    for states, inputs in decouple_axes(steps):
        C = reachability_matrix(steps)[states][:, :, inputs]
        answer, dual = _solve_decoupled(C, displacement[:, states], max_control, weight, batches)
        for i, axis in enumerate(inputs):
            u[:, :, axis] = answer[:, :, i]
        fuel += steps.dt * np.abs(answer).sum(axis=(1, 2))
        bound += steps.dt * dual
    beyond = np.isinf(bound)
    u[beyond], fuel[beyond] = np.nan, np.inf
    return MinimumFuelSolutions(u, fuel, bound)


def _validate(T: int, displacement: Array, max_control: float, weight: Array) -> None:
    if T == 0:
        raise ValueError("there must be at least one step to burn in")
    if not (0 < max_control and isfinite(max_control)):
        raise ValueError(f"max_control must be positive and finite, got {max_control}")
    if weight.shape != (T,) or not (weight > 0).all():
        raise ValueError(f"there must be a positive weight for each of {T} steps, got {weight}")
    if not np.isfinite(displacement).all():
        q = int(np.flatnonzero(~np.isfinite(displacement).all(axis=1))[0])
        raise ValueError(f"displacement {q} is not finite: {displacement[q]}")


def reachability_matrix(steps: DiscreteModel) -> Float[Array, "n T m"]:
    """C: what a unit of u[k] does to the last state."""
    n, m = steps.B.shape[1:]
    C = np.empty((n, len(steps), m))
    after = np.eye(n)
    for k in reversed(range(len(steps))):
        C[:, k] = after @ steps.B[k]
        after = after @ steps.A[k]
    return C


def decouple_axes(steps: DiscreteModel) -> list[tuple[Int[Array, " s"], Int[Array, " i"]]]:
    """Groups of states and inputs that do not act on one another."""
    n, m = steps.B.shape[1:]
    acts = np.zeros((n + m, n + m))
    acts[:n, :n] = np.abs(steps.A).sum(axis=0)
    acts[:n, n:] = np.abs(steps.B).sum(axis=0)
    count, group = connected_components(acts, directed=False)
    members = [np.flatnonzero(group == g) for g in range(count)]
    return [(part[part < n], part[part >= n] - n) for part in members]


def _solve_decoupled(
    C: Float[Array, "s T i"],
    b: Float[Array, "questions s"],
    U: float,
    weight: Float[Array, " T"],
    lots: int,
) -> tuple[Float[Array, "questions T i"], Float[Array, " questions"]]:
    s, T, i = C.shape
    white = OrthonormalRows.from_matrix(C.reshape(s, T * i))
    Q, (whitened, missed) = white.rows, white.transform(b, U)
    w = np.repeat(weight, i)
    if len(Q) == 0:
        u, dual = np.zeros((len(b), T * i)), np.zeros(len(b))
        u[missed], dual[missed] = np.nan, np.inf
        return u.reshape(len(b), T, i), dual
    lots = max(1, min(len(b), lots))
    first = np.arange(lots + 1) * len(b) // lots
    shared = TransferProgram(Q, w, np.zeros((0, 1, T * i)))
    found = solve_batches(shared, whitened / U, np.zeros((len(b), 0, 1)), first, MAX_PIVOTS)
    u, dual = U * found.x, U * found.dual_bound
    for q in np.flatnonzero(found.status == UNCERTIFIED):
        u[q], dual[q] = _solve_with_highs(Q, whitened[q], U, w)
    u[missed], dual[missed] = np.nan, np.inf
    return u.reshape(len(b), T, i), dual


def _solve_with_highs(
    Q: Float[Array, "r N"], b: Float[Array, " r"], U: float, w: Float[Array, " N"]
) -> tuple[Float[Array, " N"], float]:
    """One question by another way; the dual is infinite where it is out of reach."""
    from problems.solvers import solve_highs

    r, N = Q.shape
    box = np.vstack([np.eye(2 * N), -np.eye(2 * N)])
    A = np.vstack([np.concatenate([Q, -Q], axis=1), box])
    limits = np.concatenate([b / U, np.ones(2 * N), np.zeros(2 * N)])
    problem = ConicProgram(np.concatenate([w, w]), csc_array(A), limits, r, 4 * N)
    try:
        answer = solve(problem, solve_highs)
    except Infeasible:
        return np.full(N, np.nan), np.inf
    return U * (answer.x[:N] - answer.x[N:]), -U * float(limits @ answer.y)
