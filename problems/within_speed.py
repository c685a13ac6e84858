"""Transfers that the speed limit binds: any number of them, by cutting planes.

What is done for each stands in `speed_cuts`; here are the units, the weights, and what
happens to the few that do not end well.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems.conic import Infeasible, Unsolved
from problems.least_fuel import Burns
from problems.lots import answer
from problems.proof import UNPROVEN, Shared
from problems.speed_cones import SpeedCones, refuse_others
from problems.transfer import Flight, Transfer, ends_first
from problems.whitening import Whitened

PIVOTS = 1_000  # of one climb; a question that needs more is asked of Clarabel
SLOPE = 1e-8  # of the weights at least: it breaks ties, and costs no more than this part of fuel


@dataclass(frozen=True, eq=False)
class WithinSpeed:
    """The statement of `Transfer` for q = 1 and r = ∞, solved over and over.

    Every answer arrives, keeps the limits (that of the speed to 1e-9) and costs no more
    than 3e-8 above its dual bound, and every "out of reach" has its proof; all of that is
    recomputed from the answer. What fails is asked of Clarabel (`SpeedCones`).
    """

    transfer: Transfer

    def __post_init__(self) -> None:
        """Refuse what needs another programme."""
        refuse_others(self.transfer)

    def solve(self, start: Float[Array, " n"], goal: Float[Array, " n"]) -> Flight:
        """Fly from start to goal.

        Raises:
            Infeasible: The goal is out of reach in this time.
            Unsolved: Neither could be proven.
        """
        burns = self.burns(start[None], goal[None])
        if np.isinf(burns.fuel[0]):
            raise Infeasible(self.transfer, "the dual grows without bound: out of reach")
        if np.isnan(burns.fuel[0]):
            raise Unsolved(self.transfer, "neither a flight nor that there is none can be proven")
        return self.transfer.flight(start, burns.u[0])

    def burns(
        self,
        start: Float[Array, "pairs n"],
        goal: Float[Array, "pairs n"],
        first: Int[Array, " fences"] | None = None,
    ) -> Burns:
        """What many flights take; fuel is NaN where neither it nor the contrary can be proven.

        Args:
            start: Where each begins.
            goal: Where each ends.
            first: The pair with which each lot begins, and at the end how many there are.
                Answers do not depend on the pairs of other lots, not even in the last bit.
        """
        transfer, U = self.transfer, self.transfer.max_control
        T, _, m = transfer.steps.B.shape
        pairs, free = len(start), transfer.coast(start)
        white, missed = self._white.ask(goal - free[:, T], U)
        found = answer(
            self._shared,
            white / U,
            np.ascontiguousarray(free[:, 1:T, m:]) / transfer.max_speed,
            np.array([0, pairs]) if first is None else first,
            PIVOTS,
        )
        u = U * found.x.reshape(pairs, T, m)
        bound = transfer.steps.dt * U * found.bound / (1 + SLOPE)
        u[missed], bound[missed] = np.nan, np.inf
        for q in np.setdiff1d(np.flatnonzero(found.status == UNPROVEN), missed):
            u[q], bound[q] = self._ask_clarabel(start[q], goal[q])
        fuel = transfer.steps.dt * np.abs(u).sum(axis=(1, 2))
        fuel[np.isinf(bound)] = np.inf
        return Burns(u, fuel, bound)

    def _ask_clarabel(
        self, start: Float[Array, " n"], goal: Float[Array, " n"]
    ) -> tuple[Float[Array, "T m"] | float, float]:
        try:
            flight = self._cones.solve(start, goal)
        except Infeasible:
            return np.nan, np.inf
        except Unsolved:
            return np.nan, np.nan
        return flight.u, flight.fuel

    @cached_property
    def _cones(self) -> SpeedCones:
        return SpeedCones(self.transfer)

    @cached_property
    def _white(self) -> Whitened:
        return Whitened.of(self.transfer.response[0][-1])

    @cached_property
    def _shared(self) -> Shared:
        transfer = self.transfer
        T, _, m = transfer.steps.B.shape
        weight = transfer.weight if transfer.slope >= SLOPE else ends_first(T, SLOPE)
        per = transfer.max_control / transfer.max_speed
        push = np.ascontiguousarray(transfer.response[0][1:T, m:]) * per
        return Shared(self._white.rows, np.repeat(weight, m), push)
