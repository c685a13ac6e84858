"""Transfers that the speed limit binds: any number of them, by cutting planes.

What is done for each stands in `speed_cuts`; here are the units, the weights, and what
happens to the few that do not end well.
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

MAX_PIVOTS = 1_000  # of one climb; a question that needs more is asked of Clarabel
MIN_TIE_BREAK_RISE = (
    1e-8  # of the weights at least: it breaks ties, and costs no more than this part of fuel
)


@dataclass(frozen=True, eq=False)
class SpeedLimitedSolver:
    """The statement of `Transfer` for q = 1 and r = ∞, solved over and over.

    Every answer arrives, keeps the limits (that of the speed to 1e-9) and costs no more
    than 3e-8 above its dual bound, and every "out of reach" has its proof; all of that is
    recomputed from the answer. What fails is asked of Clarabel (`SpeedCones`).
    """

    transfer: TransferProblem

    def __post_init__(self) -> None:
        """Refuse what needs another programme."""
        require_speed_limit(self.transfer)

    def solve(self, start: Float[Array, " n"], goal: Float[Array, " n"]) -> Trajectory:
        """Fly from start to goal.

        Raises:
            Infeasible: The goal is out of reach in this time.
            Unsolved: Neither could be proven.
        """
        burns = self.solve_many(start[None], goal[None])
        if np.isinf(burns.fuel[0]):
            raise Infeasible(self.transfer, "the dual grows without bound: out of reach")
        if np.isnan(burns.fuel[0]):
            raise Unsolved(self.transfer, "neither a flight nor that there is none can be proven")
        return self.transfer.simulate(start, burns.u[0])

    def solve_many(
        self,
        start: Float[Array, "pairs n"],
        goal: Float[Array, "pairs n"],
        batch_starts: Int[Array, " fences"] | None = None,
    ) -> MinimumFuelSolutions:
        """What many flights take; fuel is NaN where neither it nor the contrary can be proven.

        Args:
            start: Where each begins.
            goal: Where each ends.
            first: The pair with which each lot begins, and at the end how many there are.
                Answers do not depend on the pairs of other lots, not even in the last bit.
        """
        transfer, U = self.transfer, self.transfer.max_control
        T, _, m = transfer.model.B.shape
        pairs, free = len(start), transfer.coast(start)
        white, missed = self._orthonormal.transform(goal - free[:, T], U)
        found = solve_batches(
            self._program,
            white / U,
            np.ascontiguousarray(free[:, 1:T, m:]) / transfer.max_speed,
            np.array([0, pairs]) if batch_starts is None else batch_starts,
            MAX_PIVOTS,
        )
        u = U * found.x.reshape(pairs, T, m)
        bound = transfer.model.dt * U * found.dual_bound / (1 + MIN_TIE_BREAK_RISE)
        u[missed], bound[missed] = np.nan, np.inf
        for q in np.setdiff1d(np.flatnonzero(found.status == UNCERTIFIED), missed):
            u[q], bound[q] = self._solve_with_clarabel(start[q], goal[q])
        fuel = transfer.model.dt * np.abs(u).sum(axis=(1, 2))
        fuel[np.isinf(bound)] = np.inf
        return MinimumFuelSolutions(u, fuel, bound)

    def _solve_with_clarabel(
        self, start: Float[Array, " n"], goal: Float[Array, " n"]
    ) -> tuple[Float[Array, "T m"] | float, float]:
        try:
            flight = self._fallback.solve(start, goal)
        except Infeasible:
            return np.nan, np.inf
        except Unsolved:
            return np.nan, np.nan
        return flight.u, flight.fuel

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
        weight = (
            transfer.weights
            if transfer.tie_break_rise >= MIN_TIE_BREAK_RISE
            else tie_break_weights(T, MIN_TIE_BREAK_RISE)
        )
        per = transfer.max_control / transfer.max_speed
        push = np.ascontiguousarray(transfer.response_matrices[0][1:T, m:]) * per
        return TransferProgram(self._orthonormal.rows, np.repeat(weight, m), push)
