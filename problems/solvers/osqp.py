"""OSQP: operator splitting, quadratic programs over linear cones [Stellato2020]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_matrix

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, lower_bounds, zero_hessian

MAX_ITERATIONS = 100_000  # linear programs take thousands


class OsqpSession:
    """Program that is set up once; each solve starts from the last solution.

    Operator splitting converges slowly on linear programs. The active set that it finds is then
    polished, which makes a few correct digits all of them.
    """

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Set up the program."""
        import osqp

        self._zero, self._status = problem.zero, osqp.SolverStatus
        self._solver: Any = osqp.OSQP()
        P, A, lower = (
            zero_hessian(problem),
            csc_matrix(problem.A),
            lower_bounds(problem.b, self._zero),
        )
        names = "eps_abs", "eps_rel", "eps_prim_inf", "eps_dual_inf"
        options: dict[str, Any] = {"max_iter": MAX_ITERATIONS, "polishing": True, "verbose": False}
        options |= dict.fromkeys(names, tolerance / 10)
        self._solver.setup(P, problem.q, A, lower, problem.b, **options)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side, from the last solution."""
        lower = lower_bounds(b, self._zero)
        began = perf_counter()
        self._solver.update(l=lower, u=b)
        result = self._solver.solve(raise_error=False)
        message, code, iterations = result.info.status, result.info.status_val, result.info.iter
        seconds = perf_counter() - began
        if code == self._status.OSQP_PRIMAL_INFEASIBLE:
            ray = np.array(result.prim_inf_cert)
            return SolverResult("infeasible", message, None, ray, iterations, seconds)
        if result.x is None or not np.isfinite(result.x).all():
            return SolverResult("stopped", message, iterations=iterations, seconds=seconds)
        status: Status = "solved" if code == self._status.OSQP_SOLVED else "stopped"
        x, y = np.array(result.x), np.array(result.y)
        return SolverResult(status, message, x, y, iterations, seconds)


ADAPTERS = (SolverAdapter("osqp", LP, True, OsqpSession),)
