"""Linear programs of least fuel to which constraints are added, by the dual simplex method.

    minimize  Σ_j w_j |u_j| + P σ + Σ_i p_i |e_i|
    subject to  e = E u + g,   C u + h + σ ≥ 0 or C u + h ≥ 0,   |u_j| ≤ 1,  σ ≥ 0

Controls, errors and slacks have piecewise linear costs; the penalties p of equations that must
hold are infinite. A basis that was optimal stays dual feasible when rows are added, so that a
program with more of them takes a few pivots from the last answer. The ratio test passes kinks of
the dual for as long as it ascends [Maros2003]. For many programs with the same few rows, see
`problems.dual_simplex`.
"""

from math import inf
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import TOLERANCE
from problems.fuel_kernels import FAR, OPTIMAL, STOPPED, append_rows, ascend

Status = Literal["optimal", "infeasible", "stopped"]

PRIMAL_TOLERANCE = 1e-10  # largest violation of a bound, for rows of norm 1
REFRESHED_TOLERANCE = 1e-9  # the same of values that were computed anew
MAX_PIVOTS = 3000
# Arrays that grow with the rows: each is all of its memory, or the first part of it.
BY_ROW = tuple("_kinks _slopes _place _basic _coeffs _offset _room _tableau _value".split())


class FuelProgram:
    """Program with the tableau of its basis; variables are the controls, σ and a slack of each row.

    Kinks and slopes of the cost of a variable alternate: kinks[0], slopes[0], kinks[1], … A
    nonbasic variable is at kinks[place], with a price between the slopes before and after; a
    basic one is between kinks[place] and kinks[place + 1].
    """

    def __init__(self, weights: Float[Array, " n"], penalty: float = inf) -> None:
        """Begin without rows, with controls of zero; an infinite penalty P keeps σ at zero."""
        n = len(weights) + 1
        controls, slack = [-FAR, -1.0, 0.0, 1.0, FAR], [-FAR, 0.0, FAR, FAR, FAR]
        self._kinks = np.vstack([np.tile(controls, (n - 1, 1)), slack])
        never = np.full(n - 1, inf)
        slopes = np.stack([-never, -weights, weights, never], axis=1)
        self._slopes = np.vstack([slopes, [-inf, penalty, inf, inf]])
        self._place, self._nonbasic = np.full(n, 2), np.arange(n)
        self._place[-1] = 1
        self._basic = np.zeros(0, dtype=int)
        self._coeffs, self._offset, self._room = np.zeros((0, n)), np.zeros(0), np.zeros(0)
        self._tableau, self._value, self._price = np.zeros((0, n)), np.zeros(0), np.zeros(n)
        self._ray = np.zeros(n)  # of prices, along which the dual was found unbounded
        self.pivot_count = 0

    def add(
        self,
        coeffs: Float[Array, "k n"],
        offset: Float[Array, " k"],
        penalty: Float[Array, " k"] | None = None,
        is_relaxed: bool = False,
        room: float | Float[Array, " k"] = 0.0,
    ) -> None:
        """Add rows coeffs · u + offset ≥ 0, or = 0.

        A penalty is of the error of each equation, None for inequalities, which σ may violate if
        relaxed. The room is a margin that was subtracted from each offset.
        """
        kinks = [-FAR, 0.0, FAR if penalty is None else 0.0, FAR, FAR]
        penalty = np.full(len(coeffs), inf) if penalty is None else penalty
        first, room = len(self._basic), np.full(len(offset), room, dtype=float)
        for name in BY_ROW:
            self._extend(name, len(offset))
        given = np.ascontiguousarray(coeffs), offset, np.array(kinks), penalty, room, is_relaxed
        costs, basis = (self._kinks, self._slopes), (self._place, self._nonbasic, self._basic)
        rows = self._coeffs, self._offset, self._room, self._tableau, self._value
        append_rows(first, *given, *costs, *basis, *rows)

    def _extend(self, name: str, more: int) -> None:
        """Extend an array by rows, in place where there is memory for them."""
        array: Array = getattr(self, name)
        count, memory = len(array), array if array.base is None else array.base
        if len(memory) < count + more:
            memory = np.empty((2 * (count + more), *array.shape[1:]), dtype=array.dtype)
            memory[:count] = array
        setattr(self, name, memory[: count + more])

    def solve(self) -> Status:
        """Solve the program with all rows that were added, from the last basis.

        Infeasibility is verified, by the ray along which the dual is unbounded; for an optimum, see
        `confirm`. "stopped" is no answer.
        """
        self._ray = np.zeros(len(self._place))
        status = self._pivot(PRIMAL_TOLERANCE)
        while status == STOPPED and self._refresh():
            status = self._pivot(PRIMAL_TOLERANCE)
        return "optimal" if status == OPTIMAL else self.confirm()

    def confirm(self) -> Status:
        """Compute the answer anew from its basis, and verify it; an optimum by its dual bound."""
        while self._refresh():
            before, status = self.pivot_count, self._pivot(REFRESHED_TOLERANCE)
            if status == STOPPED or self.pivot_count > before:
                continue
            if status == OPTIMAL:
                return "optimal" if self._is_optimal() else "stopped"
            return "infeasible" if self._is_unbounded() else "stopped"
        return "stopped"

    def _pivot(self, tolerance: float) -> int:
        tableau = self._tableau, self._value, self._price, self._ray, tolerance
        basis = self._place, self._nonbasic, self._basic
        status, pivots = ascend(self._kinks, self._slopes, *basis, *tableau)
        self.pivot_count += pivots
        return int(status)

    @property
    def controls(self) -> Float[Array, " n"]:
        """Values of the controls, within their bounds."""
        return np.asarray(np.clip(self._values()[: self._coeffs.shape[1] - 1], -1.0, 1.0))

    @property
    def slack(self) -> float:
        """Value of σ."""
        return float(self._values()[self._coeffs.shape[1] - 1])

    def _values(self) -> Float[Array, " variables"]:
        value = np.zeros(len(self._place))
        value[self._nonbasic] = self._kinks[self._nonbasic, self._place[self._nonbasic]]
        value[self._basic] = self._value
        return value

    def _refresh(self) -> bool:
        """Compute the tableau, values and prices from the basis alone; False where that fails."""
        n = self._coeffs.shape[1]
        is_row, is_basic_row = self._nonbasic >= n, self._basic >= n
        free, at = self._basic[~is_basic_row], self._nonbasic[~is_row]
        tight, loose = self._nonbasic[is_row] - n, self._basic[is_basic_row] - n
        # Of tight rows, whose slacks are zero: coeffs[free] u[free] = −offset − coeffs[at] u[at].
        on_known = self._coeffs[np.ix_(tight, at)]
        constant = self._offset[tight] + on_known @ self._kinks[at, self._place[at]]
        right = np.column_stack([np.eye(len(tight)), -on_known, -constant])
        try:
            solved = np.linalg.solve(self._coeffs[np.ix_(tight, free)], right)
        except np.linalg.LinAlgError:
            return False
        upper = np.empty((len(free), n))
        upper[:, is_row], upper[:, ~is_row] = np.split(solved[:, :-1], [len(tight)], axis=1)
        lower = self._coeffs[np.ix_(loose, free)] @ upper
        lower[:, ~is_row] += self._coeffs[np.ix_(loose, at)]
        self._tableau[~is_basic_row], self._tableau[is_basic_row] = upper, lower
        self._value[~is_basic_row] = solved[:, -1]
        u = self._values()[:n]
        self._value[is_basic_row] = self._coeffs[loose] @ u + self._offset[loose]
        self._price = -self._slopes[self._basic, self._place[self._basic]] @ self._tableau
        return self.pivot_count < MAX_PIVOTS

    def _is_optimal(self) -> bool:
        """Check the cost against the dual bound, by the rows alone."""
        n = self._coeffs.shape[1]
        price = np.zeros(len(self._place))
        price[self._nonbasic] = self._price
        price[self._basic] = self._slopes[self._basic, self._place[self._basic]]
        price, is_equation = self._clip_prices(price)
        u = np.append(self.controls, max(self.slack, 0.0))
        weights = np.append(self._slopes[: n - 1, 2], self._slopes[n - 1, 1])
        error = self._coeffs @ u + self._offset
        violation = np.where(is_equation, np.abs(error), np.maximum(-error, 0.0))
        is_hard, penalty = np.isinf(self._slopes[n:, 0]), -self._slopes[n:, 0]
        cost = weights[u != 0] @ np.abs(u[u != 0]) + penalty[~is_hard] @ violation[~is_hard]
        # What costs no more has a σ of at most cost / P.
        most = np.append(np.ones(n - 1), cost / weights[-1])
        drift = np.maximum(np.abs(price @ self._coeffs) - weights, 0.0)
        bound = price @ self._offset - most @ drift
        is_met = violation[is_hard].max(initial=0.0) <= 2 * REFRESHED_TOLERANCE
        return bool(is_met and abs(cost - bound) <= TOLERANCE * (1 + cost))

    def _is_unbounded(self) -> bool:
        """Check that no controls satisfy what a ray of prices adds up to, by the rows alone."""
        n = self._coeffs.shape[1]
        ray, _ = self._clip_prices(self._ray / max(np.abs(self._ray[n:]).max(), 1e-300))
        # What may be violated at a finite price is no reason.
        is_relaxed = (self._coeffs[:, -1] > 0) & np.isfinite(self._slopes[n - 1, 1])
        ray[np.isfinite(self._slopes[n:, 0]) | is_relaxed] = 0.0
        drift = np.abs(ray @ self._coeffs[:, :-1]).sum()
        return bool(ray @ (self._offset + self._room) - drift > REFRESHED_TOLERANCE)

    def _clip_prices(self, price: Float[Array, " variables"]) -> tuple[Array, Array]:
        """Return the prices of rows within their bounds, and True for equations."""
        n = self._coeffs.shape[1]
        is_equation, low = self._kinks[n:, 2] == 0, self._slopes[n:, 0]
        return np.clip(price[n:], low, np.where(is_equation, -low, 0.0)), is_equation
