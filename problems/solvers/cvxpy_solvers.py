"""Solvers through CVXPY, the program compiled once [Diamond2016].

The time of these less that of the solvers themselves is the cost of the modeling language.
"""

import warnings
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConeType, ConicProgram, SolverResult, Status, smat, svec
from problems.solvers.adapter import LP, SDP, SOCP, SolverAdapter


class CvxpySolver(NamedTuple):
    """Solver that CVXPY calls, and its options."""

    module: str
    cone_types: frozenset[ConeType]
    certifies_infeasibility: bool  # True where CVXPY passes the ray on
    tolerance_options: tuple[str, ...]  # set to the tolerance
    fixed_options: dict[str, Any]


CLARABEL_TOLERANCES = "tol_gap_abs", "tol_gap_rel", "tol_feas"
HIGHS_TOLERANCES = "primal_feasibility_tolerance", "dual_feasibility_tolerance"
EPS = "eps_abs", "eps_rel"
OSQP_OPTIONS = {"max_iter": 100_000, "polishing": True}
CVXPY_SOLVERS = {
    "CLARABEL": CvxpySolver("clarabel", SDP, True, CLARABEL_TOLERANCES, {"max_threads": 1}),
    "ECOS": CvxpySolver("ecos", SOCP, False, ("abstol", "reltol", "feastol"), {}),
    "HIGHS": CvxpySolver("highspy", LP, True, HIGHS_TOLERANCES, {"threads": 1}),
    "OSQP": CvxpySolver("osqp", LP, True, (*EPS, "eps_prim_inf", "eps_dual_inf"), OSQP_OPTIONS),
    "PIQP": CvxpySolver("piqp", LP, False, EPS, {}),
    "QOCO": CvxpySolver("qoco", SOCP, False, ("abstol", "reltol"), {}),
    "SCS": CvxpySolver("scs", SDP, True, (*EPS, "eps_infeas"), {"max_iters": 100_000}),
}


class CvxpySession:
    """CVXPY problem that is compiled at its first solve; b is its parameter."""

    def __init__(self, solver: str, problem: ConicProgram, tolerance: float) -> None:
        """Write the program in CVXPY."""
        import cvxpy as cp

        known = CVXPY_SOLVERS[solver]
        tolerances = dict.fromkeys(known.tolerance_options, tolerance / 10)
        self._options = {**tolerances, **known.fixed_options}
        self._solver, self._failed = solver, cp.SolverError
        self._x, self._b = cp.Variable(len(problem.q)), cp.Parameter(len(problem.b))
        self._constraints = _constraints(cp, problem, self._b, self._x)
        self._problem = cp.Problem(cp.Minimize(problem.q @ self._x), self._constraints)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # its warnings repeat its status
            began = perf_counter()
            self._b.value = b
            try:
                self._problem.solve(solver=self._solver, **self._options)
            except self._failed as failure:
                return SolverResult("stopped", str(failure), seconds=perf_counter() - began)
        message, iterations = self._problem.status, self._problem.solver_stats.num_iters
        x, duals = self._x.value, [constraint.dual_value for constraint in self._constraints]
        seconds = perf_counter() - began
        y = None if any(dual is None for dual in duals) else _stack_duals(duals)
        if message in ("infeasible", "infeasible_inaccurate"):
            return SolverResult("infeasible", message, None, y, iterations, seconds)
        status: Status = "solved" if message == "optimal" else "stopped"
        return SolverResult(status, message, x, y, iterations, seconds)


def _constraints(cp: Any, problem: ConicProgram, b: Any, x: Any) -> list[Any]:
    # In the order of the rows, because the duals are stacked in that order.
    zero, linear, A = problem.zero, problem.linear, problem.A
    constraints = []
    if zero:
        constraints.append(A[:zero] @ x == b[:zero])
    if linear > zero:
        constraints.append(A[zero:linear] @ x <= b[zero:linear])
    for rows in problem.soc_rows:
        s = b[rows] - A[rows] @ x
        constraints.append(cp.SOC(s[0], s[1:]))
    for n, rows in zip(problem.psd_orders, problem.psd_rows, strict=True):
        s = b[rows] - A[rows] @ x
        constraints.append(cp.reshape(_smat_matrix(n) @ s, (n, n), order="F") >> 0)
    return constraints


def _smat_matrix(n: int) -> Float[Array, "entries k"]:
    """Make the matrix that maps a triangle to its full matrix, column by column."""
    units = np.eye(n * (n + 1) // 2)
    return np.column_stack([smat(unit).ravel() for unit in units])


def _stack_duals(duals: list[Any]) -> Float[Array, " m"]:
    parts: list[Array] = []
    for dual in duals:
        if isinstance(dual, list):  # t and y of a second-order cone
            parts += dual
        else:
            parts.append(svec(dual) if np.ndim(dual) == 2 else dual)
    return np.concatenate(parts, axis=None)


def _adapter(solver: str, known: CvxpySolver) -> SolverAdapter:
    name, module, factory = f"cvxpy-{solver.lower()}", known.module, partial(CvxpySession, solver)
    abilities = known.cone_types, known.certifies_infeasibility
    return SolverAdapter(name, *abilities, factory, module, f"cvxpy {module}")


ADAPTERS = tuple(_adapter(solver, known) for solver, known in CVXPY_SOLVERS.items())
