"""QPALM: augmented Lagrangian, quadratic programs over linear cones [Hermans2022]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_matrix

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, lower_bounds, zero_hessian

# With bounds that it takes for infinite, it accepts rays outside the dual cone as certificates
# and reports feasible programs as infeasible; this number it takes for finite.
INFINITY = 1e15
MAX_ITERATIONS = 100_000


class QpalmSession:
    """Program that is set up once."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Set up the program."""
        import qpalm

        self._zero = problem.zero
        data = qpalm.Data(len(problem.q), len(problem.b))
        data.Q, data.q = zero_hessian(problem), problem.q
        data.A, data.bmin = csc_matrix(problem.A), lower_bounds(problem.b, problem.zero, INFINITY)
        data.bmax = problem.b
        settings = qpalm.Settings()
        settings.eps_abs = settings.eps_rel = tolerance / 10
        settings.eps_prim_inf = tolerance / 10
        settings.max_iter = MAX_ITERATIONS
        settings.verbose = 0
        self._solver: Any = qpalm.Solver(data, settings)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        lower = lower_bounds(b, self._zero, INFINITY)
        began = perf_counter()
        self._solver.update_bounds(lower, b)
        self._solver.solve()
        info, solution = self._solver.info, self._solver.solution
        seconds = perf_counter() - began
        if info.status_val == info.PRIMAL_INFEASIBLE:
            ray = np.array(self._solver.prim_inf_certificate)
            return SolverResult("infeasible", info.status, None, ray, info.iter, seconds)
        status: Status = "solved" if info.status_val == info.SOLVED else "stopped"
        x, y = np.array(solution.x), np.array(solution.y)
        return SolverResult(status, info.status, x, y, info.iter, seconds)


ADAPTERS = (SolverAdapter("qpalm", LP, True, QpalmSession),)
