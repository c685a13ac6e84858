"""Joint avoidance problem of two agents that share the avoidance.

With a priority, the half-spaces of `avoidance` constrain one of the two agents. Here both are
free to move, and a half-space constrains their relative trajectory.
"""

from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.sparse import block_diag, csc_array, csr_array, vstack

from dynamics.doors import checked
from problems.avoidance import AvoidanceProblem, cost_unit, solve_condensed
from problems.conic import ConicProgram
from problems.convexify import AvoidanceHorizon, convexify
from problems.half_spaces import HalfSpaces, Rows
from problems.transfer import Trajectory, solve_cvxpy, solve_within_speed


@checked
class RelativeHalfSpaces(NamedTuple):
    """Constraints on both agents: rows add up, lhs₁ + lhs₂ ≥ rhs₁ + rhs₂."""

    first: HalfSpaces
    second: HalfSpaces

    @classmethod
    def from_normals(
        cls,
        horizon: AvoidanceHorizon,
        T: Annotated[int, Ge(1)],
        normal: Float[Array, "pieces d"],
        separation: float | None = None,
    ) -> "RelativeHalfSpaces":
        """Constrain n·(c₁ − c₂) ≥ R for every control point that can move in T steps."""
        no_path = np.zeros((1, len(normal), 4, normal.shape[1]))
        required = horizon.required_separation if separation is None else separation
        first = convexify(horizon, T, no_path, normal[None], required)
        second = convexify(horizon, T, no_path, -normal[None], required)
        return cls(first, second._replace(rhs=second.rhs - required))

    def violation(self, first: Trajectory, second: Trajectory) -> Float[Array, " rows"]:
        """Compute rhs minus the left-hand side of each row; positive where it is violated."""
        rows = self.first.violation(first.x, first.u) + self.second.violation(second.x, second.u)
        return np.asarray(rows)

    def select(self, rows: Rows) -> "RelativeHalfSpaces":
        """Select rows by a mask or by index."""
        return RelativeHalfSpaces(self.first.select(rows), self.second.select(rows))


@checked
@dataclass(frozen=True, eq=False)
class PairProblem:
    """Two transfers that keep the distance from each other.

        minimize    Δt Σ w₁[k] ‖u₁[k]‖_q + Δt Σ w₂[k] ‖u₂[k]‖_q,  or  Δt Σ ‖u₁[k]‖² + ‖u₂[k]‖²
        subject to  (10), (12), (14), (18), (66)      of each, as in `TransferProblem`
                    n · (c(x[k], u[k]) − c̄) ≥ R       of each, as in `AvoidanceProblem`
                    n · (c₁(x₁, u₁) − c₂(x₂, u₂)) ≥ R

    Both agents may move, so that the sum of their fuel or energy is least.

    Args:
        first: Transfer of one agent among its own half-spaces.
        second: That of the other.
        relative_half_spaces: Half-spaces of the distance of the two.
    """

    first: AvoidanceProblem
    second: AvoidanceProblem
    relative_half_spaces: RelativeHalfSpaces

    def violation(self, both: tuple[Trajectory, Trajectory]) -> Float[Array, " rows"]:
        """Compute the violation of all half-spaces [m]: those of each agent, then of both."""
        each = zip(self._members, both, strict=True)
        own = [member.half_spaces.violation(flight.x, flight.u) for member, flight in each]
        return np.concatenate([*own, self.relative_half_spaces.violation(*both)])

    def select(self, rows: Bool[Array, " rows"]) -> "PairProblem":
        """Keep some half-spaces, by a mask in the order of `violation`."""
        sizes = [len(member.half_spaces.rhs) for member in self._members]
        first, second, relative = np.split(rows, np.cumsum(sizes))
        each = self.first.select(first), self.second.select(second)
        return PairProblem(*each, self.relative_half_spaces.select(relative))

    def solve(self) -> tuple[Trajectory, Trajectory]:
        """Find the trajectories of the least total fuel or energy, weighted as in their transfers.

        Raises:
            Infeasible: No two trajectories satisfy all constraints.
            Unsolved: The solver stopped for any other reason.
            ValueError: A transfer has no steps.
        """
        for member in self._members:
            member.transfer.require_steps()
        return solve_within_speed(
            lambda factor: replace(
                self, first=self.first.slow_down(factor), second=self.second.slow_down(factor)
            )._solve(),
            lambda both: max(
                member.transfer.speed_excess(trajectory)
                for member, trajectory in zip(self._members, both, strict=True)
            ),
        )

    def _solve(self) -> tuple[Trajectory, Trajectory]:
        first, second = solve_condensed(self._members, self._assemble_joint)
        return first, second

    @property
    def _members(self) -> tuple[AvoidanceProblem, AvoidanceProblem]:
        return self.first, self.second

    def solve_cvxpy(self) -> tuple[Trajectory, Trajectory]:
        """Solve the same problem in CVXPY, as a second opinion."""
        import cvxpy as cp

        x, u, cost, constraints = self.first.state_cvxpy()
        y, v, other_cost, others = self.second.state_cvxpy()
        rows = self.relative_half_spaces
        constraints += others
        if len(rows.first.rhs):
            total = rows.first.to_cvxpy(x, u) + rows.second.to_cvxpy(y, v)
            constraints.append(total >= rows.first.rhs + rows.second.rhs)
        both = (cost + other_cost) / cost_unit(self._members)
        problem = cp.Problem(cp.Minimize(both), constraints)
        solve_cvxpy(self, problem, self.first.solver)
        each = zip(self._members, (u, v), strict=True)
        cut = [(own, own.transfer.control_limit.cut(controls.value)) for own, controls in each]
        first, second = (own.transfer.simulate(own.start, flown) for own, flown in cut)
        return first, second

    def _assemble_joint(self, limited: list[Array]) -> ConicProgram:
        """Assemble both programs side by side with the shared rows."""
        each = zip(self._members, limited, strict=True)
        parts = [member.assemble_conic("none", instants) for member, instants in each]
        blocks, rhs = [], np.zeros(len(self.relative_half_spaces.first.rhs))
        for member, rows in zip(self._members, self.relative_half_spaces, strict=True):
            transfer = member.transfer
            coeffs, own_rhs = rows.condense(transfer, transfer.coast(member.start))
            signs = (-1, 1)[: member.unknown_controls // coeffs.shape[1]]
            U = transfer.control_limit.most
            norms = np.zeros((len(coeffs), member.own_unknowns - member.unknown_controls))
            blocks.append(np.hstack([*(s * U * coeffs for s in signs), norms]))
            rhs += own_rhs
        shared = np.hstack(blocks)
        breakable = np.abs(shared).sum(axis=1) / len(signs) > rhs  # most rows hold for any control
        first, second = parts
        added = int(breakable.sum())
        # Equations, then inequalities, the shared ones last, then cones.
        counts = [(p.zero, p.nonnegative, len(p.b) - p.linear) for p in parts]
        kinds = np.concatenate([*(np.repeat([0, 1, 2], c) for c in counts), np.ones(added)])
        order = np.argsort(kinds, kind="stable")
        A = vstack([block_diag([first.A, second.A]), csr_array(shared[breakable])]).tocsr()
        b = np.concatenate([first.b, second.b, rhs[breakable]])[order]
        nonnegative = first.nonnegative + second.nonnegative + added
        sizes = first.zero + second.zero, nonnegative, first.soc_sizes + second.soc_sizes
        P = None if first.P is None else csc_array(block_diag([first.P, second.P]))
        q = np.concatenate([first.q, second.q])
        return ConicProgram(q, csc_array(A[order]), b, *sizes, P=P)
