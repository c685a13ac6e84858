"""Transfer among collision half-spaces [Morgan2016, Problems 5 and 7].

Half-spaces are kept by the control points of the path between the samples, and not at
the samples alone: a path lies in the hull of its control points, so the continuous
path keeps the distance.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import csc_array

from problems.conic import ConicProgram, solve
from problems.solvers import solve_clarabel
from problems.transfer import Trajectory, TransferProblem, solve_cvxpy

Relaxation = Literal["none", "terminal", "separation"]

RELAXATION_PENALTY = 1e3  # of a metre missed, over the fuel that flies a metre in the time given


class HalfSpaces(NamedTuple):
    """on_state · x[step] + on_control · u[step] ≥ least, one row each."""

    step_index: Int[Array, " rows"]
    state_coeffs: Float[Array, "rows n"]
    control_coeffs: Float[Array, "rows m"]
    rhs: Float[Array, " rows"]

    def violation(
        self, x: Float[Array, "instants n"], u: Float[Array, "T m"]
    ) -> Float[Array, " rows"]:
        """By how much each row is broken; negative where it holds with room."""
        kept = (self.state_coeffs * x[self.step_index]).sum(1) + (
            self.control_coeffs * u[self.step_index]
        ).sum(1)
        return np.asarray(self.rhs - kept)

    def to_cvxpy(self, x: Any, u: Any) -> Any:
        """What a flight keeps of each row, of variables in CVXPY."""
        import cvxpy as cp

        on_x = cp.sum(cp.multiply(self.state_coeffs, x[self.step_index]), axis=1)
        return on_x + cp.sum(cp.multiply(self.control_coeffs, u[self.step_index]), axis=1)

    def select(self, rows: Array) -> "HalfSpaces":
        """Some of the rows, by a mask or their numbers."""
        return HalfSpaces(*(field[rows] for field in self))


class AvoidanceResult(NamedTuple):
    """A flight among half-spaces, and what had to give."""

    trajectory: Trajectory
    terminal_error: float  # distance from the goal at the end, in the largest norm; 0 unless asked
    slack: float  # largest break of a half-space [m]; 0 unless asked


@dataclass(frozen=True, eq=False)
class AvoidanceProblem:
    """A transfer that stays inside half-spaces.

        minimise    Δt Σ w[k] ‖u[k]‖_q
        subject to  (10), (12), (14), (18), (66)      as in Transfer
                    n · (c(x[k], u[k]) − c̄) ≥ R       (38), (64), one a control point

    `gives` says what may be broken, at a price far above fuel, where not everything can
    be kept: nothing, the arrival, or the arrival and then the separation.
    """

    transfer: TransferProblem

    def solve(
        self,
        start: Float[Array, " n"],
        goal: Float[Array, " n"],
        spaces: HalfSpaces,
        gives: Relaxation = "none",
    ) -> AvoidanceResult:
        """Fly from start to goal inside the half-spaces.

        Raises:
            Infeasible: No flight does it, without breaking more than `gives` allows.
        """
        self.transfer.require_steps()
        if (self.transfer.fuel_norm, self.transfer.control_norm) == (1, "inf"):
            return self._solve_condensed(start, goal, spaces, gives)
        return self.solve_cvxpy(start, goal, spaces, gives)

    def solve_cvxpy(
        self, start: Array, goal: Array, spaces: HalfSpaces, gives: Relaxation = "none"
    ) -> AvoidanceResult:
        """The same, by the statement in CVXPY: for any norms, and as a second opinion."""
        import cvxpy as cp

        T, n = len(self.transfer.model), len(start)
        x, u, effort, limits = self.transfer.build_cvxpy(start)
        late, slack = cp.Variable(n), cp.Variable(len(spaces.rhs), nonneg=True)
        arrive = x[T] + late == goal
        kept = spaces.to_cvxpy(x, u)
        apart = [kept + slack >= spaces.rhs] if len(spaces.rhs) else []
        price = self._penalty
        missed = cp.norm1(cp.multiply(self._terminal_error_weights, late)) + 10 * cp.sum(slack)
        cost = effort + price * missed
        fixed = []
        if gives == "none":
            fixed.append(late == 0)
        if gives != "separation":
            fixed.append(slack == 0)
        problem = cp.Problem(cp.Minimize(cost), [*limits, arrive, *apart, *fixed])
        solve_cvxpy(self, problem)
        return self._make_result(start, goal, np.asarray(u.value), spaces, gives)

    def _make_result(
        self, start: Array, goal: Array, u: Array, spaces: HalfSpaces, gives: Relaxation
    ) -> AvoidanceResult:
        flight = self.transfer.simulate(start, u)
        late = 0.0 if gives == "none" else float(np.abs(flight.x[-1] - goal).max())
        slack = 0.0
        if gives == "separation":
            slack = float(spaces.violation(flight.x, flight.u).max(initial=0.0))
        return AvoidanceResult(flight, late, slack)

    @cached_property
    def _penalty(self) -> float:
        duration = len(self.transfer.model) * self.transfer.model.dt
        return RELAXATION_PENALTY / duration

    @cached_property
    def _terminal_error_weights(self) -> Array:
        # A speed missed weighs as the distance it covers in a step.
        d = self.transfer.model.axes
        return np.repeat([1.0, self.transfer.model.dt], d)

    def _solve_condensed(
        self, start: Array, goal: Array, spaces: HalfSpaces, gives: Relaxation
    ) -> AvoidanceResult:
        """Fast path: the states eliminated, speed limits only where they would be broken."""
        fast: list[int] = []
        while True:
            problem = self.assemble_conic(start, goal, spaces, gives, fast)
            u = self.extract_controls(solve(problem, solve_clarabel).x)
            passage = self._make_result(start, goal, u, spaces, gives)
            broken = self.find_speed_violations(passage.trajectory.x, fast)
            if not len(broken):
                return passage
            fast = [*fast, *broken]

    def find_speed_violations(self, x: Float[Array, "instants n"], known: list[int]) -> list[int]:
        """Instants at which a flight breaks the speed limit, beyond those known."""
        d = self.transfer.model.axes
        speed = np.linalg.norm(x[1:-1, d:], axis=1)
        over = np.flatnonzero(speed > self.transfer.max_speed * (1 + 1e-9)) + 1
        return [int(k) for k in over if int(k) not in known]

    def extract_controls(self, found: Float[Array, " unknowns"]) -> Float[Array, "T m"]:
        """The controls in an answer to what `assemble` gives."""
        T, m = len(self.transfer.model), self.transfer.model.axes
        plus, minus = found[: T * m], found[T * m : 2 * T * m]
        U = self.transfer.max_control
        return np.asarray(np.clip(U * (plus - minus), -U, U)).reshape(T, m)

    def assemble_conic(
        self,
        start: Float[Array, " n"],
        goal: Float[Array, " n"],
        spaces: HalfSpaces,
        gives: Relaxation,
        fast: list[int],
    ) -> ConicProgram:
        """The programme with the states eliminated, and speed limits at some instants.

        Unknowns are u⁺ and u⁻ in units of U, then lateness ± in metres, then slack.
        """
        transfer, (R, lower) = self.transfer, self.transfer.response_matrices
        T, n, m = transfer.model.B.shape
        U, N = transfer.max_control, T * m
        free = transfer.coast(start)
        on_u, room = condense_half_spaces(transfer, spaces, free)
        near = U * np.abs(on_u).sum(axis=1) > room  # the many that no control can break are out
        on_u, room = on_u[near], room[near]
        rows = len(room)
        lates = 0 if gives == "none" else n
        slacks = rows if gives == "separation" else 0
        columns = 2 * N + 2 * lates + slacks
        slack_at = 2 * N + 2 * lates

        fuel = U * transfer.model.dt * np.repeat(transfer.weights, m)
        price = self._penalty
        q = np.concatenate([fuel, fuel, np.full(2 * lates, price), np.full(slacks, 10 * price)])

        whiten = np.linalg.inv(lower)
        arrive = np.zeros((n, columns))
        arrive[:, :N] = U * whiten @ R[T]
        arrive[:, N : 2 * N] = -arrive[:, :N]
        if lates:
            unit = whiten / self._terminal_error_weights
            arrive[:, 2 * N : 2 * N + n], arrive[:, 2 * N + n : slack_at] = unit, -unit
        scale = 1 / U
        arrive, reach = scale * arrive, scale * whiten @ (goal - free[T])

        apart = np.zeros((rows, columns))
        apart[:, :N], apart[:, N : 2 * N] = -U * on_u, U * on_u
        apart[np.arange(slacks), slack_at + np.arange(slacks)] = -1

        sides = np.concatenate([np.ones(2 * N), np.zeros(columns)])
        cones, tops = self._assemble_speed_cones(R, free, fast, columns)
        A = _stack_with_bounds(np.vstack([arrive, apart]), 2 * N, cones)
        b = np.concatenate([reach, room, sides, tops])
        return ConicProgram(q, A, b, n, rows + len(sides), (transfer.model.axes + 1,) * len(fast))

    def _assemble_speed_cones(
        self, R: Array, free: Array, fast: list[int], columns: int
    ) -> tuple[Array, Array]:
        d, U = self.transfer.model.axes, self.transfer.max_control
        N = R.shape[2]
        cones = np.zeros((len(fast), d + 1, columns))
        tops = np.zeros((len(fast), d + 1))
        for row, k in enumerate(fast):
            cones[row, 1:, :N], cones[row, 1:, N : 2 * N] = -U * R[k, d:], U * R[k, d:]
            tops[row, 0], tops[row, 1:] = self.transfer.max_speed, free[k, d:]
        return cones.reshape(-1, columns), tops.ravel()


def condense_half_spaces(
    transfer: TransferProblem, spaces: HalfSpaces, free: Float[Array, "instants n"]
) -> tuple[Float[Array, "rows controls"], Float[Array, " rows"]]:
    """on_u and room of −on_u · u ≤ room, for flights that coast as given."""
    R, m = transfer.response_matrices[0], transfer.model.axes
    on_u = np.einsum("rn,rnj->rj", spaces.state_coeffs, R[spaces.step_index])
    for r, k in enumerate(spaces.step_index):
        on_u[r, k * m : (k + 1) * m] += spaces.control_coeffs[r]
    room = (spaces.state_coeffs * free[spaces.step_index]).sum(1) - spaces.rhs
    return on_u, room


def _stack_with_bounds(above: Array, count: int, below: Array) -> csc_array:
    """Rows, then x ≤ 1 for as many unknowns, then x ≥ 0 for all, then rows; as it is sparse."""
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
    """Half-spaces for an agent that meets nobody."""
    n, m = transfer.model.B.shape[1:]
    return HalfSpaces(np.zeros(0, int), np.zeros((0, n)), np.zeros((0, m)), np.zeros(0))
