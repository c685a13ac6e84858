"""ProxQP: augmented Lagrangian, quadratic programs over linear cones [Bambade2022]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, split_equalities, zero_hessian

# At its default of 1e-4, and even at 1e-9, it reports feasible programs as infeasible.
INFEASIBILITY_TOLERANCE = 1e-12
MAX_ITERATIONS = 100  # of the outer loop; feasible programs take ten


class ProxqpSession:
    """Program that is set up once. Infeasible programs get no certificate."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Set up the program."""
        from proxsuite import proxqp

        self._zero, self._output = problem.zero, proxqp.QPSolverOutput
        A, C = split_equalities(problem)
        self._solver: Any = proxqp.sparse.QP(len(problem.q), A.shape[0], C.shape[0])
        settings = self._solver.settings
        settings.eps_abs = settings.eps_rel = tolerance / 10
        settings.check_duality_gap = True
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = tolerance / 10
        settings.eps_primal_inf = settings.eps_dual_inf = INFEASIBILITY_TOLERANCE
        settings.max_iter = MAX_ITERATIONS
        settings.initial_guess = proxqp.InitialGuess.NO_INITIAL_GUESS
        lower = np.full(C.shape[0], -np.inf)
        b, upper = problem.b[: self._zero], problem.b[self._zero :]
        self._solver.init(zero_hessian(problem), problem.q, A, b, C, lower, upper)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        began = perf_counter()
        self._solver.update(b=b[: self._zero], u=b[self._zero :])
        self._solver.solve()
        result = self._solver.results
        status, iterations = result.info.status, result.info.iter
        point, equal, other = result.x, result.y, result.z
        seconds = perf_counter() - began
        x, y = np.array(point), np.concatenate([equal, other])
        if status == self._output.PROXQP_PRIMAL_INFEASIBLE:
            return SolverResult("infeasible", status.name, None, None, iterations, seconds)
        kind: Status = "solved" if status == self._output.PROXQP_SOLVED else "stopped"
        return SolverResult(kind, status.name, x, y, iterations, seconds)


ADAPTERS = (SolverAdapter("proxqp", LP, False, ProxqpSession, module="proxsuite"),)
