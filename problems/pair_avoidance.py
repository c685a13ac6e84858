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

from problems.avoidance import AvoidanceProblem, HalfSpaces, condense_half_spaces
from problems.conic import ConicProgram, solve
from problems.convexify import AvoidanceHorizon, convexify
from problems.solvers import solve_clarabel
from problems.transfer import Trajectory, TransferProblem, solve_cvxpy


class PairMember(NamedTuple):
    """What one of the two brings."""

    transfer: TransferProblem
    start: Float[Array, " n"]
    goal: Float[Array, " n"]
    half_spaces: HalfSpaces  # that it keeps by itself, of all others


class RelativeHalfSpaces(NamedTuple):
    """What the two keep together: their rows add up, kept₁ + kept₂ ≥ least₁ + least₂."""

    first: HalfSpaces
    second: HalfSpaces

    @classmethod
    def from_normals(
        cls, horizon: AvoidanceHorizon, T: int, normal: Float[Array, "pieces d"]
    ) -> "RelativeHalfSpaces":
        """n·(c₁ − c₂) ≥ R for every control point that they can still move.

        Args:
            horizon: How far to look, and how paths are cut.
            T: Steps that both have left.
            normal: Directions from the second to the first, see `convexify.normals`.
        """
        nobody = np.zeros((1, len(normal), 4, normal.shape[1]))
        first = convexify(horizon, T, nobody, normal[None])
        second = convexify(horizon, T, nobody, -normal[None])
        return cls(first, second._replace(rhs=second.rhs - horizon.required_separation))

    def violation(self, first: Trajectory, second: Trajectory) -> Float[Array, " rows"]:
        """By how much each row is broken; negative where it holds with room."""
        own, other = (
            self.first.violation(first.x, first.u),
            self.second.violation(second.x, second.u),
        )
        return np.asarray(own + other)

    def select(self, rows: Array) -> "RelativeHalfSpaces":
        """Some of the rows."""
        return RelativeHalfSpaces(self.first.select(rows), self.second.select(rows))


@dataclass(frozen=True, eq=False)
class PairProblem:
    """Two transfers that keep apart.

    minimise    Δt Σ w₁[k] ‖u₁[k]‖_q + Δt Σ w₂[k] ‖u₂[k]‖_q
    subject to  (10), (12), (14), (18), (66)      of each, as in Transfer
                n · (c(x[k], u[k]) − c̄) ≥ R       of each, as in Avoidance
                n · (c₁(x₁, u₁) − c₂(x₂, u₂)) ≥ R
    """

    first: PairMember
    second: PairMember
    relative_half_spaces: RelativeHalfSpaces

    def solve(self) -> tuple[Trajectory, Trajectory]:
        """Flights of both, for the least fuel of both together, weighted as their transfers do.

        Raises:
            Infeasible: No two flights do it.
            Unsolved: The solver stopped for any other reason.
        """
        for side in self._members:
            side.transfer.require_steps()
        norms = {(side.transfer.fuel_norm, side.transfer.control_norm) for side in self._members}
        return self._solve_condensed() if norms == {(1, "inf")} else self.solve_cvxpy()

    @property
    def _members(self) -> tuple[PairMember, PairMember]:
        return self.first, self.second

    def solve_cvxpy(self) -> tuple[Trajectory, Trajectory]:
        """The same, by the statement in CVXPY: for any norms, and as a second opinion."""
        import cvxpy as cp

        cost: Any = 0
        together: Any = 0
        limits, controls = [], []
        for side, common in zip(self._members, self.relative_half_spaces, strict=True):
            x, u, effort, own = side.transfer.build_cvxpy(side.start)
            cost += effort
            limits += [*own, x[len(side.transfer.model)] == side.goal]
            if len(side.half_spaces.rhs):
                limits.append(side.half_spaces.to_cvxpy(x, u) >= side.half_spaces.rhs)
            if len(common.rhs):
                together += common.to_cvxpy(x, u) - common.rhs
            controls.append(u)
        if len(self.relative_half_spaces.first.rhs):
            limits.append(together >= 0)
        solve_cvxpy(self, cp.Problem(cp.Minimize(cost), limits))
        return self._simulate([np.asarray(u.value) for u in controls])

    def _simulate(self, controls: list[Array]) -> tuple[Trajectory, Trajectory]:
        first, second = (
            side.transfer.simulate(side.start, u)
            for side, u in zip(self._members, controls, strict=True)
        )
        return first, second

    def _solve_condensed(self) -> tuple[Trajectory, Trajectory]:
        """Fast path: the states eliminated, speed limits only where they would be broken."""
        alone = [AvoidanceProblem(side.transfer) for side in self._members]
        fast: list[list[int]] = [[], []]
        while True:
            parts = [
                own.assemble_conic(side.start, side.goal, side.half_spaces, "none", known)
                for own, side, known in zip(alone, self._members, fast, strict=True)
            ]
            found = np.split(
                solve(self._assemble_joint(parts), solve_clarabel).x, [len(parts[0].q)]
            )
            flights = self._simulate(
                [own.extract_controls(x) for own, x in zip(alone, found, strict=True)]
            )
            broken = [
                own.find_speed_violations(flight.x, known)
                for own, flight, known in zip(alone, flights, fast, strict=True)
            ]
            if not any(broken):
                return flights
            fast = [known + more for known, more in zip(fast, broken, strict=True)]

    def _assemble_joint(self, parts: list[ConicProgram]) -> ConicProgram:
        """Both programmes side by side, and the rows that they share."""
        blocks, room = [], np.zeros(len(self.relative_half_spaces.first.rhs))
        for side, common in zip(self._members, self.relative_half_spaces, strict=True):
            transfer = side.transfer
            on_u, own_room = condense_half_spaces(transfer, common, transfer.coast(side.start))
            blocks.append(transfer.max_control * np.hstack([-on_u, on_u]))
            room += own_room
        shared = np.hstack(blocks)
        near = np.abs(shared).sum(axis=1) / 2 > room  # the many that no control can break are out
        equations, limits, cones = (
            (
                block_diag([p.A.tocsr()[rows] for p, rows in zip(parts, which, strict=True)]),
                np.concatenate([p.b[rows] for p, rows in zip(parts, which, strict=True)]),
            )
            for which in zip(*map(_row_slices, parts), strict=True)
        )
        return ConicProgram(
            np.concatenate([p.q for p in parts]),
            csc_array(vstack([equations[0], limits[0], csc_array(shared[near]), cones[0]])),
            np.concatenate([equations[1], limits[1], room[near], cones[1]]),
            sum(p.zero for p in parts),
            sum(p.nonnegative for p in parts) + int(near.sum()),
            parts[0].soc_sizes + parts[1].soc_sizes,
        )


def _row_slices(part: ConicProgram) -> tuple[slice, slice, slice]:
    """Rows that are equations, inequalities and cones."""
    first, second = part.zero, part.zero + part.nonnegative
    return slice(first), slice(first, second), slice(second, None)
