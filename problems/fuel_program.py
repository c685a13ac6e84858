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
from typing import Literal, no_type_check

import numba
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import TOLERANCE

Status = Literal["optimal", "infeasible", "stopped"]

PRIMAL_TOLERANCE = 1e-10  # largest violation of a bound, for rows of norm 1
REFRESHED_TOLERANCE = 1e-9  # the same of values that were computed anew
ZERO_ENTRY = 1e-10  # over the norm of its row: an entry of the tableau that counts as zero
MIN_RELATIVE_PIVOT = 1e-1  # of the largest entry among the kinks that are passed
SMALL_PIVOT = 1e-5  # after which the tableau is computed anew
REFRESH_PIVOTS = 100  # after which the tableau is computed anew
MAX_PIVOTS = 3000
FAR = 1e30  # a kink that is never reached
TINY = float(np.finfo(float).tiny)
OPTIMAL, INFEASIBLE, STOPPED = 0, 1, 2
# Arrays that grow with the rows: each is all of its memory, or the first part of it.
BY_ROW = tuple("_kinks _slopes _place _basic _coeffs _offset _room _tableau _value".split())


class FuelProgram:
    """Program with the tableau of its basis; variables are the controls, σ and a slack of each row.

    Kinks and slopes of the cost of a variable alternate: kinks[0], slopes[0], kinks[1], … A
    nonbasic variable is at kinks[place], with a price between the slopes before and after; a
    basic one is between kinks[place] and kinks[place + 1].
    """

    def __init__(self, weights: Float[Array, " n"], penalty: float = inf) -> None:
        """Begin without rows, with all controls zero.

        Args:
            weights: w, positive, of the order of 1.
            penalty: P; infinite where σ is zero.
        """
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

    def add_equations(
        self,
        coeffs: Float[Array, "k n"],
        offset: Float[Array, " k"],
        penalty: Float[Array, " k"],
    ) -> None:
        """Add rows coeffs · u + offset = 0, with the penalties of their errors."""
        self._add(coeffs, offset, [-FAR, 0.0, 0.0, FAR, FAR], penalty)

    def add_inequalities(
        self,
        coeffs: Float[Array, "k n"],
        offset: Float[Array, " k"],
        is_relaxed: bool = False,
        room: float | Float[Array, " k"] = 0.0,
    ) -> None:
        """Add rows coeffs · u + offset ≥ 0.

        Args:
            coeffs: Entries of each row.
            offset: Constant of each row.
            is_relaxed: True where rows may be violated by σ.
            room: Margin that was subtracted from each offset.
        """
        never = np.full(len(coeffs), inf)
        self._add(coeffs, offset, [-FAR, 0.0, FAR, FAR, FAR], never, is_relaxed, room)

    def _add(
        self,
        coeffs: Float[Array, "k n"],
        offset: Float[Array, " k"],
        kinks: list[float],
        penalty: Float[Array, " k"],
        is_relaxed: bool = False,
        room: float | Float[Array, " k"] = 0.0,
    ) -> None:
        first, room = len(self._basic), np.full(len(offset), room, dtype=float)
        for name in BY_ROW:
            self._extend(name, len(offset))
        given = np.ascontiguousarray(coeffs), offset, np.array(kinks), penalty, room, is_relaxed
        costs, basis = (self._kinks, self._slopes), (self._place, self._nonbasic, self._basic)
        rows = self._coeffs, self._offset, self._room, self._tableau, self._value
        _append(first, *given, *costs, *basis, *rows)

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
        status, pivots = _ascend(self._kinks, self._slopes, *basis, *tableau)
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _append(
    first,
    coeffs,
    offset,
    row_kinks,
    penalty,
    room,
    is_relaxed,
    kinks,
    slopes,
    place,
    nonbasic,
    basic,
    own_coeffs,
    own_offset,
    own_room,
    tableau,
    value,
):
    # Writes the rows from the first on, scaled to a norm of 1, with their slacks in the basis.
    n = tableau.shape[1]
    x = np.empty(n)
    for j in range(n):
        if nonbasic[j] < n:
            x[nonbasic[j]] = kinks[nonbasic[j], place[nonbasic[j]]]
    for i in range(first):
        if basic[i] < n:
            x[basic[i]] = value[i]
    for k in range(len(offset)):
        row, slack, square = first + k, n + first + k, 0.0
        for j in range(n - 1):
            square += coeffs[k, j] ** 2
        size = np.sqrt(square) if square > TINY else 1.0
        for j in range(n - 1):
            own_coeffs[row, j] = coeffs[k, j] / size
        own_coeffs[row, n - 1] = is_relaxed / size
        own_offset[row], own_room[row] = offset[k] / size, room[k] / size
        value[row] = own_offset[row]
        for j in range(n):
            value[row] += own_coeffs[row, j] * x[j]
            is_control = nonbasic[j] < n
            tableau[row, j] = own_coeffs[row, nonbasic[j]] if is_control else 0.0
        for i in range(first):
            if basic[i] < n and own_coeffs[row, basic[i]] != 0.0:
                for j in range(n):
                    tableau[row, j] += own_coeffs[row, basic[i]] * tableau[i, j]
        for j in range(len(row_kinks)):
            kinks[slack, j] = row_kinks[j]
        slopes[slack, 0], slopes[slack, 1] = -penalty[k] * size, 0.0
        slopes[slack, 2], slopes[slack, 3] = penalty[k] * size, np.inf
        place[slack], basic[row] = 1, slack


