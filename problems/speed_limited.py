"""Transfers with an active speed limit, by cutting planes.

`cutting_planes` solves each; this module scales units and weights, and solves the few that fail
with Clarabel.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems.batches import solve_batches
from problems.certificates import UNCERTIFIED, TransferProgram
from problems.conic import Infeasible, Unsolved
from problems.minimum_fuel import MinimumFuelSolutions
from problems.orthonormal_rows import OrthonormalRows
from problems.sparse_transfer import SparseTransferSolver, require_speed_limit
from problems.transfer import Trajectory, TransferProblem, tie_break_weights

MAX_PIVOTS = 1_000  # of one ascent; Clarabel solves a program that needs more
MIN_TIE_BREAK_RISE = 1e-8  # breaks ties, at the cost of at most this part of the fuel


@dataclass(frozen=True, eq=False)
class SpeedLimitedSolver:
    """`TransferProblem` with q = 1 and r = ∞, for many starts and targets.

    Every solution arrives, keeps the limits (the speed limit to 1e-9) and costs at most 3e-8
    more than its dual bound, and every infeasibility has a certificate; all of this is recomputed
    from the solution. Clarabel solves what fails (`SparseTransferSolver`); its dual bound is the
    fuel itself.
    """

    transfer: TransferProblem

    def __post_init__(self) -> None:
        """Check the norms and limits."""
        require_speed_limit(self.transfer)

    def solve(self, start: Float[Array, " n"], target: Float[Array, " n"]) -> Trajectory:
        """Solve one transfer.

        Raises:
            Infeasible: The target is unreachable in this time.
            Unsolved: Neither a trajectory nor its infeasibility can be certified.
        """
        found = self.solve_many(start[None], target[None])
        if np.isinf(found.fuel[0]):
            raise Infeasible(self.transfer, "the dual grows without bound: unreachable")
        if np.isnan(found.fuel[0]):
            raise Unsolved(self.transfer, "neither trajectory nor infeasibility is certified")
        return self.transfer.simulate(start, found.u[0])

    def solve_many(
        self,
        start: Float[Array, "pairs n"],
        target: Float[Array, "pairs n"],
        batch_starts: Int[Array, " fences"] | None = None,
    ) -> MinimumFuelSolutions:
        """Solve many transfers; fuel is NaN where neither it nor infeasibility is certified.

        Args:
            start: Initial states.
            target: Terminal states.
            batch_starts: First pair of each batch, and at the end the number of pairs; all are
                one batch where it is None. Solutions do not depend on the pairs of other
                batches, not even in the last bit.
        """
        transfer, U = self.transfer, self.transfer.max_control
        T, _, m = transfer.model.B.shape
        pairs, free = len(start), transfer.coast(start)
        transformed, unreachable = self._orthonormal.transform(target - free[:, T], U)
        found = solve_batches(
            self._program,
            transformed / U,
            np.ascontiguousarray(free[:, 1:T, m:]) / transfer.max_speed,
            np.array([0, pairs]) if batch_starts is None else batch_starts,
            MAX_PIVOTS,
        )
        u = U * found.x.reshape(pairs, T, m)
        bound = transfer.model.dt * U * found.dual_bound / (1 + MIN_TIE_BREAK_RISE)
        u[unreachable], bound[unreachable] = np.nan, np.inf
        for q in np.setdiff1d(np.flatnonzero(found.status == UNCERTIFIED), unreachable):
            u[q], bound[q] = self._solve_with_clarabel(start[q], target[q])
        fuel = transfer.model.dt * np.abs(u).sum(axis=(1, 2))
        fuel[np.isinf(bound)] = np.inf
        return MinimumFuelSolutions(u, fuel, bound)

    def _solve_with_clarabel(
        self, start: Float[Array, " n"], target: Float[Array, " n"]
    ) -> tuple[Float[Array, "T m"] | float, float]:
        try:
            found = self._fallback.solve(start, target)
        except Infeasible:
            return np.nan, np.inf
        except Unsolved:
            return np.nan, np.nan
        return found.u, found.fuel

    @cached_property
    def _fallback(self) -> SparseTransferSolver:
        return SparseTransferSolver(self.transfer)

    @cached_property
    def _orthonormal(self) -> OrthonormalRows:
        return OrthonormalRows.from_matrix(self.transfer.response_matrices[0][-1])

    @cached_property
    def _program(self) -> TransferProgram:
        transfer = self.transfer
        T, _, m = transfer.model.B.shape
        weight = tie_break_weights(T, max(transfer.tie_break_rise, MIN_TIE_BREAK_RISE))
        scale = transfer.max_control / transfer.max_speed
        response = np.ascontiguousarray(transfer.response_matrices[0][1:T, m:]) * scale
        return TransferProgram(self._orthonormal.rows, np.repeat(weight, m), response)
