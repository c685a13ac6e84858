"""Nonlinear program of `CentralizedProblem` for CasADi, sparse with exact derivatives."""

from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite
from typing import Annotated, Any, NamedTuple

import numpy as np
from annotated_types import Ge, Gt
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.sparse import bsr_array, csc_matrix, eye_array, hstack

from dynamics.doors import checked
from dynamics.inputs import InputError, check_finite, read_array
from dynamics.symbols import is_symbolic
from problems.convexify import SEPARATION_TOLERANCE, AvoidanceHorizon
from problems.limit import Limit
from problems.sparse_rows import stack_diagonally
from problems.transfer import TransferProblem

MIN_DISTANCE = 1 + SEPARATION_TOLERANCE  # of the pair's R, without padding
PROXIMAL_WEIGHT = 1e-3  # of ‖(u − u₀)/U‖² to the last solution u₀; an optimum u₀ stays optimal

IPOPT_OPTIONS: dict[str, Any] = {
    "print_level": 0,
    "sb": "yes",
    "tol": 1e-9,
    "constr_viol_tol": 1e-9,
    "bound_relax_factor": 0.0,
    "max_iter": 1000,
    "mu_strategy": "adaptive",
}
# From a nearly feasible point: a low initial barrier keeps the solution near it.
WARM_START_OPTIONS = IPOPT_OPTIONS | {
    "mu_strategy": "monotone",
    "mu_init": 1e-4,
    "bound_push": 1e-5,
    "bound_frac": 1e-5,
}

AgentStates = Float[Array, "agents n"]
Ends = tuple[AgentStates, AgentStates]
InitialGuess = tuple[Float[Array, "agents instants n"], Float[Array, "agents T m"]]


class SeparationConstraints(NamedTuple):
    """Instants at which two agents keep a distance, one a row."""

    pair: Int[Array, "rows 2"]
    time: Float[Array, " rows"]  # since the start, in units of a piece
    min_distance: Float[Array, " rows"]  # in units of the pair's R

    @classmethod
    def place(
        cls, pairs: Int[Array, "pairs 2"], near: Bool[Array, "pairs pieces"], per_piece: int
    ) -> "SeparationConstraints":
        """Place so many instants in the pieces in which pairs are near; the ends are data."""
        pair, piece = np.nonzero(near)
        time = (piece + np.arange(1, per_piece + 1)[:, None] / per_piece).ravel()
        inside = time < near.shape[1]
        kept = np.tile(pairs[pair], (per_piece, 1))[inside]
        return cls(kept, time[inside], np.full(len(kept), MIN_DISTANCE))

    def concatenate(self, *more: "SeparationConstraints") -> "SeparationConstraints":
        """Append other constraints."""
        return SeparationConstraints(*map(np.concatenate, zip(self, *more, strict=True)))

    def enlarge_distance(
        self, where: "SeparationConstraints", by: Float[Array, " others"], span: float
    ) -> "SeparationConstraints":
        """Enlarge the distance of the same pairs within a span of pieces of other constraints."""
        same = (self.pair[:, None] == where.pair).all(axis=-1)
        near = same & (np.abs(self.time[:, None] - where.time) <= span)
        added = np.where(near, by, 0.0).max(axis=1, initial=0.0)
        return self._replace(min_distance=self.min_distance + added)


Count = Annotated[int, Ge(1)]


@checked
@dataclass(frozen=True, eq=False)
class NonlinearProgram:
    """Nonlinear program of all agents, for any solver of `casadi.nlpsol`.

        solver = casadi.nlpsol("central", "ipopt", program.problem)
        x, u = program.trajectories(solver(**program.arguments)["x"])

    The cost f is the fuel in units of U Δt, or the energy in units of U² Δt.

    Args:
        problem: Expressions "x", "f" and "g".
        arguments: Initial guess and bounds: "x0", "lbx", "ubx", "lbg", "ubg".
        shape: Agents, steps and axes.
        state_units: Units of the states in the program [m, m/s].
        control_unit: Unit of the controls in the program [m/s²].
    """

    problem: dict[str, Any]
    arguments: dict[str, Array]
    shape: tuple[Count, Count, Count]
    state_units: Annotated[Float[Array, " n"], Gt(0)]
    control_unit: Annotated[float, Gt(0)]

    def __post_init__(self) -> None:
        """Check that there is a unit for each entry of a state."""
        if len(self.state_units) != 2 * self.shape[2]:
            raise InputError("state_units", f"must be {2 * self.shape[2]}, as a state has entries")

    def trajectories(self, x: Any) -> InitialGuess:
        """Return states and controls of all agents, from a value of "x".

        Raises:
            InputError: The value is no finite array, or has too few entries.
        """
        N, T, m = self.shape
        states = N * (T + 1) * 2 * m
        try:
            z = np.array(x).ravel() if is_symbolic(x) else read_array(x).astype(float).ravel()
            check_finite(z)
        except InputError as error:
            raise error.inside("x") from error
        if len(z) < states + 2 * N * T * m:
            raise InputError("x", f"must have {states + 2 * N * T * m} entries, got {len(z)}")
        plus, minus = z[states : states + 2 * N * T * m].reshape(2, N, T, m)
        x = z[:states].reshape(N, T + 1, 2 * m) * self.state_units
        return x, self.control_unit * (plus - minus)


