"""ProxQP: augmented Lagrangian, quadratic programs over linear cones [Bambade2022]."""

from typing import Any

import numpy as np
from scipy.sparse import csc_matrix

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, Vector, make_result, split_rows

# At its default of 1e-4, and even at 1e-9, it reports feasible programs as infeasible.
INFEASIBILITY_TOLERANCE = 1e-12
MAX_ITERATIONS = 100  # of the outer loop; feasible programs take ten
STATUSES: dict[str, Status] = {"PROXQP_SOLVED": "solved", "PROXQP_PRIMAL_INFEASIBLE": "infeasible"}


class _ProxqpSession:
    """Program that is set up once. Infeasible programs get no certificate."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        from proxsuite import proxqp

        A, C, b, upper = split_rows(problem)
        self._zero, n = problem.zero, len(problem.q)
        self._solver: Any = proxqp.sparse.QP(n, len(b), len(upper))
        settings = self._solver.settings
        settings.eps_abs = settings.eps_rel = tolerance / 10
        settings.check_duality_gap = True
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = tolerance / 10
        settings.eps_primal_inf = settings.eps_dual_inf = INFEASIBILITY_TOLERANCE
        settings.max_iter = MAX_ITERATIONS
        settings.initial_guess = proxqp.InitialGuess.NO_INITIAL_GUESS
        lower = np.full(len(upper), -np.inf)
        self._solver.init(csc_matrix(problem.hessian), problem.q, A, b, C, lower, upper)

    def solve(self, b: Vector) -> SolverResult:
        self._solver.update(b=b[: self._zero], u=b[self._zero :])
        self._solver.solve()
        found = self._solver.results
        message: str = found.info.status.name
        status, y = STATUSES.get(message, "stopped"), np.concatenate([found.y, found.z])
        return make_result(status, message, found.info.iter, found.x, y)


ADAPTERS = (SolverAdapter("proxqp", LP, False, _ProxqpSession, module="proxsuite"),)
