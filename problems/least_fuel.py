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
from typing import NamedTuple, no_type_check

import numba
import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import csc_array
from scipy.sparse.csgraph import connected_components

from dynamics import Steps
from problems.conic import Conic, Infeasible, solve

PIVOTS = 10_000  # far above what any question took; one that needs more is asked of HiGHS
PROVEN = 1e-9  # relative; an answer with a larger residual or gap is asked of HiGHS
LOTS = 64

ANSWERED, OUT_OF_REACH, UNPROVEN = 0, 1, 2


class Burns(NamedTuple):
    """Answers to every question, each with what proves it."""

    u: Float[Array, "questions T m"]  # [m/s²]; NaN where the end is out of reach
    fuel: Float[Array, " questions"]  # Δt Σ |u| [m/s]; infinite where out of reach
    bound: Float[Array, " questions"]  # Δt × the dual value: weighted fuel is never below it


def least_fuel(
    steps: Steps,
    displacement: Float[Array, "questions n"],
    max_control: float,
    weight: Float[Array, " T"],
    lots: int = LOTS,
) -> Burns:
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
    _check(T, displacement, max_control, weight)
    questions = len(displacement)
    u = np.zeros((questions, T, m))
    fuel, bound = np.zeros(questions), np.zeros(questions)
    for states, inputs in separate_axes(steps):
        C = response(steps)[states][:, :, inputs]
        answer, dual = _answer(C, displacement[:, states], max_control, weight, lots)
        for i, axis in enumerate(inputs):
            u[:, :, axis] = answer[:, :, i]
        fuel += steps.dt * np.abs(answer).sum(axis=(1, 2))
        bound += steps.dt * dual
    beyond = np.isinf(bound)
    u[beyond], fuel[beyond] = np.nan, np.inf
    return Burns(u, fuel, bound)


def _check(T: int, displacement: Array, max_control: float, weight: Array) -> None:
    if T == 0:
        raise ValueError("there must be at least one step to burn in")
    if not (0 < max_control and isfinite(max_control)):
        raise ValueError(f"max_control must be positive and finite, got {max_control}")
    if weight.shape != (T,) or not (weight > 0).all():
        raise ValueError(f"there must be a positive weight for each of {T} steps, got {weight}")
    if not np.isfinite(displacement).all():
        q = int(np.flatnonzero(~np.isfinite(displacement).all(axis=1))[0])
        raise ValueError(f"displacement {q} is not finite: {displacement[q]}")


def response(steps: Steps) -> Float[Array, "n T m"]:
    """C: what a unit of u[k] does to the last state."""
    n, m = steps.B.shape[1:]
    C = np.empty((n, len(steps), m))
    after = np.eye(n)
    for k in reversed(range(len(steps))):
        C[:, k] = after @ steps.B[k]
        after = after @ steps.A[k]
    return C


def separate_axes(steps: Steps) -> list[tuple[Int[Array, " s"], Int[Array, " i"]]]:
    """Groups of states and inputs that do not act on one another."""
    n, m = steps.B.shape[1:]
    acts = np.zeros((n + m, n + m))
    acts[:n, :n] = np.abs(steps.A).sum(axis=0)
    acts[:n, n:] = np.abs(steps.B).sum(axis=0)
    count, group = connected_components(acts, directed=False)
    members = [np.flatnonzero(group == g) for g in range(count)]
    return [(part[part < n], part[part >= n] - n) for part in members]


