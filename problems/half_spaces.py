"""Half-spaces for the control points of a trajectory: collision constraints, made convex."""

from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Ge
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.doors import checked
from dynamics.inputs import InputError
from problems.transfer import Expression, TransferProblem

States = Float[Array, "instants n"]
Condensed = tuple[Float[Array, "rows controls"], Float[Array, " rows"]]  # coeffs and rhs
Mask = Bool[Array, " rows"]
Rows = Bool[Array, " own_rows"] | Int[Array, " kept"]  # a mask, or numbers of rows


@checked
class HalfSpaces(NamedTuple):
    """Linear constraints state_coeffs · x[step] + control_coeffs · u[step] ≥ rhs, one a row."""

    step_index: Annotated[Int[Array, " rows"], Ge(0)]
    state_coeffs: Float[Array, "rows n"]
    control_coeffs: Float[Array, "rows m"]
    rhs: Float[Array, " rows"]

    @property
    def array_sizes(self) -> dict[str, Any]:
        """Sizes of the axes of states, controls and, for its own methods, rows."""
        n, m = self.state_coeffs.shape[1], self.control_coeffs.shape[1]
        return {"n": n, "m": m, "own_rows": len(self.rhs)}

    def violation(self, x: States, u: Float[Array, "T m"]) -> Float[Array, " rows"]:
        """Compute rhs minus the left-hand side of each row; positive where it is violated."""
        try:
            x, u = np.take(x, self.step_index, axis=0), np.take(u, self.step_index, axis=0)
        except IndexError as error:
            last = int(self.step_index.max())
            raise InputError("u", f"must have {last + 1} steps at least, got {len(u)}") from error
        on_x = np.einsum("rn,rn->r", self.state_coeffs, x)
        return np.asarray(self.rhs - on_x - np.einsum("rm,rm->r", self.control_coeffs, u))

    def to_cvxpy(self, x: States | Expression, u: Float[Array, "T m"] | Expression) -> Any:
        """Express the left-hand sides in CVXPY variables."""
        import cvxpy as cp

        for name, value in (("x", x), ("u", u)):
            if self.step_index.max(initial=-1) >= value.shape[0]:
                raise InputError(name, f"must have more than {self.step_index.max()} rows")
        on_x = cp.sum(cp.multiply(self.state_coeffs, x[self.step_index]), axis=1)
        return on_x + cp.sum(cp.multiply(self.control_coeffs, u[self.step_index]), axis=1)

    def condense(self, transfer: TransferProblem, free: States) -> Condensed:
        """Eliminate the states: coeffs and rhs of −coeffs · u ≤ rhs, given the free motion.

        As in `TransferProblem.response_matrices`, u is in units of each axis's share.
        """
        R, (T, _, m) = transfer.response_matrices[0], transfer.model.B.shape
        rows, step = np.arange(len(self.rhs)), self.step_index
        coeffs = np.einsum("rn,rnj->rj", self.state_coeffs, R[step])
        coeffs.reshape(-1, T, m)[rows, step] += self.control_coeffs * transfer.control_limit.shares
        return coeffs, (self.state_coeffs * free[step]).sum(1) - self.rhs

    def condense_breakable(self, transfer: TransferProblem, free: States) -> Condensed:
        """Condense the rows that some controls within the limit break; most hold for any."""
        coeffs, rhs = self.condense(transfer, free)
        breakable = transfer.control_limit.most * np.abs(coeffs).sum(axis=1) > rhs
        return coeffs[breakable], rhs[breakable]

    def select(self, rows: Rows) -> "HalfSpaces":
        """Select rows by a mask or by index."""
        try:
            return HalfSpaces(*(field[rows] for field in self))
        except IndexError as error:
            raise InputError("rows", f"{error}, of {len(self.rhs)} half-spaces") from error

    def join(self, others: "HalfSpaces") -> "HalfSpaces":
        """Return these rows and those of others."""
        return HalfSpaces(*(np.concatenate(both) for both in zip(self, others, strict=True)))

    def find_peaks(self, violation: Float[Array, " own_rows"], tolerance: float) -> Mask:
        """Find the rows violated most, by more than a tolerance [m], at the steps around theirs."""
        step, worst = self.step_index, self._worst_of_steps(violation, tolerance)
        is_peak = np.zeros(len(worst), dtype=bool)
        is_peak[1:-1] = worst[1:-1] >= np.maximum(worst[:-2], worst[2:])
        is_worst = (violation > tolerance) & (violation >= worst[step + 1])
        return np.asarray(is_worst & is_peak[step + 1])

    def worst_per_step(self, violation: Float[Array, " own_rows"], tolerance: float) -> Mask:
        """Select the rows that are violated most at each step, by more than a tolerance [m]."""
        worst = self._worst_of_steps(violation, tolerance)[self.step_index + 1]
        return np.asarray((violation > tolerance) & (violation >= worst))

    def _worst_of_steps(self, violation: Float[Array, " rows"], tolerance: float) -> Array:
        """Return the largest violation of each step, the tolerance at least, from step −1 on."""
        worst = np.full(self.step_index.max(initial=-1) + 3, tolerance)
        np.maximum.at(worst, self.step_index + 1, violation)
        return worst


@checked
def empty_half_spaces(transfer: TransferProblem) -> HalfSpaces:
    """Return no half-spaces, for an agent without conflicts."""
    n, m = transfer.model.B.shape[1:]
    return HalfSpaces(np.zeros(0, int), np.zeros((0, n)), np.zeros((0, m)), np.zeros(0))
