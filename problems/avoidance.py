"""Transfer among collision half-spaces [Morgan2016, Problems 5 and 7].

Half-spaces are kept by the control points of the path between the samples, and not at
the samples alone: a path lies in the hull of its control points, so the continuous
path keeps the distance.
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import csc_array

from problems.conic import Conic, solve
from problems.solvers import solve_clarabel
from problems.transfer import Flight, Transfer, solve_statement

Yield = Literal["nothing", "arrival", "separation"]

PENALTY = 1e3  # of a metre missed, over the fuel that flies a metre in the time given


class HalfSpaces(NamedTuple):
    """on_state · x[step] + on_control · u[step] ≥ least, one row each."""

    step: Int[Array, " rows"]
    on_state: Float[Array, "rows n"]
    on_control: Float[Array, "rows m"]
    least: Float[Array, " rows"]

    def missing(
        self, x: Float[Array, "instants n"], u: Float[Array, "T m"]
    ) -> Float[Array, " rows"]:
        """By how much each row is broken; negative where it holds with room."""
        kept = (self.on_state * x[self.step]).sum(1) + (self.on_control * u[self.step]).sum(1)
        return np.asarray(self.least - kept)

    def stated(self, x: Any, u: Any) -> Any:
        """What a flight keeps of each row, of variables in CVXPY."""
        import cvxpy as cp

        on_x = cp.sum(cp.multiply(self.on_state, x[self.step]), axis=1)
        return on_x + cp.sum(cp.multiply(self.on_control, u[self.step]), axis=1)

    def only(self, rows: Array) -> "HalfSpaces":
        """Some of the rows, by a mask or their numbers."""
        return HalfSpaces(*(field[rows] for field in self))


class Passage(NamedTuple):
    """A flight among half-spaces, and what had to give."""

    flight: Flight
    late: float  # distance from the goal at the end, in the largest norm; 0 unless asked
    slack: float  # largest break of a half-space [m]; 0 unless asked


@dataclass(frozen=True, eq=False)
class Avoidance:
    """A transfer that stays inside half-spaces.

        minimise    Δt Σ w[k] ‖u[k]‖_q
        subject to  (10), (12), (14), (18), (66)      as in Transfer
                    n · (c(x[k], u[k]) − c̄) ≥ R       (38), (64), one a control point

    `gives` says what may be broken, at a price far above fuel, where not everything can
    be kept: nothing, the arrival, or the arrival and then the separation.
    """

    transfer: Transfer

    def solve(
        self,
        start: Float[Array, " n"],
        goal: Float[Array, " n"],
        spaces: HalfSpaces,
        gives: Yield = "nothing",
    ) -> Passage:
        """Fly from start to goal inside the half-spaces.

        Raises:
            Infeasible: No flight does it, without breaking more than `gives` allows.
        """
        self.transfer.needs_steps()
        if (self.transfer.fuel_norm, self.transfer.control_norm) == (1, "inf"):
            return self._solve_assembled(start, goal, spaces, gives)
        return self.solve_stated(start, goal, spaces, gives)

    def solve_stated(
        self, start: Array, goal: Array, spaces: HalfSpaces, gives: Yield = "nothing"
    ) -> Passage:
        """The same, by the statement in CVXPY: for any norms, and as a second opinion."""
        import cvxpy as cp

        T, n = len(self.transfer.steps), len(start)
        x, u, effort, limits = self.transfer.statement(start)
        late, slack = cp.Variable(n), cp.Variable(len(spaces.least), nonneg=True)
        arrive = x[T] + late == goal
        kept = spaces.stated(x, u)
        apart = [kept + slack >= spaces.least] if len(spaces.least) else []
        price = self._price
        missed = cp.norm1(cp.multiply(self._units, late)) + 10 * cp.sum(slack)
        cost = effort + price * missed
        fixed = []
        if gives == "nothing":
            fixed.append(late == 0)
        if gives != "separation":
            fixed.append(slack == 0)
        problem = cp.Problem(cp.Minimize(cost), [*limits, arrive, *apart, *fixed])
        solve_statement(self, problem)
        return self._passage(start, goal, np.asarray(u.value), spaces, gives)

    def _passage(
        self, start: Array, goal: Array, u: Array, spaces: HalfSpaces, gives: Yield
    ) -> Passage:
        flight = self.transfer.flight(start, u)
        late = 0.0 if gives == "nothing" else float(np.abs(flight.x[-1] - goal).max())
        slack = 0.0
        if gives == "separation":
            slack = float(spaces.missing(flight.x, flight.u).max(initial=0.0))
        return Passage(flight, late, slack)

    @cached_property
    def _price(self) -> float:
        duration = len(self.transfer.steps) * self.transfer.steps.dt
        return PENALTY / duration

    @cached_property
    def _units(self) -> Array:
        # A speed missed weighs as the distance it covers in a step.
        d = self.transfer.steps.axes
        return np.repeat([1.0, self.transfer.steps.dt], d)

    def _solve_assembled(
        self, start: Array, goal: Array, spaces: HalfSpaces, gives: Yield
    ) -> Passage:
        """Fast path: the states eliminated, speed limits only where they would be broken."""
        fast: list[int] = []
        while True:
            problem = self.assemble(start, goal, spaces, gives, fast)
            u = self.controls(solve(problem, solve_clarabel).x)
            passage = self._passage(start, goal, u, spaces, gives)
            broken = self.too_fast(passage.flight.x, fast)
            if not len(broken):
                return passage
            fast = [*fast, *broken]

    def too_fast(self, x: Float[Array, "instants n"], known: list[int]) -> list[int]:
        """Instants at which a flight breaks the speed limit, beyond those known."""
        d = self.transfer.steps.axes
        speed = np.linalg.norm(x[1:-1, d:], axis=1)
        over = np.flatnonzero(speed > self.transfer.max_speed * (1 + 1e-9)) + 1
        return [int(k) for k in over if int(k) not in known]

    def controls(self, found: Float[Array, " unknowns"]) -> Float[Array, "T m"]:
        """The controls in an answer to what `assemble` gives."""
        T, m = len(self.transfer.steps), self.transfer.steps.axes
        plus, minus = found[: T * m], found[T * m : 2 * T * m]
        U = self.transfer.max_control
        return np.asarray(np.clip(U * (plus - minus), -U, U)).reshape(T, m)

    def assemble(
        self,
        start: Float[Array, " n"],
        goal: Float[Array, " n"],
        spaces: HalfSpaces,
        gives: Yield,
        fast: list[int],
    ) -> Conic:
        """The programme with the states eliminated, and speed limits at some instants.

        Unknowns are u⁺ and u⁻ in units of U, then lateness ± in metres, then slack.
        """
        transfer, (R, lower) = self.transfer, self.transfer.response
        T, n, m = transfer.steps.B.shape
        U, N = transfer.max_control, T * m
        free = transfer.coast(start)
        on_u, room = by_controls(transfer, spaces, free)
        near = U * np.abs(on_u).sum(axis=1) > room  # the many that no control can break are out
        on_u, room = on_u[near], room[near]
        rows = len(room)
        lates = 0 if gives == "nothing" else n
        slacks = rows if gives == "separation" else 0
        columns = 2 * N + 2 * lates + slacks
        slack_at = 2 * N + 2 * lates

        fuel = U * transfer.steps.dt * np.repeat(transfer.weight, m)
        price = self._price
        q = np.concatenate([fuel, fuel, np.full(2 * lates, price), np.full(slacks, 10 * price)])

        whiten = np.linalg.inv(lower)
        arrive = np.zeros((n, columns))
        arrive[:, :N] = U * whiten @ R[T]
        arrive[:, N : 2 * N] = -arrive[:, :N]
        if lates:
            unit = whiten / self._units
            arrive[:, 2 * N : 2 * N + n], arrive[:, 2 * N + n : slack_at] = unit, -unit
        scale = 1 / U
        arrive, reach = scale * arrive, scale * whiten @ (goal - free[T])

        apart = np.zeros((rows, columns))
        apart[:, :N], apart[:, N : 2 * N] = -U * on_u, U * on_u
        apart[np.arange(slacks), slack_at + np.arange(slacks)] = -1

        sides = np.concatenate([np.ones(2 * N), np.zeros(columns)])
        cones, tops = self._speed_cones(R, free, fast, columns)
        A = _boxed(np.vstack([arrive, apart]), 2 * N, cones)
        b = np.concatenate([reach, room, sides, tops])
        return Conic(q, A, b, n, rows + len(sides), (transfer.steps.axes + 1,) * len(fast))

    def _speed_cones(
        self, R: Array, free: Array, fast: list[int], columns: int
    ) -> tuple[Array, Array]:
        d, U = self.transfer.steps.axes, self.transfer.max_control
        N = R.shape[2]
        cones = np.zeros((len(fast), d + 1, columns))
        tops = np.zeros((len(fast), d + 1))
        for row, k in enumerate(fast):
            cones[row, 1:, :N], cones[row, 1:, N : 2 * N] = -U * R[k, d:], U * R[k, d:]
            tops[row, 0], tops[row, 1:] = self.transfer.max_speed, free[k, d:]
        return cones.reshape(-1, columns), tops.ravel()


def by_controls(
    transfer: Transfer, spaces: HalfSpaces, free: Float[Array, "instants n"]
) -> tuple[Float[Array, "rows controls"], Float[Array, " rows"]]:
    """on_u and room of −on_u · u ≤ room, for flights that coast as given."""
    R, m = transfer.response[0], transfer.steps.axes
    on_u = np.einsum("rn,rnj->rj", spaces.on_state, R[spaces.step])
    for r, k in enumerate(spaces.step):
        on_u[r, k * m : (k + 1) * m] += spaces.on_control[r]
    room = (spaces.on_state * free[spaces.step]).sum(1) - spaces.least
    return on_u, room


def _boxed(above: Array, count: int, below: Array) -> csc_array:
    """Rows, then x ≤ 1 for as many unknowns, then x ≥ 0 for all, then rows; as it is sparse."""
    first, columns = above.shape
    own, last = np.arange(columns), first + count + columns
    value = np.vstack([above, own < count, -np.ones(columns), below]).T
    row = np.vstack([
        np.broadcast_to(np.arange(first)[:, None], above.shape),
        first + own,
        first + count + own,
        np.broadcast_to(last + np.arange(len(below))[:, None], below.shape),
    ]).T  # fmt: skip
    there = value != 0
    starts = np.concatenate([[0], np.cumsum(there.sum(axis=1))])
    return csc_array((value[there], row[there], starts), shape=(last + len(below), columns))


def no_spaces(transfer: Transfer) -> HalfSpaces:
    """Half-spaces for an agent that meets nobody."""
    n, m = transfer.steps.B.shape[1:]
    return HalfSpaces(np.zeros(0, int), np.zeros((0, n)), np.zeros((0, m)), np.zeros(0))