def _answer(
    C: Float[Array, "s T i"],
    b: Float[Array, "questions s"],
    U: float,
    weight: Float[Array, " T"],
    lots: int,
) -> tuple[Float[Array, "questions T i"], Float[Array, " questions"]]:
    s, T, i = C.shape
    Q, whitened, missed = _whiten(C.reshape(s, T * i), b, U)
    w = np.repeat(weight, i)
    if Q.shape[1] == 0:
        u, dual = np.zeros((len(b), T * i)), np.zeros(len(b))
        u[missed], dual[missed] = np.nan, np.inf
        return u.reshape(len(b), T, i), dual
    u, dual, status = _solve_all(Q, whitened, U, w, max(1, min(len(b), lots)), PIVOTS)
    for q in np.flatnonzero(status == UNPROVEN):
        u[q], dual[q] = _ask_highs(Q, whitened[q], U, w)
    u[missed], dual[missed] = np.nan, np.inf
    return u.reshape(len(b), T, i), dual


def _whiten(
    columns: Float[Array, "s N"], b: Float[Array, "questions s"], U: float
) -> tuple[Float[Array, "N r"], Float[Array, "questions r"], Int[Array, " missed"]]:
    """Rows made orthonormal: the same questions, well conditioned.

    With fewer steps than it takes to reach every state, what no control reaches is left
    out, and questions that ask for it are listed.
    """
    if columns.size == 0:
        return np.zeros((columns.shape[1], 0)), np.zeros((len(b), 0)), np.flatnonzero(b.any(axis=1))
    if np.linalg.matrix_rank(columns) == len(columns):
        Q, R = np.linalg.qr(columns.T)
        whitened = np.linalg.solve(R.T, b.T).T
        return np.ascontiguousarray(Q), np.ascontiguousarray(whitened), np.zeros(0, np.int64)
    # States in metres and in metres a second are made comparable before a rank is read.
    unit = np.maximum(np.abs(columns).max(axis=1, initial=0.0), 1e-300)
    left, size, right = np.linalg.svd(columns / unit[:, None], full_matrices=False)
    keep = size > 1e-12 * size.max(initial=0.0)
    left, size, right = left[:, keep], size[keep], right[keep]
    along = (b / unit) @ left
    missing = np.abs(b / unit - along @ left.T).max(axis=1, initial=0.0)
    missed = np.flatnonzero(missing > PROVEN * (U + np.abs(b / unit).max(axis=1, initial=0.0)))
    return np.ascontiguousarray(right.T), np.ascontiguousarray(along / size), missed


def _ask_highs(
    Q: Float[Array, "N r"], b: Float[Array, " r"], U: float, w: Float[Array, " N"]
) -> tuple[Float[Array, " N"], float]:
    """One question by another way; the dual is infinite where it is out of reach."""
    from problems.solvers import solve_highs

    N, r = Q.shape
    box = np.vstack([np.eye(2 * N), -np.eye(2 * N)])
    A = np.vstack([np.concatenate([Q.T, -Q.T], axis=1), box])
    limits = np.concatenate([b / U, np.ones(2 * N), np.zeros(2 * N)])
    problem = Conic(np.concatenate([w, w]), csc_array(A), limits, r, 4 * N)
    try:
        answer = solve(problem, solve_highs)
    except Infeasible:
        return np.full(N, np.nan), np.inf
    return U * (answer.x[:N] - answer.x[N:]), -U * float(limits @ answer.y)


