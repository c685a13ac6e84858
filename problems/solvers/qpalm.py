"""QPALM: augmented Lagrangian, quadratic programmes over linear cones [Hermans2022]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_matrix

from problems.conic import ConicProgram
from problems.solvers.adapter import SolverAdapter, SolverResult, Status
from problems.solvers.rows import lower_bounds, zero_hessian

# What stands for infinite: with a bound that it knows to be infinite it takes rays outside the dual
# cone for proofs, and calls what has a solution infeasible.
INFINITY = 1e15
MAX_ITERATIONS = 100_000  # at most


class QpalmSession:
    """A problem that is set up once."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Read the problem."""
        import qpalm

        self._zero = problem.zero
        data = qpalm.Data(len(problem.q), len(problem.b))
        data.Q, data.q = csc_matrix(zero_hessian(problem)), problem.q
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
        below = lower_bounds(b, self._zero, INFINITY)
        began = perf_counter()
        self._solver.update_bounds(below, b)
        self._solver.solve()
        info, solution = self._solver.info, self._solver.solution
        seconds = perf_counter() - began
        if info.status_val == info.PRIMAL_INFEASIBLE:
            ray = np.array(self._solver.prim_inf_certificate)
            return SolverResult("infeasible", info.status, None, ray, info.iter, seconds)
        said: Status = "solved" if info.status_val == info.SOLVED else "stopped"
        x, y = np.array(solution.x), np.array(solution.y)
        return SolverResult(said, info.status, x, y, info.iter, seconds)


ADAPTERS = (
    SolverAdapter(
        name="qpalm",
        cone_types=frozenset({"linear"}),
        certifies_infeasibility=True,
        module="qpalm",
        pip_packages="qpalm",
        session_factory=QpalmSession,
    ),
)
