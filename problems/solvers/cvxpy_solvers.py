"""The standard form as a statement in CVXPY, compiled once, for several solvers [Diamond2016].

What it costs to come by way of a modelling language is the time of these less that of the solvers
themselves.
"""

import warnings
from functools import partial
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConeType, ConicProgram, smat, svec
from problems.solvers.adapter import SolverAdapter, SolverResult, Status

LP: tuple[ConeType, ...] = ("linear",)
SOCP: tuple[ConeType, ...] = ("linear", "second-order")
SDP: tuple[ConeType, ...] = ("linear", "second-order", "semidefinite")


class CvxpySolver(NamedTuple):
    """A solver that CVXPY knows."""

    module: str
    cone_types: tuple[ConeType, ...]
    certifies_infeasibility: bool  # whether CVXPY hands on a ray
    tolerance_options: tuple[str, ...]  # options that are a tolerance
    fixed_options: dict[str, object]


CVXPY_SOLVERS = {
    "CLARABEL": CvxpySolver(
        "clarabel", SDP, True, ("tol_gap_abs", "tol_gap_rel", "tol_feas"), {"max_threads": 1}
    ),
    "ECOS": CvxpySolver("ecos", SOCP, False, ("abstol", "reltol", "feastol"), {}),
    "HIGHS": CvxpySolver(
        "highspy",
        LP,
        True,
        ("primal_feasibility_tolerance", "dual_feasibility_tolerance"),
        {"threads": 1},
    ),
    "OSQP": CvxpySolver(
        "osqp",
        LP,
        True,
        ("eps_abs", "eps_rel", "eps_prim_inf", "eps_dual_inf"),
        {"max_iter": 100_000, "polishing": True},
    ),
    "PIQP": CvxpySolver("piqp", LP, False, ("eps_abs", "eps_rel"), {}),
    "QOCO": CvxpySolver("qoco", SOCP, False, ("abstol", "reltol"), {}),
    "SCS": CvxpySolver(
        "scs", SDP, True, ("eps_abs", "eps_rel", "eps_infeas"), {"max_iters": 100_000}
    ),
}


class CvxpySession:
    """A statement that is compiled at its first solve; b is its parameter."""

    def __init__(self, solver: str, problem: ConicProgram, tolerance: float) -> None:
        """State the problem."""
        import cvxpy as cp

        path = CVXPY_SOLVERS[solver]
        self._options = {
            **dict.fromkeys(path.tolerance_options, tolerance / 10),
            **path.fixed_options,
        }
        self._solver, self._failed = solver, cp.SolverError
        self._x, self._b = cp.Variable(len(problem.q)), cp.Parameter(len(problem.b))
        self._limits = _constraints(cp, problem, self._b, self._x)
        self._problem = cp.Problem(cp.Minimize(problem.q @ self._x), self._limits)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # what it warns of is in its status
            began = perf_counter()
            self._b.value = b
            try:
                self._problem.solve(solver=self._solver, **self._options)
            except self._failed as failure:
                return SolverResult("stopped", str(failure), seconds=perf_counter() - began)
        words, steps = self._problem.status, self._problem.solver_stats.num_iters
        x, duals = self._x.value, [limit.dual_value for limit in self._limits]
        seconds = perf_counter() - began
        y = None if any(dual is None for dual in duals) else _stack_duals(duals)
        if words in ("infeasible", "infeasible_inaccurate"):
            return SolverResult("infeasible", words, None, y, steps, seconds)
        said: Status = "solved" if words == "optimal" else "stopped"
        return SolverResult(said, words, None if x is None else np.array(x), y, steps, seconds)


def _constraints(cp: Any, problem: ConicProgram, b: Any, x: Any) -> list[Any]:
    # In the order of the rows: none of a kind of which there is none.
    zero, linear = problem.zero, problem.zero + problem.nonnegative
    limits = []
    if zero:
        limits.append(problem.A[:zero] @ x == b[:zero])
    if linear > zero:
        limits.append(problem.A[zero:linear] @ x <= b[zero:linear])
    start = linear
    for size in problem.soc_sizes:
        s = b[start : start + size] - problem.A[start : start + size] @ x
        limits.append(cp.SOC(s[0], s[1:]))
        start += size
    for n in problem.psd_orders:
        size = n * (n + 1) // 2
        s = b[start : start + size] - problem.A[start : start + size] @ x
        limits.append(cp.reshape(_smat_matrix(n) @ s, (n, n), order="F") >> 0)
        start += size
    return limits


def _smat_matrix(n: int) -> Float[Array, "entries k"]:
    """What makes a matrix, column by column, of its triangle."""
    units = np.eye(n * (n + 1) // 2)
    return np.column_stack([smat(unit, n).ravel() for unit in units])


def _stack_duals(duals: list[Any]) -> Float[Array, " m"]:
    parts: list[Array] = []
    for dual in duals:
        if isinstance(dual, list):  # of a second-order cone: t and y
            parts += dual
        else:
            parts.append(svec(dual) if np.ndim(dual) == 2 else dual)
    return np.concatenate(parts, axis=None)


ADAPTERS = tuple(
    SolverAdapter(
        name=f"cvxpy-{solver.lower()}",
        cone_types=frozenset(path.cone_types),
        certifies_infeasibility=path.certifies_infeasibility,
        module=path.module,
        pip_packages=f"cvxpy {path.module}",
        session_factory=partial(CvxpySession, solver),
    )
    for solver, path in CVXPY_SOLVERS.items()
)
