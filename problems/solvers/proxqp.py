"""ProxQP: augmented Lagrangian, quadratic programmes over linear cones [Bambade2022]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_matrix

from problems.conic import ConicProgram
from problems.solvers.adapter import SolverAdapter, SolverResult, Status
from problems.solvers.rows import split_equalities, zero_hessian

# With its own 1e-4, and even with 1e-9, it calls infeasible what has a solution.
INFEASIBILITY_TOLERANCE = 1e-12
MAX_ITERATIONS = 100  # of the outer loop, at most; programmes that have a solution take ten


class ProxqpSession:
    """A problem that is set up once. Where there is no point it keeps no proof."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Read the problem."""
        from proxsuite import proxqp

        self._zero, self._output = problem.zero, proxqp.QPSolverOutput
        equal, other = split_equalities(problem)
        self._solver: Any = proxqp.sparse.QP(len(problem.q), equal.shape[0], other.shape[0])
        settings = self._solver.settings
        settings.eps_abs = settings.eps_rel = tolerance / 10
        settings.check_duality_gap = True
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = tolerance / 10
        settings.eps_primal_inf = settings.eps_dual_inf = INFEASIBILITY_TOLERANCE
        settings.max_iter = MAX_ITERATIONS
        settings.initial_guess = proxqp.InitialGuess.NO_INITIAL_GUESS
        P = csc_matrix(zero_hessian(problem))
        below = np.full(other.shape[0], -np.inf)
        b, h = problem.b[: self._zero], problem.b[self._zero :]
        self._solver.init(P, problem.q, equal, b, other, below, h)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        began = perf_counter()
        self._solver.update(b=b[: self._zero], u=b[self._zero :])
        self._solver.solve()
        result = self._solver.results
        status, steps = result.info.status, result.info.iter
        point, equal, other = result.x, result.y, result.z
        seconds = perf_counter() - began
        x, y = np.array(point), np.concatenate([equal, other])
        if status == self._output.PROXQP_PRIMAL_INFEASIBLE:
            return SolverResult("infeasible", status.name, None, None, steps, seconds)
        said: Status = "solved" if status == self._output.PROXQP_SOLVED else "stopped"
        return SolverResult(said, status.name, x, y, steps, seconds)


ADAPTERS = (
    SolverAdapter(
        name="proxqp",
        cone_types=frozenset({"linear"}),
        certifies_infeasibility=False,
        module="proxsuite",
        pip_packages="proxsuite",
        session_factory=ProxqpSession,
    ),
)