@dataclass(frozen=True, eq=False)
class SwarmProgram:
    """Joint transfers of all agents that keep their distance at given instants.

    Multiple shooting: states and controls are variables, and the dynamics are equations of each
    step. Positions are in units of R, velocities of R/Δt, controls of U, the largest limit.
    """

    transfer: TransferProblem
    horizon: AvoidanceHorizon
    own_transfers: tuple[TransferProblem, ...] = ()  # of each agent, where limits differ
    clearances: Float[Array, " agents"] | None = None  # of each agent, where they differ [m]

    @cached_property
    def state_units(self) -> Float[Array, " n"]:
        """Scale of each state: R for positions, R/Δt for velocities."""
        R = self.horizon.clearance
        return np.repeat([R, R / self.transfer.model.dt], self.transfer.model.axes)

    @cached_property
    def control_unit(self) -> float:
        """Largest limit of a control, U."""
        return max(own.control_limit.most for own in self.own_transfers or (self.transfer,))

    def transfer_of(self, agent: int) -> TransferProblem:
        """Return the transfer of an agent."""
        return self.own_transfers[agent] if self.own_transfers else self.transfer

    def pair_clearances(self, pairs: Int[Array, "pairs 2"]) -> Float[Array, " pairs"]:
        """Compute the distances that pairs keep: the means of both [m]."""
        if self.clearances is None:
            return np.full(len(pairs), self.horizon.clearance)
        return np.asarray(self.clearances[pairs].mean(axis=1))

    def solve(
        self, ends: Ends, guess: InitialGuess, instants: SeparationConstraints, nearby: bool = False
    ) -> tuple[Array, Array, str]:
        """Solve the program with IPOPT from an initial guess; the status is not verified."""
        import casadi

        program = self.build(ends, guess, instants, nearby)
        options = WARM_START_OPTIONS if nearby else IPOPT_OPTIONS
        settings: dict[str, Any] = {"ipopt": options, "print_time": False}
        solver = casadi.nlpsol("central", "ipopt", program.problem, settings)
        found, stats = solver(**program.arguments), solver.stats()
        message = f"IPOPT reports {stats['return_status']} after {stats['iter_count']} iterations"
        return *program.trajectories(found["x"]), message

    def build(
        self, ends: Ends, guess: InitialGuess, instants: SeparationConstraints, nearby: bool = False
    ) -> NonlinearProgram:
        """Build the program for `casadi.nlpsol`; a guess that is nearby is nearly feasible."""
        import casadi

        transfer, unit = self.transfer, self.state_units
        U = self.control_unit
        x0, u0 = guess[0] / unit, guess[1] / U
        N, T, m = u0.shape
        x = casadi.MX.sym("x", (T + 1) * 2 * m, N)
        plus, minus = (casadi.MX.sym(sign, T * m, N) for sign in ("plus", "minus"))
        u, parts = plus - minus, casadi.vertcat(casadi.vec(plus), casadi.vec(minus))
        cost = casadi.sum1(parts) if transfer.objective == "fuel" else casadi.sumsqr(parts)
        largest = casadi.MX.sym("largest", N * T if self._has_largest else 0)
        on_x, on_u, drift = self._motion_equations()
        rows = [(casadi.DM(on_x) @ x + casadi.DM(on_u) @ u, np.tile(drift, N), np.tile(drift, N))]
        rows += self._limit_rows(casadi, x, u)
        if self._has_largest:
            cost, sizes = casadi.sum1(largest), casadi.reshape(plus + minus, m, N * T)
            room = casadi.repmat(largest.T, m, 1) - sizes
            rows.append((room, np.zeros(m * N * T), np.full(m * N * T, inf)))
        # Relative positions as variables make second derivatives diagonal.
        Dx, Du = self._relative_position_maps(N, instants)
        relative0, free = Dx @ x0.ravel() + Du @ u0.ravel(), np.full(Dx.shape[0], inf)
        relative = casadi.MX.sym("relative", m, len(instants.time))
        if len(free):
            difference = casadi.DM(Dx) @ casadi.vec(x) + casadi.DM(Du) @ casadi.vec(u)
            rows.append((difference - casadi.vec(relative), 0 * relative0, 0 * relative0))
            scale = self.pair_clearances(instants.pair) / self.horizon.clearance
            squares = (instants.min_distance * scale) ** 2
            rows.append((casadi.sum1(relative**2), squares, inf * squares))
        bounds = np.stack([np.full(x0.shape, -inf), np.full(x0.shape, inf)])
        bounds[:, :, 0], bounds[:, :, -1] = ends[0] / unit, ends[1] / unit
        parts0 = np.concatenate([np.maximum(u0, 0).ravel(), np.maximum(-u0, 0).ravel()])
        limits = [self.transfer_of(i).control_limit for i in range(N)]
        most = [np.tile(limit.most / U * limit.shares, (T, 1)) for limit in limits]
        largest0 = np.abs(u0).max(axis=2).ravel() if self._has_largest else np.zeros(0)
        proximal = casadi.sumsqr(u - u0.reshape(N, T * m).T) if nearby else 0
        problem = {
            "x": casadi.vertcat(casadi.vec(x), parts, casadi.vec(relative), largest),
            "f": cost + PROXIMAL_WEIGHT * proximal,
            "g": casadi.vertcat(*(casadi.vec(row) for row, _, _ in rows)),
        }
        arguments = {
            "x0": np.concatenate([x0.ravel(), parts0, relative0, largest0]),
            "lbx": np.concatenate([bounds[0].ravel(), 0 * parts0, -free, 0 * largest0]),
            "ubx": np.concatenate(
                [bounds[1].ravel(), np.tile(np.ravel(most), 2), free, 1 + 0 * largest0]
            ),
            "lbg": np.concatenate([lower for _, lower, _ in rows]),
            "ubg": np.concatenate([upper for _, _, upper in rows]),
        }
        return NonlinearProgram(problem, arguments, (N, T, m), unit, U)

    @property
    def _has_largest(self) -> bool:
        # The largest component of each control is a variable where it is what the fuel counts.
        return self.transfer.objective == "fuel" and self.transfer.fuel_norm == "inf"

    def _limit_rows(self, casadi: Any, x: Any, u: Any) -> list[Any]:
        """Build rows, and their bounds, of all limits that are no bounds of single variables."""
        N, (T, _, m) = u.shape[1], self.transfer.model.B.shape
        v = casadi.reshape(x, 2 * m, (T + 1) * N)[m:, :]
        u = casadi.reshape(u, m, T * N)
        groups = [[i] for i in range(N)] if self.own_transfers else [list(range(N))]
        rows: list[Any] = []
        for agents in groups:
            own = self.transfer_of(agents[0])
            inner = [i * (T + 1) + k for i in agents for k in range(1, T)]
            if isfinite(own.speed_limit.most) and T > 1:
                rows.append(_limit_norm(casadi, own.speed_limit, v[:, inner], self.state_units[-1]))
            if own.control_norm != "inf":
                steps = [i * T + k for i in agents for k in range(T)]
                rows.append(_limit_norm(casadi, own.control_limit, u[:, steps], self.control_unit))
        return rows

    def _motion_equations(self) -> tuple[csc_matrix, csc_matrix, Float[Array, " rows"]]:
        """Build E, F and e of E x + F u = e, the scaled dynamics of one agent over all steps."""
        steps, unit = self.transfer.model, self.state_units
        T, n = len(steps), len(unit)
        A, B = steps.A * unit, steps.B * self.control_unit
        before = hstack([stack_diagonally(A / unit[:, None]), csc_matrix((T * n, n))])
        on_x = eye_array(T * n, (T + 1) * n, k=n) - before
        on_u = -stack_diagonally(B / unit[:, None])
        return csc_matrix(on_x), csc_matrix(on_u), (steps.z / unit).ravel()

    def _relative_position_maps(
        self, agents: int, instants: SeparationConstraints
    ) -> tuple[csc_matrix, csc_matrix]:
        """Build Dx and Du of the relative positions Dx x + Du u, in units of R.

        x and u are the scaled states and controls of all agents as columns, agent by agent.
        """
        P, Q, _ = self.horizon.control_point_maps  # r cancels in differences
        T, S, K, R = *P.shape[:2], len(instants.time), self.horizon.clearance
        piece = np.minimum(instants.time.astype(int), T * S - 1)
        t, (step, part) = instants.time - piece, np.divmod(piece, S)
        s = 1 - t
        bernstein = np.stack([s**3, 3 * s**2 * t, 3 * s * t**2, t**3], axis=1)
        found = []
        for maps, scale, instants_each in ((P, self.state_units, T + 1), (Q, self.control_unit, T)):
            block = np.einsum("ki,kidn->kdn", bernstein, maps[step, part]) * scale / R
            both = np.stack([block, -block], axis=1).reshape(-1, *block.shape[1:])
            column = (instants.pair * instants_each + step[:, None]).ravel()
            d, width = block.shape[1:]
            shape = K * d, agents * instants_each * width
            found.append(csc_matrix(bsr_array((both, column, 2 * np.arange(K + 1)), shape)))
        return found[0], found[1]


def _limit_norm(casadi: Any, limit: Limit, v: Any, unit: float) -> tuple[Any, Array, Array]:
    """Return a row of inequalities, and bounds, that keep each column of v, in units, in a set."""
    if limit.faces is None:
        scaled = v if np.ndim(limit.bound) == 0 else v / limit.shares
        most = np.full(v.shape[1], (limit.most / unit) ** 2)
        return casadi.sum1(scaled**2), -inf * most, most
    most = np.full(len(limit.faces) * v.shape[1], limit.most / unit)
    return casadi.DM(limit.faces) @ v, -inf * most, most
