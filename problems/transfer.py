"""Optimal transfer of one agent from a state to a state [Morgan2016, Problem 6]."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from functools import cached_property
from math import inf, isfinite
from types import SimpleNamespace
from typing import Annotated, Any, Literal, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np
from annotated_types import Ge, Gt
from jaxtyping import Bool, Float
from numpy import ndarray as Array
from scipy.sparse import csc_array, triu

from dynamics import DiscreteModel
from dynamics.doors import checked
from dynamics.inputs import InputError
from dynamics.model import ControlSamples, StateSamples
from problems.conic import ConicProgram, ConicSolution, Infeasible, Unsolved
from problems.limit import LIMIT_TOLERANCE, Bound, Limit, Norm, vector_norm
from problems.solvers.adapter import ask
from problems.solvers.verified import solve_program

State = Float[Array, " n"]  # position [m] and velocity [m/s]
Objective = Literal["fuel", "energy"]
Solver = Callable[[ConicProgram], ConicSolution]  # raises Infeasible, Unsolved


@runtime_checkable
class Expression(Protocol):
    """Expression of CVXPY, which is imported only where it is needed."""

    shape: tuple[int, ...]

    def is_affine(self) -> bool:
        """Tell whether it is affine."""

    def __getitem__(self, key: Any) -> Any:
        """Take entries."""


Found = TypeVar("Found")

MAX_SLOWDOWNS = 3  # most solvers take one
ARRIVAL_TOLERANCE = 1e-9  # of a closed form, relative to the largest state


@checked
class Trajectory(NamedTuple):
    """States, controls and fuel of one agent.

    Args:
        x: Positions [m] and velocities [m/s].
        u: Accelerations, held over each step [m/s²].
        fuel: Δt Σ ‖u[k]‖ [m/s].
    """

    x: Float[Array, "T+1 n"]
    u: Float[Array, "T m"]
    fuel: float


@checked
@dataclass(frozen=True, eq=False)
class TransferProblem:
    """Transfer of least fuel, or of least energy, from a state to a target.

        minimize    Δt Σ w[k] ‖u[k]‖_q,  or  Δt Σ ‖u[k]‖₂²
        subject to  x[k+1] = A[k] x[k] + B[k] u[k] + z[k]    (10)
                    ‖u[k] / U‖_r ≤ 1                         (12)
                    x[0] = start,  x[T] = target             (14), (18)
                    ‖H x[k] / V‖_s ≤ 1,  k = 1 … T−1         (66)

    H selects the velocity. U and V may have an entry for each axis (`Limit`). The speeds at both
    ends are data and need not keep the limit. The weights are 1 in the paper; with q = 1 the
    optimum is often not unique, and weights that rise slightly select one, see
    `tie_break_weights`.

    Args:
        model: Discrete model, A, B and z of each step.
        max_control: U, a number or an entry an axis [m/s²].
        max_speed: V, a number or an entry an axis [m/s].
        fuel_norm: Norm q of the fuel: 1, 2 or "inf".
        control_norm: Norm r of the control's limit.
        tie_break_rise: Relative rise of the weights, from the ends to the middle.
        objective: Fuel or energy.
        speed_norm: Norm s of the speed's limit.

    Raises:
        ValueError: A limit is not positive, or has not one entry for each axis.
    """

    model: DiscreteModel
    max_control: Annotated[Bound, Gt(0)]
    max_speed: Annotated[Bound, Gt(0)] = inf
    fuel_norm: Norm = 1
    control_norm: Norm = "inf"
    tie_break_rise: Annotated[float, Ge(0)] = 0.0
    objective: Objective = "fuel"
    speed_norm: Norm = 2

    @property
    def array_sizes(self) -> dict[str, Any]:
        """Sizes of the axes of states, controls and steps."""
        return {**self.model.array_sizes, "T": len(self.model), "instants": len(self.model) + 1}

    def __post_init__(self) -> None:
        """Check that a speed limit of each axis is finite."""
        if np.ndim(self.max_speed) and np.isinf(self.max_speed).any():
            raise InputError("max_speed", f"must be finite on each axis, got {self.max_speed}")

    @cached_property
    def control_limit(self) -> Limit:
        """Limit of every control."""
        return Limit(self.max_control, self.control_norm, self.model.axes)

    @cached_property
    def speed_limit(self) -> Limit:
        """Limit of the velocity at every inner instant."""
        return Limit(self.max_speed, self.speed_norm, self.model.axes)

    @cached_property
    def weights(self) -> Float[Array, " T"]:
        """Weights w of the fuel at each step."""
        return tie_break_weights(len(self.model), self.tie_break_rise)

    @cached_property
    def response_matrices(self) -> tuple[Array, Array]:
        """R and L, for programs in which the states are eliminated.

        x[k] = Φ[k] x₀ + ζ[k] + R[k] u with u flattened and in units of each axis's share in
        the limit, and L⁻¹ R[T] has orthonormal rows; L is the identity where the steps are too
        few to reach every state.
        """
        R, n = self.model.respond(self.control_limit.shares), self.model.A.shape[1]
        if np.linalg.matrix_rank(R[-1]) < n:
            return R, np.eye(n)
        return R, np.linalg.qr(R[-1].T)[1].T

    def coast(self, start: Float[Array, "*many n"]) -> Float[Array, "*many instants n"]:
        """Compute the states without control, Φ[k] x₀ + ζ[k], in SI units.

        Args:
            start: Position [m] and velocity [m/s].
        """
        ζ, Φ = self._free_response
        return ζ + np.tensordot(start, Φ, 1)

    @cached_property
    def _free_response(self) -> tuple[Float[Array, "instants n"], Float[Array, "n instants n"]]:
        T, n, m = self.model.B.shape
        ζ = self.model.simulate(np.zeros(n), np.zeros((T, m)))
        return ζ, self.model.simulate(np.eye(n), np.zeros((n, T, m))) - ζ

    def is_too_fast(self, x: StateSamples) -> Bool[Array, "*agents inner"]:
        """Find the instants between the ends at which the speed exceeds its limit.

        Args:
            x: Positions [m] and velocities [m/s].
        """
        return self.speed_limit.is_exceeded(x[..., 1:-1, self.model.axes :])

    def slow_down(self, factor: Annotated[float, Gt(0)]) -> "TransferProblem":
        """Return the problem with another speed limit.

        Args:
            factor: Ratio of the limits.
        """
        return self if factor == 1 else replace(self, max_speed=np.multiply(self.max_speed, factor))

    def speed_excess(self, trajectory: "Trajectory") -> float:
        """Compute the relative excess of the largest speed between the ends over its limit."""
        return self.speed_limit.excess(trajectory.x[1:-1, self.model.axes :])

    @property
    def is_linear(self) -> bool:
        """True where fuel and limits of the controls are linear: q = 1 and r = ∞."""
        return self.has_signed_controls and self.control_norm == "inf"

    @property
    def has_signed_controls(self) -> bool:
        """True where programs have u⁺ and u⁻ as unknowns: for least fuel with q = 1."""
        return self.objective == "fuel" and self.fuel_norm == 1

    def cost(self, trajectory: Trajectory) -> float:
        """Return the fuel [m/s] or the energy [m²/s³] of a trajectory, without the weights."""
        if self.objective == "fuel":
            return trajectory.fuel
        return float(compute_energy(trajectory.u, self.model.dt))

    def solve_without_limits(
        self, start: Float[Array, "*#many n"], targets: Float[Array, "*#many n"]
    ) -> tuple[StateSamples, ControlSamples, Bool[Array, " targets"]]:
        """Compute the trajectories of least energy to some targets, without limits.

        They begin at one state, or each at its own.

        Args:
            start: Position [m] and velocity [m/s].
            targets: Positions [m] and velocities [m/s].

        Returns:
            States and controls, and True where they arrive and happen to keep all limits.
        """
        T, _, m = self.model.B.shape
        u = ((targets - self.coast(start)[..., T, :]) @ self._energy_gains).reshape(-1, T, m)
        x = self.model.simulate(np.broadcast_to(start, targets.shape), u)
        error, scale = np.abs(x[:, -1] - targets).max(axis=1), np.abs(x).max(axis=(1, 2))
        keeps_limits = self.control_limit.measure(u).max(axis=1) <= self.control_limit.most
        keeps_limits &= ~self.is_too_fast(x).any(axis=1) & (error <= ARRIVAL_TOLERANCE * scale)
        return x, u, keeps_limits

    @cached_property
    def _energy_gains(self) -> Float[Array, "n controls"]:
        reach = self.response_matrices[0][-1] / np.tile(self.control_limit.shares, len(self.model))
        return np.asarray(np.linalg.pinv(reach).T)

    def require_steps(self) -> None:
        """Refuse a transfer without a step."""
        if len(self.model) == 0:
            raise ValueError("a transfer needs at least one step")

    def solve(self, start: State, target: State, solver: Solver = solve_program) -> Trajectory:
        """Solve with CVXPY, which is compiled once.

        Args:
            start: Position [m] and velocity [m/s].
            target: Position [m] and velocity [m/s].
            solver: Function of a `ConicProgram`.

        Raises:
            Infeasible: The target is unreachable in this time.
            Unsolved: The solver stopped for any other reason.
            ValueError: There is no step.
        """
        self.require_steps()
        return solve_within_speed(
            lambda factor: self.slow_down(factor)._solve_cvxpy(start, target, solver),
            self.speed_excess,
        )

    def _solve_cvxpy(self, start: Array, target: Array, solver: Solver) -> Trajectory:
        problem, u = self._cvxpy_problem
        parameters = problem.param_dict
        parameters["start"].value, parameters["target"].value = start, target
        solve_cvxpy(self, problem, solver)
        return self.simulate(start, self.control_limit.cut(u.value))

    def simulate(self, start: State, u: Float[Array, "T m"]) -> Trajectory:
        """Simulate the trajectory of given controls.

        Args:
            start: Position [m] and velocity [m/s].
            u: Accelerations, held over each step [m/s²].
        """
        fuel = float(compute_fuel(u, self.model.dt, self.fuel_norm))
        return Trajectory(self.model.simulate(start, u), u, fuel)

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # no caches

    @cached_property
    def _cvxpy_problem(self) -> tuple[Any, Any]:
        import cvxpy as cp

        n = self.model.A.shape[1]
        start, target = cp.Parameter(n, name="start"), cp.Parameter(n, name="target")
        x, u, effort, limits = self.build_cvxpy(start)
        if self.objective == "energy":
            effort = effort / (self.model.dt * self.control_limit.most**2)  # of the order of 1
        return cp.Problem(cp.Minimize(effort), [*limits, x[len(self.model)] == target]), u

    def build_cvxpy(self, start: State | Expression) -> tuple[Any, Any, Any, list[Any]]:
        """Build variables x and u, cost and constraints in CVXPY, all but the arrival.

        Args:
            start: Position [m] and velocity [m/s] at the start, or a parameter of CVXPY.
        """
        import cvxpy as cp

        A, B, z, dt = self.model.A, self.model.B, self.model.z, self.model.dt
        T, n, m = B.shape
        x, u = cp.Variable((T + 1, n)), cp.Variable((T, m))
        if self.objective == "energy":
            u = self.control_limit.most * u  # of the order of 1: their squares are far apart
            effort = dt * cp.sum_squares(u)
        else:
            effort = dt * self.weights @ cp.norm(u, self.fuel_norm, axis=1)
        motion = [x[k + 1] == A[k] @ x[k] + B[k] @ u[k] + z[k] for k in range(T)]
        limits = [x[0] == start, *motion, self.control_limit.to_cvxpy(u)]
        if isfinite(self.speed_limit.most) and T > 1:
            limits.append(self.speed_limit.to_cvxpy(x[1:T, n // 2 :]))
        return x, u, effort, limits


def solve_within_speed(solve: Callable[[float], Found], excess: Callable[[Found], float]) -> Found:
    """Solve again with a lower speed limit where a solution exceeds it.

    Solvers keep a limit within their tolerance only. Most solutions keep this one by rounding;
    where one does not, the limit is lowered by twice as much as it is exceeded by. The first
    that keeps it is returned; the last where that takes more than `MAX_SLOWDOWNS`, or where there
    is none with a lower limit.
    """
    found, factor = solve(1.0), 1.0
    for _ in range(MAX_SLOWDOWNS):
        over = excess(found)
        if over <= LIMIT_TOLERANCE:
            break
        factor *= 1 - 2 * min(over, 0.25)
        try:
            found = solve(factor)
        except Unsolved:  # it can be kept at full speed only
            break
    return found


def compute_fuel(u: ControlSamples, dt: float, norm: Norm) -> Float[Array, "*agents"] | float:
    """Compute Δt Σ ‖u[k]‖, without the weights [m/s]."""
    fuel: Array = dt * vector_norm(u, norm).sum(axis=-1)
    return fuel


def compute_energy(u: ControlSamples, dt: float) -> Float[Array, "*agents"] | float:
    """Compute Δt Σ ‖u[k]‖₂² [m²/s³]."""
    energy: Array = dt * (u**2).sum(axis=(-2, -1))
    return energy


def tie_break_weights(T: int, rise: float) -> Float[Array, " T"]:
    """Make weights of 1 at both ends that rise to 1 + rise in the middle.

    They are concave in time: among controls of equal fuel, those nearest the ends are cheapest,
    so that the path between them is straight and the optimum unique.
    """
    k = np.arange(T)
    bump: Array = 1 - ((2 * k - T + 1) / max(T - 1, 1)) ** 2
    return 1 + rise * bump


def solve_cvxpy(owner: object, problem: Any, solver: Solver = solve_program) -> None:
    """Solve a CVXPY problem in place, and verify its solution as that of any other.

    Args:
        owner: The object that the problem belongs to; errors keep it and name its class.
        problem: A `cvxpy.Problem`.
        solver: Solver of the program that CVXPY makes of it.

    Raises:
        Infeasible: No point satisfies every constraint.
        Unsolved: The solver stopped for any other reason.
    """
    import cvxpy as cp

    data, chain, inverse = problem.get_problem_data(cp.CLARABEL, solver_opts={})
    dims = data["dims"]
    q, A, b = data["c"], csc_array(data["A"]), data["b"]
    P = csc_array(triu(data["P"])) if "P" in data else None
    conic = ConicProgram(q, A, b, dims.zero, dims.nonneg, tuple(dims.soc), P=P)
    name = type(owner).__name__
    try:
        found = ask(solver, conic)
    except Infeasible as error:
        raise Infeasible(owner, f"{name} is infeasible: {error}", error.ray) from error
    except Unsolved as error:
        raise Unsolved(owner, f"{name} is not solved: {error}") from error
    # CVXPY reads these fields of a Clarabel solution.
    value = {"obj_val": conic.cost(found.x), "solve_time": 0.0, "iterations": 0}
    solution = SimpleNamespace(status="Solved", x=found.x, z=found.y, **value)
    problem.unpack_results(solution, chain, inverse)
