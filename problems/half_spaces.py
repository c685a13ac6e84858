"""Half-spaces for the control points of a trajectory: collision constraints, made convex."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.model import ControlSamples, StateSamples
from problems.transfer import TransferProblem


class HalfSpaces(NamedTuple):
    """Linear constraints state_coeffs · x[step] + control_coeffs · u[step] ≥ rhs, one a row."""

    step_index: Int[Array, " rows"]
    state_coeffs: Float[Array, "rows n"]
    control_coeffs: Float[Array, "rows m"]
    rhs: Float[Array, " rows"]

    def violation(self, x: StateSamples, u: ControlSamples) -> Float[Array, " rows"]:
        """Compute rhs minus the left-hand side of each row; positive where it is violated."""
        on_x = np.einsum("ri,ri->r", self.state_coeffs, x[self.step_index])
        on_u = np.einsum("ri,ri->r", self.control_coeffs, u[self.step_index])
        return np.asarray(self.rhs - (on_x + on_u))

    def to_cvxpy(self, x: Any, u: Any) -> Any:
        """Express the left-hand sides in CVXPY variables."""
        import cvxpy as cp

        on_x = cp.sum(cp.multiply(self.state_coeffs, x[self.step_index]), axis=1)
        return on_x + cp.sum(cp.multiply(self.control_coeffs, u[self.step_index]), axis=1)

    def condense(
        self, transfer: TransferProblem, free: Float[Array, "instants n"]
    ) -> tuple[Float[Array, "rows controls"], Float[Array, " rows"]]:
        """Eliminate the states: coeffs and rhs of −coeffs · u ≤ rhs, given the free motion.

        As in `TransferProblem.response_matrices`, u is in units of each axis's share.
        """
        R, (T, _, m) = transfer.response_matrices[0], transfer.model.B.shape
        rows, step = np.arange(len(self.rhs)), self.step_index
        coeffs = np.einsum("rn,rnj->rj", self.state_coeffs, R[step])
        coeffs.reshape(-1, T, m)[rows, step] += self.control_coeffs * transfer.control_limit.shares
        return coeffs, (self.state_coeffs * free[step]).sum(1) - self.rhs

    def condense_breakable(
        self, transfer: TransferProblem, free: Float[Array, "instants n"]
    ) -> tuple[Float[Array, "rows controls"], Float[Array, " rows"]]:
        """Condense the rows that some controls within the limit break; most hold for any."""
        coeffs, rhs = self.condense(transfer, free)
        breakable = transfer.control_limit.most * np.abs(coeffs).sum(axis=1) > rhs
        return coeffs[breakable], rhs[breakable]

    def select(self, rows: Array) -> "HalfSpaces":
        """Select rows by a mask or by index."""
        return HalfSpaces(*(field[rows] for field in self))

    def find_peaks(
        self, violation: Float[Array, " rows"], tolerance: float
    ) -> Bool[Array, " rows"]:
        """Find the rows violated most, by more than a tolerance [m], at the steps around theirs."""
        worst = np.pad(self._worst_at_steps(violation, tolerance), 1, constant_values=tolerance)
        is_peak = (worst[1:-1] >= worst[:-2]) & (worst[1:-1] >= worst[2:])
        return np.asarray(self.worst_per_step(violation, tolerance) & is_peak[self.step_index])

    def worst_per_step(
        self, violation: Float[Array, " rows"], tolerance: float
    ) -> Bool[Array, " rows"]:
        """Select the rows that are violated most at each step, by more than a tolerance [m]."""
        worst = self._worst_at_steps(violation, tolerance)
        return np.asarray((violation >= worst[self.step_index]) & (violation > tolerance))

    def _worst_at_steps(
        self, violation: Float[Array, " rows"], tolerance: float
    ) -> Float[Array, " steps"]:
        worst = np.full(int(self.step_index.max(initial=-1)) + 1, tolerance)
        np.maximum.at(worst, self.step_index, violation)
        return worst


def empty_half_spaces(transfer: TransferProblem) -> HalfSpaces:
    """Return no half-spaces, for an agent without conflicts."""
    n, m = transfer.model.B.shape[1:]
    return HalfSpaces(np.zeros(0, int), np.zeros((0, n)), np.zeros((0, m)), np.zeros(0))
