"""Avoidance problem: transfer among collision half-spaces [Morgan2016, Problems 5 and 7].

Half-spaces hold for the control points of the trajectory between samples, not only at the
samples. A trajectory lies in the convex hull of its control points, so it keeps the distance
in continuous time.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from math import floor, inf, log
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from annotated_types import Gt
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import csc_array, diags_array

from dynamics.doors import checked
from dynamics.inputs import InputError
from problems.conic import ConicProgram
from problems.constraint_generation import Goal, try_generating
from problems.half_spaces import HalfSpaces, Rows, empty_half_spaces
from problems.limit import Limit
from problems.solvers.adapter import ask
from problems.solvers.verified import solve_program
from problems.sparse_rows import SparseRows, stack_with_bounds
from problems.transfer import (
    Solver,
    State,
    Trajectory,
    TransferProblem,
    compute_energy,
    solve_cvxpy,
    solve_within_speed,
)

Relaxation = Literal["none", "terminal", "half-spaces", "separation"]

KEEPS_TERMINAL_STATE = "none", "half-spaces"
RELAXES_HALF_SPACES = "half-spaces", "separation"

RELAXATION_PENALTY = 1e3  # per meter of error, over the fuel that flies a meter
ROUNDING = 1e-6  # of the way to the goal
MIN_ENERGY_UNIT = 1e-3  # in which energies are scaled, over that of a step at full control


@checked
class AvoidanceResult(NamedTuple):
    """Trajectory among half-spaces and the violations that its relaxation admits."""

    trajectory: Trajectory
    terminal_error: float  # ‖x[T] − goal‖_∞ [m or m/s]; rounding where it may not be relaxed
    slack: float  # largest violation of a half-space [m]; rounding where it may not be relaxed


@checked
@dataclass(frozen=True, eq=False)
class AvoidanceProblem:
    """Transfer of least fuel or energy inside half-spaces.

        minimize    Δt Σ w[k] ‖u[k]‖_q,  or  Δt Σ ‖u[k]‖₂²
        subject to  (10), (12), (14), (18), (66)      as in `TransferProblem`
                    n · (c(x[k], u[k]) − c̄) ≥ R       (38), (64), for each control point

    A relaxation admits violations at a penalty far above fuel: "none", of the terminal state
    ("terminal"), of all half-spaces by as much, ten times as dear, or of both ("separation").

    Args:
        transfer: Steps, limits and norms.
        start: Position [m] and velocity [m/s].
        goal: Position [m] and velocity [m/s].
        half_spaces: Half-spaces of control points.
        solver: Function of a `ConicProgram`.
        tolerance: Distance by which a half-space may be violated [m].
    """

    transfer: TransferProblem
    start: State
    goal: State
    half_spaces: HalfSpaces
    solver: Solver = solve_program
    tolerance: float = 0.0

    def __post_init__(self) -> None:
        """Check that half-spaces are of steps that there are."""
        last, steps = self.half_spaces.step_index.max(initial=-1), len(self.transfer.model)
        if last >= steps:
            reason = f"must be less than {steps}, the steps of the transfer, got {last}"
            raise InputError("half_spaces.step_index", reason)

    @classmethod
    def alone(
        cls, transfer: TransferProblem, start: State, goal: State, solver: Solver = solve_program
    ) -> "AvoidanceProblem":
        """Make the problem of an agent without half-spaces."""
        return cls(transfer, start, goal, empty_half_spaces(transfer), solver)

    def select(self, rows: Rows) -> "AvoidanceProblem":
        """Keep some half-spaces, by a mask or by index."""
        return replace(self, half_spaces=self.half_spaces.select(rows))

    def solve(self, relaxation: Relaxation = "none") -> AvoidanceResult:
        """Solve the transfer from start to goal inside the half-spaces.

        Raises:
            Infeasible: No trajectory satisfies the constraints that remain.
            Unsolved: The solver stopped for any other reason.
            ValueError: The transfer has no steps.
        """
        found = self.generate(relaxation)
        return self.solve_conic(relaxation) if found is None else found

    def generate(self, relaxation: Relaxation = "none") -> AvoidanceResult | None:
        """Solve by constraint generation, fast with any number of half-spaces.

        None where that cannot be, or where it stops without an answer, see `try_generating`.

        Raises:
            Infeasible: No trajectory satisfies the constraints that remain.
            ValueError: The transfer has no steps.
        """
        self.transfer.require_steps()
        terminal = inf if relaxation in KEEPS_TERMINAL_STATE else self._penalty
        slack = self._slack_penalty if relaxation in RELAXES_HALF_SPACES else inf
        steps = len(self.transfer.model)
        goals = [Goal(steps, self.goal, terminal * self._terminal_error_weights)]
        rest = self.start, goals, self.half_spaces, self.tolerance, slack
        found = try_generating(self.transfer, self.solver, *rest)
        return None if found is None else self._make_result(found)

    def solve_conic(self, relaxation: Relaxation = "none") -> AvoidanceResult:
        """Solve as a conic program with all half-spaces; raises what `solve` does."""
        self.transfer.require_steps()
        found = solve_within_speed(
            lambda factor: self.slow_down(factor)._solve_conic(relaxation),
            lambda result: self.transfer.speed_excess(result.trajectory),
        )
        if relaxation == "none" and self.transfer.is_too_fast(found.trajectory.x).any():
            # Only at full speed does it arrive: less by rounding, and it arrives but for rounding.
            slower = self.solve_conic("terminal")
            extent = float(np.abs(self.goal - self.start).max())
            return slower if slower.terminal_error <= ROUNDING * extent else found
        return found

    def slow_down(self, factor: Annotated[float, Gt(0)]) -> "AvoidanceProblem":
        """Return the problem with another speed limit.

        Args:
            factor: Ratio of the limits.
        """
        return replace(self, transfer=self.transfer.slow_down(factor))

    def _solve_conic(self, relaxation: Relaxation) -> AvoidanceResult:
        if self.transfer.objective == "energy":
            ends = self.start, self.goal[None]
            (x,), (u,), (keeps_limits,) = self.transfer.solve_without_limits(*ends)
            if keeps_limits and self.half_spaces.violation(x, u).max(initial=0.0) <= 0:
                return AvoidanceResult(self.transfer.simulate(self.start, u), 0.0, 0.0)
        (found,) = solve_condensed([self], lambda own: self.assemble_conic(relaxation, own[0]))
        return self._make_result(found)

    def solve_cvxpy(self, relaxation: Relaxation = "none") -> AvoidanceResult:
        """Solve the same problem in CVXPY, as a second opinion."""
        import cvxpy as cp

        _, u, cost, constraints = self.state_cvxpy(relaxation)
        problem = cp.Problem(cp.Minimize(cost / cost_unit([self])), constraints)
        solve_cvxpy(self, problem, self.solver)
        u = self.transfer.control_limit.cut(u.value)
        return self._make_result(self.transfer.simulate(self.start, u))

    def state_cvxpy(self, relaxation: Relaxation = "none") -> tuple[Any, Any, Any, list[Any]]:
        """State the problem in CVXPY: variables x and u, cost and constraints."""
        import cvxpy as cp

        x, u, effort, limits = self.transfer.build_cvxpy(self.start)
        terminal_error, slack = cp.Variable(len(self.start)), cp.Variable(nonneg=True)
        limits.append(x[len(self.transfer.model)] + terminal_error == self.goal)
        if len(self.half_spaces.rhs):
            limits.append(self.half_spaces.to_cvxpy(x, u) + slack >= self.half_spaces.rhs)
        if relaxation in KEEPS_TERMINAL_STATE:
            limits.append(terminal_error == 0)
        if relaxation not in RELAXES_HALF_SPACES:
            limits.append(slack == 0)
        error_cost = cp.norm1(cp.multiply(self._terminal_error_weights, terminal_error))
        penalty = self._penalty * error_cost + self._slack_penalty * slack
        return x, u, effort + penalty, limits

    def _make_result(self, found: Trajectory) -> AvoidanceResult:
        terminal_error = float(np.abs(found.x[-1] - self.goal).max())
        slack = float(self.half_spaces.violation(found.x, found.u).max(initial=0.0))
        return AvoidanceResult(found, terminal_error, slack)

    @property
    def _penalty(self) -> float:
        transfer, duration = self.transfer, len(self.transfer.model) * self.transfer.model.dt
        # At full control another m/s of fuel takes 2 U of energy.
        marginal = 1.0 if transfer.objective == "fuel" else 2 * transfer.control_limit.most
        return marginal * RELAXATION_PENALTY / duration

    @property
    def _slack_penalty(self) -> float:
        return 10 * self._penalty

    @property
    def _terminal_error_weights(self) -> Float[Array, " n"]:
        # An error in velocity weighs as the distance that it covers in a step.
        return np.repeat([1.0, self.transfer.model.dt], self.transfer.model.axes)

    def extract_trajectory(self, unknowns: Float[Array, " unknowns"]) -> Trajectory:
        """Simulate the controls of a solution of the program of `assemble_conic`.

        Args:
            unknowns: Its unknowns, in units of the limits.

        Raises:
            InputError: There are too few.
        """
        T, _, m = self.transfer.model.B.shape
        limit, parts = self.transfer.control_limit, unknowns[: self.unknown_controls]
        if len(parts) < self.unknown_controls:
            raise InputError("unknowns", f"{self.unknown_controls} are needed, got {len(parts)}")
        U, parts = limit.most, parts.reshape(-1, T, m)
        size = parts[0] if len(parts) == 1 else parts[0] - parts[1]
        u = np.asarray(np.clip(U * size, -U, U)) * limit.shares
        return self.transfer.simulate(self.start, u if limit.norm == "inf" else limit.cut(u))

    @property
    def unknown_controls(self) -> int:
        """Number of the first unknowns: u⁺ and u⁻ for least fuel with q = 1, u for all else."""
        signs = 2 if self.transfer.has_signed_controls else 1
        return signs * len(self.transfer.model) * self.transfer.model.axes

    @property
    def own_unknowns(self) -> int:
        """Number of unknowns for the controls, and for their norms where the fuel has q ≠ 1."""
        has_norms = self.transfer.objective == "fuel" and not self.transfer.has_signed_controls
        return self.unknown_controls + has_norms * len(self.transfer.model)

    def assemble_conic(
        self, relaxation: Relaxation, limited: Int[Array, " instants"]
    ) -> ConicProgram:
        """Assemble the program with the states eliminated and speed limits at some instants.

        Unknowns are u⁺ and u⁻, or u, in units of each axis's limit, and for least fuel with q ≠ 1
        all ‖u[k]‖_q; then both signs of the terminal error in meters, and the slack of the
        half-spaces.
        """
        transfer, (R, factor) = self.transfer, self.transfer.response_matrices
        T, n, m = transfer.model.B.shape
        U, N, count = transfer.control_limit.most, T * m, self.unknown_controls
        signs, shares = [1, -1][: count // N], np.tile(transfer.control_limit.shares, T)
        free = transfer.coast(self.start)
        coeffs, rhs = self.half_spaces.condense_breakable(transfer, free)
        rows = len(rhs)
        errors = 0 if relaxation in KEEPS_TERMINAL_STATE else n
        slacks = int(relaxation in RELAXES_HALF_SPACES)
        norms = self.own_unknowns - count
        others = norms + 2 * errors + slacks

        fuel = U * transfer.model.dt * transfer.weights
        P, cost = None, np.tile(np.repeat(fuel, m) * shares, 2) if count > N else np.zeros(N)
        if transfer.objective == "energy":
            curvature = np.zeros(N + others)
            curvature[:N] = 2 * transfer.model.dt * U**2 * shares**2
            P = csc_array(diags_array(curvature))
        penalty = np.repeat([self._penalty, self._slack_penalty], [2 * errors, slacks])
        whitening, scale = np.linalg.inv(factor), 1 / U
        reach = U * whitening @ R[T]
        unit = (whitening / self._terminal_error_weights)[:, :errors]
        zeros = np.zeros((n, norms)), np.zeros((n, slacks))
        terminal = np.hstack([*(s * reach for s in signs), zeros[0], unit, -unit, zeros[1]])
        on_others = np.zeros((rows, others))
        on_others[:, others - slacks :] = -1.0
        separation = np.hstack([*(-s * U * coeffs for s in signs), on_others])
        linear, cones = self._limit_rows(free, limited)

        terminal_rhs = scale * whitening @ (self.goal - free[T])
        zero = SparseRows.from_dense(scale * terminal, terminal_rhs)
        linear = [SparseRows.from_dense(separation, rhs), *linear]
        columns, negative = terminal.shape[1], float(len(signs) == 1)  # −1 ≤ u, and 0 ≤ u⁺, u⁻
        A, b, sizes = stack_with_bounds(zero, linear, cones, count, columns, m + 1, negative)
        q = np.concatenate([cost, fuel[:norms], penalty])
        return ConicProgram(q, A, b, *sizes, P=P)

    def _limit_rows(
        self, free: Float[Array, "instants n"], limited: Int[Array, " limited"]
    ) -> tuple[list[SparseRows], list[SparseRows]]:
        """Return rows of limits and norms: inequalities, and cones.

        Limits of the norm ∞ on controls are the bounds of the unknowns.
        """
        transfer, R = self.transfer, self.transfer.response_matrices[0]
        (T, _, m), is_signed = transfer.model.B.shape, transfer.has_signed_controls
        limit, speed = transfer.control_limit, transfer.speed_limit
        rows, rhs = speed.constrain(limit.most * R[limited, m:], free[limited, m:])
        signed = np.hstack([-rows, rows]) if is_signed else -rows
        kinds: tuple[list[SparseRows], list[SparseRows]] = ([], [])
        kinds[speed.faces is None].append(SparseRows.from_dense(signed, rhs))
        share = limit.shares if np.ndim(limit.bound) else 1.0
        limits = [(Limit(share, limit.norm, m), False)] if limit.norm != "inf" else []
        if self.own_unknowns > self.unknown_controls:
            limits.append((Limit(1.0, transfer.fuel_norm, m), True))
        for bound, is_of_norms in limits:
            rows, rhs = bound.constrain(np.diag(limit.shares)[None], np.zeros((1, m)))
            still = np.zeros_like(rhs)
            part = SparseRows.from_steps(-rows, T, still if is_of_norms else rhs)
            if is_signed:
                part = part.join(part.negate(), T * m)
            if is_of_norms:  # at most another unknown
                sizes = SparseRows.from_steps(-rhs[:, None], T, still)
                part = part.join(sizes, self.unknown_controls)
            kinds[bound.faces is None].append(part)
        return kinds


def solve_condensed(
    problems: Sequence[AvoidanceProblem], assemble: Callable[[list[Array]], ConicProgram]
) -> list[Trajectory]:
    """Solve for one or several agents, with speed limits only where a solution violates them.

    The program is assembled from the instants of each agent with speed limits; its first unknowns
    are those of the first problem.
    """
    limited = [np.zeros(0, dtype=int) for _ in problems]
    sizes, unit = [own.own_unknowns for own in problems], cost_unit(problems)
    while True:
        program = assemble(limited)
        if program.P is not None:
            program = replace(program, q=program.q / unit, P=program.P / unit)
        unknowns = np.split(ask(problems[0].solver, program).x, np.cumsum(sizes))
        found = [own.extract_trajectory(x) for own, x in zip(problems, unknowns, strict=False)]
        violated = [
            np.setdiff1d(np.flatnonzero(own.transfer.is_too_fast(trajectory.x)) + 1, known)
            for own, trajectory, known in zip(problems, found, limited, strict=True)
        ]
        if not any(map(len, violated)):
            return found
        limited = [np.concatenate(both) for both in zip(limited, violated, strict=True)]


def cost_unit(problems: Sequence[AvoidanceProblem]) -> float:
    """Compute the unit of cost in which a program is posed: 1 m/s, or an energy [m²/s³].

    That is the energy without limits, below which none is: so the scaled cost is above 1, and
    its accuracy relative. It is bounded, for agents that would hardly move but for the others.
    """
    if problems[0].transfer.objective == "fuel":
        return 1.0
    total = 0.0
    for own in problems:
        transfer, N = own.transfer, len(own.transfer.model) * own.transfer.model.axes
        _, (u,), _ = transfer.solve_without_limits(own.start, own.goal[None])
        of_a_step = transfer.model.dt * transfer.control_limit.most**2
        least = float(compute_energy(u, transfer.model.dt))
        total += min(max(least, MIN_ENERGY_UNIT * of_a_step), N * of_a_step)
    return 4.0 ** floor(log(total, 4))  # the same for agents that move about as far
