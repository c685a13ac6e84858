"""OSQP: operator splitting, quadratic programmes over linear cones [Stellato2020]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_matrix

from problems.conic import ConicProgram
from problems.solvers.adapter import SolverAdapter, SolverResult, Status
from problems.solvers.rows import lower_bounds, zero_hessian

MAX_ITERATIONS = 100_000  # at most; linear programmes take thousands


class OsqpSession:
    """A problem that is set up once; each answer is where the next begins.

    Its steps converge slowly on linear programmes. The active set that they find is then polished,
    which turns a few digits into all of them.
    """

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Read the problem."""
        import osqp

        self._zero, self._status = problem.zero, osqp.SolverStatus
        self._solver: Any = osqp.OSQP()
        self._solver.setup(
            P=csc_matrix(zero_hessian(problem)),
            q=problem.q,
            A=csc_matrix(problem.A),
            l=lower_bounds(problem.b, problem.zero),
            u=problem.b,
            eps_abs=tolerance / 10,
            eps_rel=tolerance / 10,
            eps_prim_inf=tolerance / 10,
            eps_dual_inf=tolerance / 10,
            max_iter=MAX_ITERATIONS,
            polishing=True,
            verbose=False,
        )

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side, from the last answer."""
        below = lower_bounds(b, self._zero)
        began = perf_counter()
        self._solver.update(l=below, u=b)
        result = self._solver.solve(raise_error=False)
        words, status, steps = result.info.status, result.info.status_val, result.info.iter
        seconds = perf_counter() - began
        if status == self._status.OSQP_PRIMAL_INFEASIBLE:
            ray = np.array(result.prim_inf_cert)
            return SolverResult("infeasible", words, None, ray, steps, seconds)
        if result.x is None or not np.isfinite(result.x).all():
            return SolverResult("stopped", words, iterations=steps, seconds=seconds)
        said: Status = "solved" if status == self._status.OSQP_SOLVED else "stopped"
        return SolverResult(said, words, np.array(result.x), np.array(result.y), steps, seconds)


ADAPTERS = (
    SolverAdapter(
        name="osqp",
        cone_types=frozenset({"linear"}),
        certifies_infeasibility=True,
        module="osqp",
        pip_packages="osqp",
        session_factory=OsqpSession,
    ),
)
