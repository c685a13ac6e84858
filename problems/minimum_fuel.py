"""Least ℓ₁ fuel of linear systems, above all of one for very many displacements.

    minimize  Σ_j w_j |u_j|   subject to  C u = b,  |u_j| ≤ U

Only b differs from one program to the next. The dual has as many variables as the
state and no constraints,

    maximize  λᵀb − U Σ_j max(0, |c_jᵀλ| − w_j),

so every choice of a basis (as many columns j with |c_jᵀλ| = w_j as there are rows)
is a point of it, and the optimal basis of one program is a start for the next. From
there the dual simplex method with the long-step rule ascends: one column leaves the basis,
and kinks of the dual are passed for as long as the slope stays positive [Maros2003]. It ends
after a few pivots at the exact optimum, or with a direction along which the dual grows without
bound, which certifies that b is unreachable.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Gt
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.sparse import csc_array
from scipy.sparse.csgraph import connected_components

from dynamics import DiscreteModel
from dynamics.doors import checked
from dynamics.inputs import InputError
from problems.bang_off_bang import is_concave, solve_burns
from problems.conic import ConicProgram, Infeasible, solve
from problems.dual_simplex import INFEASIBLE, OPTIMAL, choose_basis, solve_batches
from problems.limit import Bound, Limit

MAX_PIVOTS = 10_000  # far above any number seen; HiGHS solves a program that needs more
DEFAULT_BATCHES = 64
MIN_PARALLEL = 500  # programs that are worth starting threads for
TASKS_PER_CORE = 8  # some batches take far longer than others: small tasks balance the cores
CERTIFICATE_BATCH = 256  # whose certificates stay in the cache of a core
CERTIFICATE_TOLERANCE = 1e-9  # relative, of residuals and gap


class MinimumFuelSolutions(NamedTuple):
    """Solutions of many programs."""

    u: Float[Array, "programs T m"]  # [m/s²]; NaN where unreachable
    fuel: Float[Array, " programs"]  # Δt Σ |u| [m/s]; infinite where unreachable


@checked
def solve_minimum_fuel(
    steps: DiscreteModel,
    displacement: Float[Array, "programs n"],
    max_control: Annotated[Bound, Gt(0)],
    weight: Annotated[Float[Array, " T"], Gt(0)],
    batches: Annotated[int, Ge(1)] = DEFAULT_BATCHES,
) -> MinimumFuelSolutions:
    """Solve many transfers of least fuel without a speed limit.

    Those of a double integrator, with weights that are concave in time, have a closed form, see
    `bang_off_bang`. Of other models, axes that do not act on one another are solved separately.
    Every solution is verified by its residual and its gap, and every infeasibility by its
    certificate; HiGHS solves the programs where this fails.

    Args:
        steps: Dynamics, the same for all, or those of each program.
        displacement: x_f − Φ x₀ − (drift), a row for each program [m, m/s].
        max_control: U, the largest |u| on each axis, or one entry an axis [m/s²].
        weight: Weights of |u[k]|, near 1; see `tie_break_weights`.
        batches: Equal parts into which the programs are split, in their order. Solutions do
            not depend on the programs of other batches, not even in the last bit.

    Raises:
        ValueError: There is no step, or a displacement, weight or limit is not valid.
        Unsolved: The solution of HiGHS fails verification too.
    """
    T, count = len(steps), len(displacement)
    if T == 0:
        raise ValueError("a transfer needs at least one step")
    if len(weight) != T:
        raise InputError("weight", f"must have an entry for each of {T} steps, got {len(weight)}")
    if steps.A.ndim > 3 or not (steps.is_double_integrator and is_concave(weight)):
        u, is_reachable = _solve_by_simplex(steps, displacement, max_control, weight, batches)
    else:
        position, velocity = np.split(displacement, 2, axis=1)
        burns = solve_burns(position, velocity, steps, max_control)
        u = np.swapaxes(burns.controls(T), 1, 2) * max_control
        is_reachable = np.asarray(burns.is_reachable.all(axis=1))
        rest = np.asarray(~burns.is_certified.all(axis=1))
        if rest.any():
            own = displacement[rest], max_control, weight, count
            u[rest], is_reachable[rest] = _solve_by_simplex(steps, *own)
    u[~is_reachable] = np.nan
    fuel = np.where(is_reachable, steps.dt * np.abs(u).sum(axis=(1, 2)), np.inf)
    return MinimumFuelSolutions(u, fuel)


def _solve_by_simplex(
    steps: DiscreteModel,
    displacement: Float[Array, "programs n"],
    max_control: Bound,
    weight: Float[Array, " T"],
    batches: int,
) -> tuple[Float[Array, "programs T m"], Bool[Array, " programs"]]:
    """Return the controls, and True for what they reach."""
    count, responses = len(displacement), reachability_matrix(steps)
    u, is_reachable = np.zeros((count, len(steps), steps.axes)), np.ones(count, dtype=bool)
    if steps.A.ndim == 3:
        parts = [(slice(None), responses)]
    else:
        parts = [(slice(q, q + 1), C) for q, C in enumerate(responses)]
    for states, inputs in decouple_axes(steps):
        each = np.broadcast_to(max_control, steps.axes)[inputs]
        limit = Limit(each if len(each) else np.max(max_control), "inf", len(inputs))
        for own, C in parts:
            b = displacement[own, states]
            found = _solve_decoupled(C[states][:, :, inputs], b, limit, weight, batches)
            u[own, :, inputs], can_reach = found
            is_reachable[own] &= can_reach
    return u, is_reachable


@checked
def reachability_matrix(steps: DiscreteModel) -> Float[Array, "*agents n T m"]:
    """Compute C, the response of the last state to a unit of each u[k]."""
    C = np.empty_like(np.swapaxes(steps.B, -3, -2))
    transition = np.eye(C.shape[-3])  # from step k + 1 to the last
    for k in reversed(range(len(steps))):
        C[..., k, :] = transition @ steps.B[..., k, :, :]
        transition = transition @ steps.A[..., k, :, :]
    return C


def decouple_axes(steps: DiscreteModel) -> list[tuple[Int[Array, " s"], Int[Array, " i"]]]:
    """Find the groups of states and inputs that do not act on one another."""
    n, m = steps.B.shape[-2:]
    act = np.zeros((n + m, n + m), dtype=bool)
    act[:n, :n] = steps.A.reshape(-1, n, n).any(axis=0)
    act[:n, n:] = steps.B.reshape(-1, n, m).any(axis=0)
    count, label = connected_components(act, directed=False)
    groups = [np.flatnonzero(label == k) for k in range(count)]
    return [(group[group < n], group[group >= n] - n) for group in groups]


def _solve_decoupled(
    C: Float[Array, "s T i"],
    b: Float[Array, "programs s"],
    limit: Limit,
    weight: Float[Array, " T"],
    batches: int,
) -> tuple[Float[Array, "programs T i"], Bool[Array, " programs"]]:
    # In units of its axis's limit every control is at most 1, and weighs as much as it is.
    (s, T, i), U = C.shape, limit.most
    orthonormal = OrthonormalRows.from_matrix((C * limit.shares).reshape(s, T * i))
    Q, (transformed, unreachable) = orthonormal.rows, orthonormal.transform(b, U)
    x, w = np.zeros((len(b), T * i)), np.outer(weight, limit.shares).ravel()
    is_reachable = np.ones(len(b), dtype=bool)
    if len(Q) > 0:
        x, is_certified, is_infeasible = _solve_parallel(Q, w, transformed / U, batches)
        is_reachable = ~is_infeasible
        for q in np.flatnonzero(~is_certified):
            x[q], is_reachable[q] = _solve_with_highs(Q, transformed[q] / U, w)
    is_reachable[unreachable] = False
    x *= np.tile(U * limit.shares, T)
    return x.reshape(len(b), T, i), is_reachable


def _solve_parallel(
    Q: Float[Array, "m N"], w: Float[Array, " N"], b: Float[Array, "programs m"], batches: int
) -> tuple[Float[Array, "programs N"], Bool[Array, " programs"], Bool[Array, " programs"]]:
    """Return the solutions, True where they are certified, and where they are infeasible."""
    x, λ, status = np.zeros((len(b), len(w))), np.zeros(b.shape), np.zeros(len(b), np.int64)
    is_certified, is_infeasible = np.zeros((2, len(b)), dtype=bool)
    batches, first_basis = max(1, min(len(b), batches)), choose_basis(Q)
    starts = np.arange(batches + 1) * len(b) // batches
    threads = os.cpu_count() or 1
    tasks = min(batches, TASKS_PER_CORE * threads) if len(b) >= MIN_PARALLEL else 1

    def solve_some(task: int) -> None:
        own = starts[task * batches // tasks : (task + 1) * batches // tasks + 1]
        solve_batches(Q, first_basis, w, b, own, MAX_PIVOTS, x, λ, status)
        for first in range(own[0], own[-1], CERTIFICATE_BATCH):
            few = slice(first, min(first + CERTIFICATE_BATCH, own[-1]))
            parts = b[few], x[few], λ[few], status[few]
            is_certified[few], is_infeasible[few] = _certify(Q, w, *parts)

    if tasks == 1:
        solve_some(0)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(solve_some, range(tasks)))
    return x, is_certified, is_infeasible


def _certify(
    Q: Float[Array, "m N"],
    w: Float[Array, " N"],
    b: Float[Array, "programs m"],
    x: Float[Array, "programs N"],
    λ: Float[Array, "programs m"],
    status: Int[Array, " programs"],
) -> tuple[Bool[Array, " programs"], Bool[Array, " programs"]]:
    # For any λ the bound is at most the optimum; where it is positive with w = 0, no x exists.
    along, value, v = λ * b, (λ * b).sum(axis=1), np.abs(λ @ Q)
    bound = value - np.maximum(0, v - w).sum(axis=1)
    cost, residual = np.abs(x) @ w, np.abs(x @ Q.T - b).max(axis=1)
    is_met = residual <= CERTIFICATE_TOLERANCE * (1 + np.abs(b).max(axis=1))
    is_optimal = is_met & (np.abs(cost - bound) <= CERTIFICATE_TOLERANCE * (1 + cost))
    size = np.abs(along).sum(axis=1) + v.sum(axis=1)
    is_infeasible = (value - v.sum(axis=1) > 1e-13 * size) & (status == INFEASIBLE)
    return is_infeasible | (is_optimal & (status == OPTIMAL)), is_infeasible


@dataclass(frozen=True, eq=False)
class OrthonormalRows:
    """Equations Q u = b' in place of C u = b, which makes them well conditioned.

    With too few steps to reach every state, Q has fewer rows than C, and `transform` lists the
    right-hand sides that no control reaches.
    """

    rows: Float[Array, "r N"]  # Q
    factor: Float[Array, "s r"]  # L of C = L Q, in the units below
    row_scale: Float[Array, " s"]  # of the rows of C
    has_full_rank: bool  # True where Q has as many rows as C

    @classmethod
    def from_matrix(cls, C: Float[Array, "s N"]) -> "OrthonormalRows":
        """Orthonormalize the rows of C."""
        s, N = C.shape
        if N == 0:
            return cls(np.zeros((0, 0)), np.zeros((s, 0)), np.ones(s), False)
        if s == 0 or np.linalg.matrix_rank(C) == s:
            Q, R = np.linalg.qr(C.T)
            return cls(np.ascontiguousarray(Q.T), R.T, np.ones(s), True)
        # Positions and velocities are made comparable before the rank is determined.
        unit = np.maximum(np.abs(C).max(axis=1, initial=0.0), 1e-300)
        left, size, right = np.linalg.svd(C / unit[:, None], full_matrices=False)
        keep = size > 1e-12 * size.max(initial=0.0)
        return cls(right[keep], left[:, keep] * size[keep], unit, False)

    def transform(
        self, b: Float[Array, "programs s"], U: float
    ) -> tuple[Float[Array, "programs r"], Int[Array, " unreachable"]]:
        """Compute b', and the indices of those that no control reaches, at the scale U."""
        b = b / self.row_scale
        if self.has_full_rank:
            transformed = np.linalg.solve(self.factor, b.T).T
            return np.ascontiguousarray(transformed), np.zeros(0, np.int64)
        transformed = b @ np.linalg.pinv(self.factor).T
        residual = np.abs(b - transformed @ self.factor.T).max(axis=1, initial=0.0)
        unreachable = residual > CERTIFICATE_TOLERANCE * (U + np.abs(b).max(axis=1, initial=0.0))
        return np.ascontiguousarray(transformed), np.flatnonzero(unreachable)


def _solve_with_highs(
    Q: Float[Array, "r N"], b: Float[Array, " r"], w: Float[Array, " N"]
) -> tuple[Float[Array, " N"], bool]:
    """Solve one program; False where it is infeasible."""
    from problems.solvers import solve_highs

    r, N = Q.shape
    A = np.vstack([np.concatenate([Q, -Q], axis=1), np.eye(2 * N), -np.eye(2 * N)])
    limits = np.concatenate([b, np.ones(2 * N), np.zeros(2 * N)])
    problem = ConicProgram(np.concatenate([w, w]), csc_array(A), limits, r, 4 * N)
    try:
        found = solve(problem, solve_highs)
    except Infeasible:
        return np.zeros(N), False
    return found.x[:N] - found.x[N:], True
