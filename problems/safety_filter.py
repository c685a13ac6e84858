"""Predictive safety filter: a stopping trajectory as near as possible to a wanted state."""

from dataclasses import dataclass, replace
from math import inf, isfinite

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram
from problems.constraint_generation import Goal, try_generating
from problems.half_spaces import HalfSpaces
from problems.solvers.adapter import ask
from problems.solvers.verified import solve_program
from problems.sparse_rows import SparseRows, stack_with_bounds
from problems.transfer import Solver, Trajectory, TransferProblem, solve_within_speed

VIOLATION_TOLERANCE = 1e-9  # of the largest state: a half-space violated by more is added
FUEL_WEIGHT = 1e-3  # of the fuel, times the duration: far below that of the error


@dataclass(frozen=True, eq=False)
class SafetyFilterProblem:
    """Trajectory that stops among half-spaces, near a wanted state on its way [Wabersich2021].

        minimize    ‖p[k] − p*‖₁ + Δt ‖v[k] − v*‖₁ + μ Δt Σ ‖u‖₁
        subject to  x[j+1] = A[j] x[j] + B[j] u[j] + z[j]    (10)
                    ‖u[j] / U‖_r ≤ 1                         (12)
                    x[0] = start,  v[T] = 0
                    ‖v[j] / V‖_s ≤ 1,  j = 1 … T−1           (66)
                    n · (c(x[j], u[j]) − c̄) ≥ R              (38), (64)

    A stopping trajectory that satisfies all constraints remains feasible when time goes on, so a
    vehicle that flies one always has an answer.
    """

    transfer: TransferProblem
    start: Float[Array, " n"]
    wanted: Float[Array, " n"]  # (p*, v*)
    wanted_step: int  # k
    half_spaces: HalfSpaces
    solver: Solver = solve_program

    def solve(self) -> Trajectory:
        """Solve the problem.

        Raises:
            Infeasible: No trajectory stops within the limits and the half-spaces.
            Unsolved: The solver stopped for any other reason.
        """
        found = self._generate()
        if found is not None:
            return found
        # Few half-spaces are active: add the one that is violated most at each step, until none is.
        active = np.zeros(len(self.half_spaces.rhs), dtype=bool)
        while True:
            found = replace(self, half_spaces=self.half_spaces.select(active))._solve()
            violation = np.where(active, 0.0, self.half_spaces.violation(found.x, found.u))
            tolerance = VIOLATION_TOLERANCE * float(np.abs(found.x).max())
            violated = self.half_spaces.worst_per_step(violation, tolerance)
            if not violated.any():
                return found
            active |= violated

    def _generate(self) -> Trajectory | None:
        transfer, m = self.transfer, self.transfer.model.axes
        near = np.repeat([1.0, transfer.model.dt], m) / self._fuel_weight
        slow = np.repeat([0.0, inf], m)
        wanted = Goal(self.wanted_step, self.wanted, near)
        rest = Goal(len(transfer.model), np.zeros(2 * m), slow)
        tolerance = VIOLATION_TOLERANCE * float(np.abs(transfer.coast(self.start)).max())
        goals = self.start, [wanted, rest]
        return try_generating(transfer, self.solver, *goals, self.half_spaces, tolerance)

    @property
    def _fuel_weight(self) -> float:
        return FUEL_WEIGHT * self.wanted_step * self.transfer.model.dt

    def _solve(self) -> Trajectory:
        return solve_within_speed(
            lambda factor: replace(self, transfer=self.transfer.slow_down(factor))._solve_once(),
            self.transfer.speed_excess,
        )

    def _solve_once(self) -> Trajectory:
        limit, unknowns = self.transfer.control_limit, ask(self.solver, self.assemble_conic()).x
        plus, minus = unknowns[: self._controls], unknowns[self._controls : 2 * self._controls]
        u = limit.most * (plus - minus).reshape(-1, limit.axes) * limit.shares
        return self.transfer.simulate(self.start, limit.cut(u))

    @property
    def _controls(self) -> int:
        return len(self.transfer.model) * self.transfer.model.axes

    def assemble_conic(self) -> ConicProgram:
        """Assemble the program with the states eliminated.

        Unknowns are u⁺ and u⁻ in units of each axis's limit, then both signs of the error.
        """
        transfer, k, dt = self.transfer, self.wanted_step, self.transfer.model.dt
        (T, n, m), N, limit = transfer.model.B.shape, self._controls, transfer.control_limit
        free, R = transfer.coast(self.start), limit.most * transfer.response_matrices[0]
        errors = np.hstack([np.eye(n), -np.eye(n)])
        still = np.hstack([R[T, m:], -R[T, m:], np.zeros((m, 2 * n))])
        equal_rhs = np.concatenate([-free[T, m:], self.wanted - free[k]])
        equal = np.vstack([still, np.hstack([R[k], -R[k], errors])])
        zero = SparseRows.from_dense(equal, equal_rhs)
        coeffs, rhs = self.half_spaces.condense_breakable(transfer, free)
        kinds: tuple[list[SparseRows], list[SparseRows]] = ([], [])
        kinds[0].append(SparseRows.from_dense(-limit.most * coeffs, rhs))
        if isfinite(limit.most) and limit.norm != "inf":  # whose limits are the unknowns' bounds
            controls = np.diag(limit.most * limit.shares)[None]
            rows, rhs = limit.constrain(controls, np.zeros((1, m)))
            kinds[limit.faces is None].append(SparseRows.from_steps(-rows, T, rhs))
        if isfinite(transfer.speed_limit.most):
            rows, rhs = transfer.speed_limit.constrain(R[1:T, m:], free[1:T, m:])
            kinds[transfer.speed_limit.faces is None].append(SparseRows.from_dense(-rows, rhs))
        linear, cones = ([part.join(part.negate(), N) for part in kind] for kind in kinds)
        A, b, sizes = stack_with_bounds(zero, linear, cones, 2 * N, 2 * N + 2 * n, m + 1)
        weight, fuel = np.repeat([1.0, dt], m), self._fuel_weight * dt * limit.most
        q = np.concatenate([np.tile(fuel * limit.shares, 2 * T), weight, weight])
        return ConicProgram(q, A, b, *sizes)
