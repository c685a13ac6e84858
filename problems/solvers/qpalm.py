"""QPALM: augmented Lagrangian, quadratic programs over linear cones [Hermans2022]."""

from typing import Any

from scipy.sparse import csc_matrix

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, Vector, lower_bounds, make_result

# With bounds that it takes for infinite, it accepts rays outside the dual cone as certificates
# and reports feasible programs as infeasible; this number it takes for finite.
INFINITY = 1e15
MAX_ITERATIONS = 100_000
STATUSES: dict[str, Status] = {"solved": "solved", "primal infeasible": "infeasible"}


class _QpalmSession:
    """Program that is set up once."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        import qpalm

        self._zero, n = problem.zero, len(problem.q)
        data = qpalm.Data(n, len(problem.b))
        data.Q, data.q = csc_matrix(problem.hessian), problem.q
        data.A, data.bmin = csc_matrix(problem.A), lower_bounds(problem.b, problem.zero, INFINITY)
        data.bmax = problem.b
        settings = qpalm.Settings()
        settings.eps_abs = settings.eps_rel = settings.eps_prim_inf = tolerance / 10
        settings.max_iter = MAX_ITERATIONS
        settings.verbose = 0
        self._solver: Any = qpalm.Solver(data, settings)

    def solve(self, b: Vector) -> SolverResult:
        self._solver.update_bounds(lower_bounds(b, self._zero, INFINITY), b)
        self._solver.solve()
        info, point = self._solver.info, self._solver.solution
        status, ray = STATUSES.get(info.status, "stopped"), self._solver.prim_inf_certificate
        return make_result(status, info.status, info.iter, point.x, point.y, ray)


ADAPTERS = (SolverAdapter("qpalm", LP, True, _QpalmSession),)
