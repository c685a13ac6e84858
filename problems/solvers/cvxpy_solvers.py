"""Solvers through CVXPY, the program compiled once [Diamond2016].

The time of these less that of the solvers themselves is the cost of the modeling language.
"""

import warnings
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConeType, ConicProgram, SolverResult, Status, smat, svec
from problems.solvers.adapter import LP, SDP, SOCP, SolverAdapter, Vector, make_result

Options = dict[str, Any]
MODULES = {"highs": "highspy"}  # where the name is another
STATUSES: dict[str, Status] = {
    "optimal": "solved",
    "infeasible": "infeasible",
    "infeasible_inaccurate": "infeasible",
}


class _CvxpySession:
    """CVXPY problem that is compiled at its first solve; b is its parameter."""

    def __init__(
        self, solver: str, tolerances: str, fixed: Options, problem: ConicProgram, tolerance: float
    ) -> None:
        import cvxpy as cp

        self._options = dict.fromkeys(tolerances.split(), tolerance / 10) | fixed
        self._solver, self._failed = solver.upper(), cp.SolverError
        self._x, self._b = cp.Variable(len(problem.q)), cp.Parameter(len(problem.b))
        self._constraints = _constraints(cp, problem, self._b, self._x)
        cost = problem.q @ self._x
        if problem.P is not None:
            cost += cp.quad_form(self._x, cp.psd_wrap(problem.hessian)) / 2
        self._problem = cp.Problem(cp.Minimize(cost), self._constraints)

    def solve(self, b: Vector) -> SolverResult:
        self._b.value = b
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # its warnings repeat its status
            try:
                self._problem.solve(solver=self._solver, **self._options)
            except self._failed as failure:
                return SolverResult("stopped", str(failure))
        message, iterations = self._problem.status, self._problem.solver_stats.num_iters
        duals = [constraint.dual_value for constraint in self._constraints]
        y = None if any(dual is None for dual in duals) else _stack_duals(duals)
        status = STATUSES.get(message, "stopped")
        return make_result(status, message, iterations, self._x.value, y, y)


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
        unpack = np.column_stack([smat(unit).ravel() for unit in np.eye(n * (n + 1) // 2)])
        constraints.append(cp.reshape(unpack @ s, (n, n), order="F") >> 0)
    return constraints


def _stack_duals(duals: list[Any]) -> Float[Array, " m"]:
    parts: list[Array] = []
    for dual in duals:
        if isinstance(dual, list):  # t and y of a second-order cone
            parts += dual
        else:
            parts.append(svec(dual) if np.ndim(dual) == 2 else dual)
    return np.concatenate(parts, axis=None)


HIGHS_TOLERANCES = "primal_feasibility_tolerance dual_feasibility_tolerance"
OSQP_TOLERANCES = "eps_abs eps_rel eps_prim_inf eps_dual_inf"
# Cones, whether rays are passed on, names of the tolerances, and other options.
SOLVERS: dict[str, tuple[frozenset[ConeType], bool, str, Options]] = {
    "clarabel": (SDP, True, "tol_gap_abs tol_gap_rel tol_feas", {"max_threads": 1}),
    "ecos": (SOCP, False, "abstol reltol feastol", {}),
    "highs": (LP, True, HIGHS_TOLERANCES, {"threads": 1}),
    "osqp": (LP, True, OSQP_TOLERANCES, {"max_iter": 100_000, "polishing": True}),
    "piqp": (LP, False, "eps_abs eps_rel", {}),
    "qoco": (SOCP, False, "abstol reltol", {}),
    "scs": (SDP, True, "eps_abs eps_rel eps_infeas", {"max_iters": 100_000}),
}
ADAPTERS = tuple(
    SolverAdapter(
        f"cvxpy-{name}",
        cones,
        passes_ray,
        partial(_CvxpySession, name, tolerances, fixed),
        MODULES.get(name, name),
        f"cvxpy {MODULES.get(name, name)}",
        takes_quadratic_cost=name != "ecos",  # made a cone, whose duals miss the tolerance
    )
    for name, (cones, passes_ray, tolerances, fixed) in SOLVERS.items()
)
