"""DAQP: dual active set, dense quadratic programs over linear cones [Arnstrom2022]."""

from typing import Any

import numpy as np

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, Vector, lower_bounds, make_result

INFINITY = 1e30  # number that the library takes for infinite
EQUALITY, INEQUALITY = 5, 0  # sense of a row
MAX_ITERATIONS = 100_000
STATUSES: dict[int, Status] = {1: "solved", -1: "infeasible"}  # by exit flag


class _DaqpSession:
    """Program that is set up once. Infeasible programs get no certificate."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        import daqp

        self._zero = problem.zero
        sense = np.full(len(problem.b), INEQUALITY, dtype=np.intc)
        sense[: self._zero] = EQUALITY
        lower = lower_bounds(problem.b, self._zero, INFINITY)
        self._solver: Any = daqp.Model()
        tolerances = dict.fromkeys(("primal_tol", "dual_tol"), tolerance / 10)
        self._solver.settings = {**tolerances, "iter_limit": MAX_ITERATIONS}
        H, A = problem.hessian.toarray(), problem.A.toarray()
        own = problem.q.copy(), A, problem.b.copy()  # which it writes to
        self._solver.setup(H, *own, lower, sense)

    def solve(self, b: Vector) -> SolverResult:
        self._solver.update(bupper=b.copy(), blower=lower_bounds(b, self._zero, INFINITY))
        x, _, flag, info = self._solver.solve()
        status = STATUSES.get(flag, "stopped")
        return make_result(status, f"exit flag {flag}", info["iterations"], x, info["lam"])


ADAPTERS = (SolverAdapter("daqp", LP, False, _DaqpSession),)