@numba.njit(cache=True, parallel=True)
@no_type_check
def _solve_all(Q, b, U, w, lots, pivots):
    questions, n = len(b), len(Q)
    u = np.empty((questions, n))
    dual = np.empty(questions)
    status = np.empty(questions, np.int64)
    rows = np.ascontiguousarray(Q.T)
    for lot in numba.prange(lots):
        # Within a lot each question starts from the basis that answered the one before.
        basis, sign = _first_basis(Q)
        for q in range(lot * questions // lots, (lot + 1) * questions // lots):
            status[q], dual[q] = _solve(Q, rows, b[q], U, w, basis, sign, pivots, u[q])
    return u, dual, status


@numba.njit(cache=True)
@no_type_check
def _first_basis(Q):
    # Greedy: each column is the one that reaches furthest out of the span of those before.
    n, m = Q.shape
    rest = Q.copy()
    basis = np.empty(m, np.int64)
    for i in range(m):
        best, size = 0, -1.0
        for j in range(n):
            norm = 0.0
            for a in range(m):
                norm += rest[j, a] ** 2
            if norm > size:
                best, size = j, norm
        basis[i] = best
        axis = rest[best] / np.sqrt(size)
        for j in range(n):
            along = 0.0
            for a in range(m):
                along += rest[j, a] * axis[a]
            for a in range(m):
                rest[j, a] -= along * axis[a]
    return basis, np.ones(m)


@numba.njit(cache=True)
@no_type_check
def _solve(Q, rows, b, U, w, basis, sign, pivots, u):
    """Answer one question; `basis` and `sign` are the start and become the end.

    Returns how it ended and the dual value: infinity, and u = NaN, where b is out of reach.
    """
    n, m = Q.shape
    tolerance = 1e-11 * (U + np.abs(b).max())
    inverse, λ, v, state = _start(Q, rows, w, basis, sign)
    r = b.copy()
    for j in range(n):
        if state[j] != 0.0:
            for a in range(m):
                r[a] -= U * state[j] * Q[j, a]
    α = np.empty(n)
    when = np.empty(2 * n)
    who = np.empty(2 * n, np.int64)
    for _ in range(pivots):
        # The basic control that breaks its bounds by most.
        out, worst, up = -1, tolerance, False
        for i in range(m):
            y = 0.0
            for a in range(m):
                y += inverse[i, a] * r[a]
            y *= sign[i]
            if -y > worst:
                out, worst, up = i, -y, False
            if y - U > worst:
                out, worst, up = i, y - U, True
        if out < 0:
            return _finish(rows, b, U, w, basis, inverse, λ, state, r, u, α)
        turn = sign[out] if up else -sign[out]
        kinks = 0
        α[:] = 0.0
        for a in range(m):
            for j in range(n):
                α[j] += rows[a, j] * inverse[out, a]
        for j in range(n):
            α[j] *= turn
        for i in range(m):
            α[basis[i]] = 0.0
        # The column let go is a kink ahead too, where it is let go towards zero and beyond.
        left = basis[out]
        α[left] = turn
        v[left] = sign[out] * w[left]
        if up:
            state[left] = sign[out]
            for a in range(m):
                r[a] -= U * sign[out] * Q[left, a]
        for j in range(n):
            if abs(α[j]) < 1e-13:
                continue
            ahead = 1.0 if α[j] > 0 else -1.0
            if state[j] == 0.0:
                when[kinks], who[kinks] = max(0.0, (ahead * w[j] - v[j]) / α[j]), j
                kinks += 1
            elif state[j] != ahead:
                when[kinks], who[kinks] = max(0.0, (-ahead * w[j] - v[j]) / α[j]), j
                when[kinks + 1], who[kinks + 1] = max(0.0, (ahead * w[j] - v[j]) / α[j]), j
                kinks += 2
        _heapify(when, who, kinks)
        slope, enter = worst, -1
        while kinks > 0:
            j = who[0]
            slope -= U * abs(α[j])
            if slope <= 0.0:
                enter = j
                break
            kinks -= 1
            when[0], who[0] = when[kinks], who[kinks]
            _sink(when, who, 0, kinks)
            # Passed: the control flips from one bound to nothing, or from nothing to a bound.
            ahead = 1.0 if α[j] > 0 else -1.0
            new = ahead if state[j] == 0.0 else 0.0
            for a in range(m):
                r[a] -= U * (new - state[j]) * Q[j, a]
            state[j] = new
        if enter < 0:
            u[:] = np.nan
            return _beyond(rows, b, U, turn * inverse[out], α), np.inf
        j, t = enter, when[0]
        for k in range(n):
            v[k] += t * α[k]
        for a in range(m):
            λ[a] += t * turn * inverse[out, a]
        ahead = 1.0 if α[j] > 0 else -1.0
        if state[j] != 0.0:
            for a in range(m):
                r[a] += U * state[j] * Q[j, a]
            sign[out] = state[j]
        else:
            sign[out] = ahead
        state[j] = 0.0
        basis[out] = j
        _exchange(inverse, Q[j], out)
    u[:] = np.nan
    return UNPROVEN, np.nan


@numba.njit(cache=True)
@no_type_check
def _heapify(when, who, count):
    for i in range(count // 2 - 1, -1, -1):
        _sink(when, who, i, count)


@numba.njit(cache=True)
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


@numba.njit(cache=True)
@no_type_check
def _start(Q, rows, w, basis, sign):
    n, m = Q.shape
    inverse = np.eye(m)
    for i in range(m):
        # Columns enter one by one where they pivot best: the inverse, by Gauss and Jordan.
        best, size = i, 0.0
        for k in range(i, m):
            along = 0.0
            for a in range(m):
                along += inverse[i, a] * Q[basis[k], a]
            if abs(along) > size:
                best, size = k, abs(along)
        basis[i], basis[best] = basis[best], basis[i]
        sign[i], sign[best] = sign[best], sign[i]
        _exchange(inverse, Q[basis[i]], i)
    λ = np.zeros(m)
    for i in range(m):
        for a in range(m):
            λ[a] += sign[i] * w[basis[i]] * inverse[i, a]
    v, state = np.zeros(n), np.zeros(n)
    for a in range(m):
        for j in range(n):
            v[j] += rows[a, j] * λ[a]
    for j in range(n):
        if v[j] > w[j]:
            state[j] = 1.0
        elif v[j] < -w[j]:
            state[j] = -1.0
    for i in range(m):
        state[basis[i]] = 0.0
    return inverse, λ, v, state


@numba.njit(cache=True)
@no_type_check
def _exchange(inverse, column, out):
    m = len(column)
    coordinates = np.zeros(m)
    for i in range(m):
        for a in range(m):
            coordinates[i] += inverse[i, a] * column[a]
    for a in range(m):
        inverse[out, a] /= coordinates[out]
    for i in range(m):
        if i != out:
            for a in range(m):
                inverse[i, a] -= coordinates[i] * inverse[out, a]


@numba.njit(cache=True)
@no_type_check
def _finish(rows, b, U, w, basis, inverse, λ, state, r, u, over):
    m, n = rows.shape
    for j in range(n):
        u[j] = U * state[j]
    for i in range(m):
        y = 0.0
        for a in range(m):
            y += inverse[i, a] * r[a]
        u[basis[i]] = min(max(y, -U), U)
    # Recomputed from u and λ alone, whatever has drifted on the way.
    dual, price, missing, most = 0.0, 0.0, 0.0, 0.0
    over[:] = 0.0
    for a in range(m):
        dual += λ[a] * b[a]
        rest = b[a]
        for j in range(n):
            over[j] += rows[a, j] * λ[a]
            rest -= rows[a, j] * u[j]
        missing, most = max(missing, abs(rest)), max(most, abs(b[a]))
    for j in range(n):
        dual -= U * max(0.0, abs(over[j]) - w[j])
        price += w[j] * abs(u[j])
    proven = missing <= PROVEN * (U + most) and abs(price - dual) <= PROVEN * (U + price)
    return (ANSWERED if proven else UNPROVEN), dual


@numba.njit(cache=True)
@no_type_check
def _beyond(rows, b, U, ray, along):
    """Whether the dual grows without bound along a direction."""
    m, n = rows.shape
    gain, most = 0.0, 0.0
    along[:] = 0.0
    for a in range(m):
        gain += ray[a] * b[a]
        for j in range(n):
            along[j] += rows[a, j] * ray[a]
    for j in range(n):
        most += U * abs(along[j])
    return OUT_OF_REACH if gain - most > 1e-13 * (abs(gain) + most) else UNPROVEN
