"""OSQP: operator splitting, quadratic programs over linear cones [Stellato2020]."""

from typing import Any

from scipy.sparse import csc_matrix, triu

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, Vector, lower_bounds, make_result

MAX_ITERATIONS = 100_000  # linear programs take thousands
TOLERANCES = ("eps_abs", "eps_rel", "eps_prim_inf", "eps_dual_inf")
STATUSES: dict[str, Status] = {"solved": "solved", "primal infeasible": "infeasible"}


class _OsqpSession:
    """Program that is set up once; each solve starts from the last solution.

    Operator splitting converges slowly on linear programs. The active set that it finds is then
    polished, which makes a few correct digits all of them.
    """

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        import osqp

        self._zero = problem.zero
        self._solver: Any = osqp.OSQP()
        P, A = csc_matrix(triu(problem.hessian)), csc_matrix(problem.A)
        options: dict[str, Any] = {"max_iter": MAX_ITERATIONS, "polishing": True, "verbose": False}
        options |= dict.fromkeys(TOLERANCES, tolerance / 10)
        lower = lower_bounds(problem.b, self._zero)
        self._solver.setup(P, problem.q, A, lower, problem.b, **options)

    def solve(self, b: Vector) -> SolverResult:
        """Solve with another right-hand side, from the last solution."""
        self._solver.update(l=lower_bounds(b, self._zero), u=b)
        found = self._solver.solve(raise_error=False)
        message = found.info.status
        status, ray = STATUSES.get(message, "stopped"), found.prim_inf_cert
        return make_result(status, message, found.info.iter, found.x, found.y, ray)


ADAPTERS = (SolverAdapter("osqp", LP, True, _OsqpSession),)