@numba.njit(cache=True, nogil=True, error_model="numpy")
@no_type_check
def _ascend(
    kinks,
    slopes,
    place,
    nonbasic,
    basic,
    tableau,
    value,
    price,
    ray,
    tolerance,
):
    # Pivots until all basic variables are in their segments, or the dual is unbounded along the
    # ray that is written. Changes all but kinks and slopes; returns the status and the pivots.
    (m, n), pivots = tableau.shape, 0
    step, drop, entry = np.empty(2 * n + 2), np.empty(2 * n + 2), np.empty(n + 1)
    candidate, passed = np.empty(2 * n + 2, np.int64), np.empty(2 * n + 2, np.int64)
    while pivots < REFRESH_PIVOTS:
        leaving, violation, sign, norm = _choose_leaving(
            kinks, place, basic, tableau, value, tolerance
        )
        if leaving < 0:
            return OPTIMAL, pivots
        own, count = basic[leaving], 0
        own_price = slopes[own, place[own]]
        place[own] += sign > 0
        # The last candidate is the leaving variable itself, which may pass its kink and stay.
        for j in range(n + 1):
            entry[j] = sign if j == n else -sign * tableau[leaving, j]
            if abs(entry[j]) <= ZERO_ENTRY * norm:
                continue
            variable = own if j == n else nonbasic[j]
            at, way = place[variable], 1 if entry[j] > 0 else -1
            for _ in range(2):
                bound = slopes[variable, at - (way < 0)]
                if abs(bound) == np.inf:
                    break
                past = bound - (own_price if j == n else price[j])
                step[count], candidate[count] = max(past / entry[j], 0.0), j
                length = abs(kinks[variable, at + way] - kinks[variable, at])
                drop[count] = length * abs(entry[j])
                count, at = count + 1, at + way
                if length == FAR:
                    break
        last = _choose_entering(step, drop, candidate, entry, passed, count, violation, tolerance)
        if last < 0:
            place[own] -= sign > 0
            ray[:] = 0.0
            for j in range(n):
                ray[nonbasic[j]] = entry[j]
            ray[own] = sign
            return INFEASIBLE, pivots
        pivots += 1
        for k in range(last):
            j = candidate[passed[k]]
            variable, way = own if j == n else nonbasic[j], 1 if entry[j] > 0 else -1
            jump = kinks[variable, place[variable] + way] - kinks[variable, place[variable]]
            place[variable] += way
            if j < n and jump != 0.0:
                for i in range(m):
                    value[i] += tableau[i, j] * jump
        enter, length = candidate[passed[last]], step[passed[last]]
        for j in range(n):
            price[j] -= sign * length * tableau[leaving, j]
        if enter == n:
            place[own] -= sign < 0
            continue
        variable, pivot = nonbasic[enter], tableau[leaving, enter]
        start = kinks[variable, place[variable]]
        move = (kinks[own, place[own]] - value[leaving]) / pivot
        for i in range(m):
            value[i] += tableau[i, enter] * move
        value[leaving] = start + move
        place[variable] -= entry[enter] < 0
        basic[leaving], nonbasic[enter] = variable, own
        price[enter] = own_price + sign * length
        _exchange(tableau, leaving, enter)
        if abs(pivot) < SMALL_PIVOT:
            break
    return STOPPED, pivots


@numba.njit(error_model="numpy")
@no_type_check
def _choose_leaving(kinks, place, basic, tableau, value, tolerance):
    # Steepest ascent: violation over the norm of the row.
    leaving, largest, sign, norm, steepest = -1, 0.0, 0.0, 0.0, 0.0
    for i in range(len(basic)):
        v = basic[i]
        below, above = kinks[v, place[v]] - value[i], value[i] - kinks[v, place[v] + 1]
        violation = max(below, above)
        if violation <= tolerance:
            continue
        square = 1.0
        for j in range(tableau.shape[1]):
            square += tableau[i, j] ** 2
        if violation**2 > steepest * square:
            leaving, largest, steepest = i, violation, violation**2 / square
            norm = np.sqrt(square)
            sign = 1.0 if above > below else -1.0
    return leaving, largest, sign, norm


@numba.njit(error_model="numpy")
@no_type_check
def _choose_entering(step, drop, candidate, entry, passed, count, slope, tolerance):
    # Passes kinks, the nearest first, until the dual descends; then goes back to a safe pivot.
    # Written: their order. Returns the place of the one that ends the ascent, or −1.
    largest, last = 0.0, -1
    for k in range(count):
        passed[k] = k
    for k in range(count):
        first = k
        for other in range(k + 1, count):
            if step[passed[other]] < step[passed[first]]:
                first = other
        passed[k], passed[first] = passed[first], passed[k]
        own = abs(entry[candidate[passed[k]]])
        largest = max(largest, own)
        if own >= MIN_RELATIVE_PIVOT * largest:
            last = k
        slope -= drop[passed[k]]
        if slope <= 0.0:
            return last
    return last if slope <= tolerance else -1


@numba.njit(error_model="numpy")
@no_type_check
def _exchange(tableau, leaving, enter):
    # Exchanges a basic and a nonbasic variable.
    m, n = tableau.shape
    pivot = tableau[leaving, enter]
    for j in range(n):
        tableau[leaving, j] /= -pivot
    tableau[leaving, enter] = 1.0 / pivot
    for i in range(m):
        factor = tableau[i, enter]
        if i == leaving or factor == 0.0:
            continue
        tableau[i, enter] = 0.0
        for j in range(n):
            tableau[i, j] += factor * tableau[leaving, j]
