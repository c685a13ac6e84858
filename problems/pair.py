"""Two transfers as one programme, in which both give way: for two agents that bargain.

Where one agent goes before the other, the half-spaces of `avoidance` hold for the other alone.
Here both are free to move, and a half-space holds for their relative path.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import block_diag, csc_array, vstack

from problems.avoidance import Avoidance, HalfSpaces, by_controls
from problems.conic import Conic, solve
from problems.convexify import Horizon, half_spaces
from problems.solvers import solve_clarabel
from problems.transfer import Flight, Transfer, solve_statement


class Side(NamedTuple):
    """What one of the two brings."""

    transfer: Transfer
    start: Float[Array, " n"]
    goal: Float[Array, " n"]
    spaces: HalfSpaces  # that it keeps by itself, of all others


class Between(NamedTuple):
    """What the two keep together: their rows add up, kept₁ + kept₂ ≥ least₁ + least₂."""

    first: HalfSpaces
    second: HalfSpaces

    @classmethod
    def of(cls, horizon: Horizon, T: int, normal: Float[Array, "pieces d"]) -> "Between":
        """n·(c₁ − c₂) ≥ R for every control point that they can still move.

        Args:
            horizon: How far to look, and how paths are cut.
            T: Steps that both have left.
            normal: Directions from the second to the first, see `convexify.normals`.
        """
        nobody = np.zeros((1, len(normal), 4, normal.shape[1]))
        first = half_spaces(horizon, T, nobody, normal[None])
        second = half_spaces(horizon, T, nobody, -normal[None])
        return cls(first, second._replace(least=second.least - horizon.keep))

    def missing(self, first: Flight, second: Flight) -> Float[Array, " rows"]:
        """By how much each row is broken; negative where it holds with room."""
        own, other = self.first.missing(first.x, first.u), self.second.missing(second.x, second.u)
        return np.asarray(own + other)

    def only(self, rows: Array) -> "Between":
        """Some of the rows."""
        return Between(self.first.only(rows), self.second.only(rows))


@dataclass(frozen=True, eq=False)
class Pair:
    """Two transfers that keep apart.

    minimise    Δt Σ w₁[k] ‖u₁[k]‖_q + Δt Σ w₂[k] ‖u₂[k]‖_q
    subject to  (10), (12), (14), (18), (66)      of each, as in Transfer
                n · (c(x[k], u[k]) − c̄) ≥ R       of each, as in Avoidance
                n · (c₁(x₁, u₁) − c₂(x₂, u₂)) ≥ R
    """

    first: Side
    second: Side
    between: Between

    def solve(self) -> tuple[Flight, Flight]:
        """Flights of both, for the least fuel of both together, weighted as their transfers do.

        Raises:
            Infeasible: No two flights do it.
            Unsolved: The solver stopped for any other reason.
        """
        for side in self._sides:
            side.transfer.needs_steps()
        norms = {(side.transfer.fuel_norm, side.transfer.control_norm) for side in self._sides}
        return self._solve_assembled() if norms == {(1, "inf")} else self.solve_stated()

    @property
    def _sides(self) -> tuple[Side, Side]:
        return self.first, self.second

    def solve_stated(self) -> tuple[Flight, Flight]:
        """The same, by the statement in CVXPY: for any norms, and as a second opinion."""
        import cvxpy as cp

        cost: Any = 0
        together: Any = 0
        limits, controls = [], []
        for side, common in zip(self._sides, self.between, strict=True):
            x, u, effort, own = side.transfer.statement(side.start)
            cost += effort
            limits += [*own, x[len(side.transfer.steps)] == side.goal]
            if len(side.spaces.least):
                limits.append(side.spaces.stated(x, u) >= side.spaces.least)
            if len(common.least):
                together += common.stated(x, u) - common.least
            controls.append(u)
        if len(self.between.first.least):
            limits.append(together >= 0)
        solve_statement(self, cp.Problem(cp.Minimize(cost), limits))
        return self._flights([np.asarray(u.value) for u in controls])

    def _flights(self, controls: list[Array]) -> tuple[Flight, Flight]:
        first, second = (
            side.transfer.flight(side.start, u)
            for side, u in zip(self._sides, controls, strict=True)
        )
        return first, second

    def _solve_assembled(self) -> tuple[Flight, Flight]:
        """Fast path: the states eliminated, speed limits only where they would be broken."""
        alone = [Avoidance(side.transfer) for side in self._sides]
        fast: list[list[int]] = [[], []]
        while True:
            parts = [
                own.assemble(side.start, side.goal, side.spaces, "nothing", known)
                for own, side, known in zip(alone, self._sides, fast, strict=True)
            ]
            found = np.split(solve(self._joined(parts), solve_clarabel).x, [len(parts[0].q)])
            flights = self._flights([own.controls(x) for own, x in zip(alone, found, strict=True)])
            broken = [
                own.too_fast(flight.x, known)
                for own, flight, known in zip(alone, flights, fast, strict=True)
            ]
            if not any(broken):
                return flights
            fast = [known + more for known, more in zip(fast, broken, strict=True)]

    def _joined(self, parts: list[Conic]) -> Conic:
        """Both programmes side by side, and the rows that they share."""
        blocks, room = [], np.zeros(len(self.between.first.least))
        for side, common in zip(self._sides, self.between, strict=True):
            transfer = side.transfer
            on_u, own_room = by_controls(transfer, common, transfer.coast(side.start))
            blocks.append(transfer.max_control * np.hstack([-on_u, on_u]))
            room += own_room
        shared = np.hstack(blocks)
        near = np.abs(shared).sum(axis=1) / 2 > room  # the many that no control can break are out
        equations, limits, cones = (
            (
                block_diag([p.A.tocsr()[rows] for p, rows in zip(parts, which, strict=True)]),
                np.concatenate([p.b[rows] for p, rows in zip(parts, which, strict=True)]),
            )
            for which in zip(*map(_kinds, parts), strict=True)
        )
        return Conic(
            np.concatenate([p.q for p in parts]),
            csc_array(vstack([equations[0], limits[0], csc_array(shared[near]), cones[0]])),
            np.concatenate([equations[1], limits[1], room[near], cones[1]]),
            sum(p.zero for p in parts),
            sum(p.nonnegative for p in parts) + int(near.sum()),
            parts[0].cones + parts[1].cones,
        )


def _kinds(part: Conic) -> tuple[slice, slice, slice]:
    """Rows that are equations, inequalities and cones."""
    first, second = part.zero, part.zero + part.nonnegative
    return slice(first), slice(first, second), slice(second, None)
