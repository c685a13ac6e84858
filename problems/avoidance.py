"""Avoidance problem: transfer among collision half-spaces [Morgan2016, Problems 5 and 7].

Half-spaces hold for the control points of the trajectory between samples, not only at the
samples. A trajectory lies in the convex hull of its control points, so it keeps the distance
in continuous time.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import csc_array

from dynamics.model import ControlSamples, StateSamples
from problems.conic import ConicProgram, solve
from problems.solvers import solve_clarabel
from problems.transfer import Trajectory, TransferProblem, solve_cvxpy

Relaxation = Literal["none", "terminal", "separation"]

RELAXATION_PENALTY = 1e3  # per meter of error, over the fuel that flies a meter


class HalfSpaces(NamedTuple):
    """Linear constraints state_coeffs · x[step] + control_coeffs · u[step] ≥ rhs, one a row."""

    step_index: Int[Array, " rows"]
    state_coeffs: Float[Array, "rows n"]
    control_coeffs: Float[Array, "rows m"]
    rhs: Float[Array, " rows"]

    def violation(self, x: StateSamples, u: ControlSamples) -> Float[Array, " rows"]:
        """Compute rhs minus the left-hand side of each row; positive where it is violated."""
        on_x = (self.state_coeffs * x[self.step_index]).sum(1)
        on_u = (self.control_coeffs * u[self.step_index]).sum(1)
        return np.asarray(self.rhs - (on_x + on_u))

    def to_cvxpy(self, x: Any, u: Any) -> Any:
        """Express the left-hand sides in CVXPY variables."""
        import cvxpy as cp

        on_x = cp.sum(cp.multiply(self.state_coeffs, x[self.step_index]), axis=1)
        return on_x + cp.sum(cp.multiply(self.control_coeffs, u[self.step_index]), axis=1)

    def select(self, rows: Array) -> "HalfSpaces":
        """Select rows by a mask or by index."""
        return HalfSpaces(*(field[rows] for field in self))


class AvoidanceResult(NamedTuple):
    """Trajectory among half-spaces and the violations that its relaxation admits."""

    trajectory: Trajectory
    terminal_error: float  # ‖x[T] − goal‖_∞ [m or m/s]; 0 where it may not be relaxed
    slack: float  # largest violation of a half-space [m]; 0 where it may not be relaxed


@dataclass(frozen=True, eq=False)
class AvoidanceProblem:
    """Fuel-optimal transfer inside half-spaces.

        minimize    Δt Σ w[k] ‖u[k]‖_q
        subject to  (10), (12), (14), (18), (66)      as in `TransferProblem`
                    n · (c(x[k], u[k]) − c̄) ≥ R       (38), (64), for each control point

    A relaxation admits violations at a penalty far above fuel: "none", of the terminal state
    ("terminal"), or of the terminal state and, ten times as dear, of the half-spaces
    ("separation").
    """

    transfer: TransferProblem

    def solve(
        self,
        start: Float[Array, " n"],
        goal: Float[Array, " n"],
        half_spaces: HalfSpaces,
        relaxation: Relaxation = "none",
    ) -> AvoidanceResult:
        """Solve the transfer from start to goal inside the half-spaces.

        Raises:
            Infeasible: No trajectory satisfies the constraints that remain.
            Unsolved: The solver stopped for any other reason.
            ValueError: The transfer has no steps.
        """
        self.transfer.require_steps()
        if (self.transfer.fuel_norm, self.transfer.control_norm) == (1, "inf"):
            return self._solve_condensed(start, goal, half_spaces, relaxation)
        return self.solve_cvxpy(start, goal, half_spaces, relaxation)

    def solve_cvxpy(
        self, start: Array, goal: Array, half_spaces: HalfSpaces, relaxation: Relaxation = "none"
    ) -> AvoidanceResult:
        """Solve the same problem in CVXPY, for any norms and as a second opinion."""
        import cvxpy as cp

        T, n = len(self.transfer.model), len(start)
        x, u, effort, limits = self.transfer.build_cvxpy(start)
        terminal_error, slack = cp.Variable(n), cp.Variable(len(half_spaces.rhs), nonneg=True)
        terminal = x[T] + terminal_error == goal
        kept = half_spaces.to_cvxpy(x, u)
        separation = [kept + slack >= half_spaces.rhs] if len(half_spaces.rhs) else []
        penalty = self._penalty
        error_cost = cp.norm1(cp.multiply(self._terminal_error_weights, terminal_error))
        cost = effort + penalty * (error_cost + 10 * cp.sum(slack))
        fixed = []
        if relaxation == "none":
            fixed.append(terminal_error == 0)
        if relaxation != "separation":
            fixed.append(slack == 0)
        problem = cp.Problem(cp.Minimize(cost), [*limits, terminal, *separation, *fixed])
        solve_cvxpy(self, problem)
        return self._make_result(start, goal, np.asarray(u.value), half_spaces, relaxation)

    def _make_result(
        self, start: Array, goal: Array, u: Array, half_spaces: HalfSpaces, relaxation: Relaxation
    ) -> AvoidanceResult:
        trajectory = self.transfer.simulate(start, u)
        terminal_error, slack = 0.0, 0.0
        if relaxation != "none":
            terminal_error = float(np.abs(trajectory.x[-1] - goal).max())
        if relaxation == "separation":
            slack = float(half_spaces.violation(trajectory.x, trajectory.u).max(initial=0.0))
        return AvoidanceResult(trajectory, terminal_error, slack)

    @cached_property
    def _penalty(self) -> float:
        duration = len(self.transfer.model) * self.transfer.model.dt
        return RELAXATION_PENALTY / duration

    @cached_property
    def _terminal_error_weights(self) -> Array:
        # An error in velocity weighs as the distance that it covers in a step.
        d = self.transfer.model.axes
        return np.repeat([1.0, self.transfer.model.dt], d)

    def _solve_condensed(
        self, start: Array, goal: Array, half_spaces: HalfSpaces, relaxation: Relaxation
    ) -> AvoidanceResult:
        """Eliminate the states and add speed limits only where a solution violates them."""
        limited: list[int] = []
        while True:
            problem = self.assemble_conic(start, goal, half_spaces, relaxation, limited)
            u = self.extract_controls(solve(problem, solve_clarabel).x)
            result = self._make_result(start, goal, u, half_spaces, relaxation)
            violated = self.find_speed_violations(result.trajectory.x, limited)
            if not len(violated):
                return result
            limited = [*limited, *violated]

    def find_speed_violations(self, x: Float[Array, "instants n"], known: list[int]) -> list[int]:
        """Find the instants of violated speed limits, other than those known."""
        over = np.flatnonzero(self.transfer.is_too_fast(x)) + 1
        return [int(k) for k in over if int(k) not in known]

    def extract_controls(self, unknowns: Float[Array, " unknowns"]) -> Float[Array, "T m"]:
        """Extract the controls from a solution of the program of `assemble_conic`."""
        T, m = len(self.transfer.model), self.transfer.model.axes
        plus, minus = unknowns[: T * m], unknowns[T * m : 2 * T * m]
        U = self.transfer.max_control
        return np.asarray(np.clip(U * (plus - minus), -U, U)).reshape(T, m)

    def assemble_conic(
        self,
        start: Float[Array, " n"],
        goal: Float[Array, " n"],
        half_spaces: HalfSpaces,
        relaxation: Relaxation,
        limited: list[int],
    ) -> ConicProgram:
        """Assemble the program with the states eliminated and speed limits at some instants.

        Unknowns are u⁺ and u⁻ in units of U, then both signs of the terminal error in meters,
        then the slacks of the half-spaces.
        """
        transfer, (R, factor) = self.transfer, self.transfer.response_matrices
        T, n, m = transfer.model.B.shape
        U, N = transfer.max_control, T * m
        free = transfer.coast(start)
        coeffs, rhs = condense_half_spaces(transfer, half_spaces, free)
        breakable = U * np.abs(coeffs).sum(axis=1) > rhs  # most rows hold for any control
        coeffs, rhs = coeffs[breakable], rhs[breakable]
        rows = len(rhs)
        errors = 0 if relaxation == "none" else n
        slacks = rows if relaxation == "separation" else 0
        columns = 2 * N + 2 * errors + slacks
        slacks_at = 2 * N + 2 * errors

        fuel = np.tile(U * transfer.model.dt * np.repeat(transfer.weights, m), 2)
        penalty = np.repeat([self._penalty, 10 * self._penalty], [2 * errors, slacks])
        q = np.concatenate([fuel, penalty])

        whitening = np.linalg.inv(factor)
        terminal = np.zeros((n, columns))
        terminal[:, :N] = U * whitening @ R[T]
        terminal[:, N : 2 * N] = -terminal[:, :N]
        if errors:
            unit = whitening / self._terminal_error_weights
            terminal[:, 2 * N : 2 * N + n], terminal[:, 2 * N + n : slacks_at] = unit, -unit
        scale = 1 / U
        terminal, terminal_rhs = scale * terminal, scale * whitening @ (goal - free[T])

        separation = np.zeros((rows, columns))
        separation[:, :N], separation[:, N : 2 * N] = -U * coeffs, U * coeffs
        separation[np.arange(slacks), slacks_at + np.arange(slacks)] = -1

        bound_rhs = np.concatenate([np.ones(2 * N), np.zeros(columns)])
        cone_rows, cone_rhs = self._assemble_speed_cones(R, free, limited, columns)
        A = _stack_with_bounds(np.vstack([terminal, separation]), 2 * N, cone_rows)
        b = np.concatenate([terminal_rhs, rhs, bound_rhs, cone_rhs])
        return ConicProgram(q, A, b, n, rows + len(bound_rhs), (m + 1,) * len(limited))

    def _assemble_speed_cones(
        self, R: Array, free: Array, limited: list[int], columns: int
    ) -> tuple[Array, Array]:
        d, U = self.transfer.model.axes, self.transfer.max_control
        N = R.shape[2]
        cone_rows = np.zeros((len(limited), d + 1, columns))
        cone_rhs = np.zeros((len(limited), d + 1))
        for row, k in enumerate(limited):
            cone_rows[row, 1:, :N], cone_rows[row, 1:, N : 2 * N] = -U * R[k, d:], U * R[k, d:]
            cone_rhs[row, 0], cone_rhs[row, 1:] = self.transfer.max_speed, free[k, d:]
        return cone_rows.reshape(-1, columns), cone_rhs.ravel()


def condense_half_spaces(
    transfer: TransferProblem, half_spaces: HalfSpaces, free: Float[Array, "instants n"]
) -> tuple[Float[Array, "rows controls"], Float[Array, " rows"]]:
    """Eliminate the states: coeffs and rhs of −coeffs · u ≤ rhs, given the free motion."""
    R, m = transfer.response_matrices[0], transfer.model.axes
    coeffs = np.einsum("rn,rnj->rj", half_spaces.state_coeffs, R[half_spaces.step_index])
    for r, k in enumerate(half_spaces.step_index):
        coeffs[r, k * m : (k + 1) * m] += half_spaces.control_coeffs[r]
    rhs = (half_spaces.state_coeffs * free[half_spaces.step_index]).sum(1) - half_spaces.rhs
    return coeffs, rhs


def _stack_with_bounds(above: Array, count: int, below: Array) -> csc_array:
    """Stack rows, x ≤ 1 for the first unknowns, x ≥ 0 for all, and rows, as a sparse matrix."""
    first, columns = above.shape
    own, last = np.arange(columns), first + count + columns
    value = np.vstack([above, own < count, -np.ones(columns), below]).T
    row = np.vstack([
        np.broadcast_to(np.arange(first)[:, None], above.shape),
        first + own,
        first + count + own,
        np.broadcast_to(last + np.arange(len(below))[:, None], below.shape),
    ]).T  # fmt: skip
    there = value != 0
    starts = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
    return csc_array((value[there], row[there], starts), shape=(last + len(below), columns))


def empty_half_spaces(transfer: TransferProblem) -> HalfSpaces:
    """Return no half-spaces, for an agent without conflicts."""
    n, m = transfer.model.B.shape[1:]
    return HalfSpaces(np.zeros(0, int), np.zeros((0, n)), np.zeros((0, m)), np.zeros(0))
