"""Fuel-optimal transfer of one agent from a state to a state [Morgan2016, Problem 6]."""

from dataclasses import dataclass
from functools import cached_property
from math import inf, isfinite
from types import SimpleNamespace
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_array

from dynamics import DiscreteModel
from problems.conic import ConicProgram, Infeasible, Unsolved, solve
from problems.solvers import solve_clarabel

Norm = Literal[1, 2, "inf"]


class Trajectory(NamedTuple):
    """One trajectory and its price."""

    x: Float[Array, "T+1 n"]  # states
    u: Float[Array, "T m"]  # accelerations, held over each step [m/s²]
    fuel: float  # Δt Σ ‖u[k]‖ [m/s]


@dataclass(frozen=True, eq=False)
class TransferProblem:
    """Reach the goal with the least fuel.

        minimise    Δt Σ w[k] ‖u[k]‖_q
        subject to  x[k+1] = A[k] x[k] + B[k] u[k] + z[k]    (10)
                    ‖u[k]‖_r ≤ U                             (12)
                    x[0] = start,  x[T] = goal               (14), (18)
                    ‖H x[k]‖₂ ≤ V,  k = 1 … T−1              (66)

    The speeds at both ends are data and not decisions. The weights are 1 in the paper.
    With q = 1 the optimum is often not unique, and a slight slope in the weights says
    which of the equals is meant (`ends_first`).
    """

    model: DiscreteModel
    max_control: float  # U [m/s²]
    max_speed: float = inf  # V [m/s]
    fuel_norm: Norm = 1  # q
    control_norm: Norm = "inf"  # r
    tie_break_rise: float = 0.0  # by which burns in the middle cost more than burns at the ends

    def __post_init__(self) -> None:
        """Refuse limits that no flight could keep."""
        if not 0 < self.max_control < inf or not self.max_speed > 0:
            raise ValueError(
                "limits must be positive, and that of the control finite, got "
                f"max_control = {self.max_control} and max_speed = {self.max_speed}"
            )

    @cached_property
    def weights(self) -> Float[Array, " T"]:
        """w, the price of a unit of control at each step."""
        return tie_break_weights(len(self.model), self.tie_break_rise)

    @cached_property
    def response_matrices(self) -> tuple[Array, Array]:
        """R and L, for all that eliminates the states.

        x[k] = Φ[k] x₀ + ζ[k] + R[k] u with u flattened, and L⁻¹ R[T] has orthonormal rows;
        L is the identity where the steps are too few to reach every state.
        """
        T, n, m = self.model.B.shape
        R = np.zeros((T + 1, n, T * m))
        for k in range(T):
            R[k + 1] = self.model.A[k] @ R[k]
            R[k + 1, :, k * m : (k + 1) * m] += self.model.B[k]
        if np.linalg.matrix_rank(R[T]) < n:
            return R, np.eye(n)
        return R, np.linalg.qr(R[T].T)[1].T

    def coast(self, start: Float[Array, "*many n"]) -> Float[Array, "*many instants n"]:
        """States without a burn, Φ[k] x₀ + ζ[k]."""
        ζ, Φ = self._free_response
        return ζ + np.tensordot(start, Φ, 1)

    @cached_property
    def _free_response(self) -> tuple[Float[Array, "instants n"], Float[Array, "n instants n"]]:
        T, n, m = self.model.B.shape
        ζ = self.model.simulate(np.zeros(n), np.zeros((T, m)))
        return ζ, self.model.simulate(np.eye(n), np.zeros((n, T, m))) - ζ

    def require_steps(self) -> None:
        """Refuse a question that leaves no step to burn in.

        Raises:
            ValueError: There is none.
        """
        if len(self.model) == 0:
            raise ValueError("there must be at least one step to burn in")

    def solve(self, start: Float[Array, " n"], goal: Float[Array, " n"]) -> Trajectory:
        """Fly from start to goal, by the statement.

        Raises:
            Infeasible: The goal is out of reach in this time.
        """
        self.require_steps()
        problem, u = self._cvxpy_problem
        parameters = problem.param_dict
        parameters["start"].value, parameters["goal"].value = start, goal
        solve_cvxpy(self, problem)
        return self.simulate(start, np.asarray(u.value))

    def simulate(self, start: Float[Array, " n"], u: Float[Array, "T m"]) -> Trajectory:
        """The flight under given controls."""
        fuel = float(compute_fuel(u, self.model.dt, self.fuel_norm))
        return Trajectory(self.model.simulate(start, u), u, fuel)

    @cached_property
    def _cvxpy_problem(self) -> tuple[Any, Any]:
        import cvxpy as cp

        n = self.model.A.shape[1]
        start, goal = cp.Parameter(n, name="start"), cp.Parameter(n, name="goal")
        x, u, effort, limits = self.build_cvxpy(start)
        arrive = x[len(self.model)] == goal
        return cp.Problem(cp.Minimize(effort), [*limits, arrive]), u

    def build_cvxpy(self, start: Any) -> tuple[Any, Any, Any, list[Any]]:
        """Variables, cost and constraints in CVXPY, all but the arrival."""
        import cvxpy as cp

        A, B, z, dt = self.model.A, self.model.B, self.model.z, self.model.dt
        T, n, m = B.shape
        x, u = cp.Variable((T + 1, n)), cp.Variable((T, m))
        effort = dt * self.weights @ cp.norm(u, self.fuel_norm, axis=1)
        motion = [x[k + 1] == A[k] @ x[k] + B[k] @ u[k] + z[k] for k in range(T)]
        limits = [x[0] == start, *motion, cp.norm(u, self.control_norm, axis=1) <= self.max_control]
        if isfinite(self.max_speed) and T > 1:
            limits.append(cp.norm(x[1:T, n // 2 :], 2, axis=1) <= self.max_speed)
        return x, u, effort, limits


def compute_fuel(
    u: Float[Array, "*agents T m"], dt: float, norm: Norm
) -> Float[Array, "*agents"] | float:
    """Δt Σ ‖u[k]‖, without the weights [m/s]."""
    order = np.inf if norm == "inf" else norm
    spent: Array = dt * np.linalg.norm(u, order, axis=-1).sum(axis=-1)
    return spent


def tie_break_weights(T: int, rise: float) -> Float[Array, " T"]:
    """Weights of 1 at both ends that rise to 1 + slope in the middle.

    Concave in time: among burns of equal fuel, those nearest the ends are cheapest, so
    that what lies between them is flown straight, and the optimum is unique.
    """
    k = np.arange(T)
    bump: Array = 1 - ((2 * k - T + 1) / max(T - 1, 1)) ** 2
    return 1 + rise * bump


def solve_cvxpy(question: object, problem: Any) -> None:
    """Solve a CVXPY problem in place, through the same door as every other.

    Raises:
        Infeasible: No point satisfies every constraint.
        Unsolved: The solver stopped for any other reason.
    """
    import cvxpy as cp

    data, chain, inverse = problem.get_problem_data(cp.CLARABEL, solver_opts={})
    rows = data["dims"]
    conic = ConicProgram(
        data["c"], csc_array(data["A"]), data["b"], rows.zero, rows.nonneg, tuple(rows.soc)
    )
    name = type(question).__name__
    try:
        answer = solve(conic, solve_clarabel)
    except Infeasible as verdict:
        raise Infeasible(question, f"{name} is infeasible: {verdict}", verdict.ray) from verdict
    except Unsolved as verdict:
        raise Unsolved(question, f"{name} is not solved: {verdict}") from verdict
    # CVXPY reads the answer as if it had asked for it.
    said = SimpleNamespace(
        status="Solved",
        x=answer.x,
        z=answer.y,
        obj_val=float(conic.q @ answer.x),
        solve_time=0.0,
        iterations=0,
    )
    problem.unpack_results(said, chain, inverse)
