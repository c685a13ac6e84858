"""Clarabel: interior point, all cones [Goulart2024]."""

import clarabel
import numpy as np

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import SDP, SolverAdapter, Vector, make_result

DEFAULT_TOLERANCE = 1e-8  # well below the tolerance of verification
STATUSES: dict[str, Status] = {
    "Solved": "solved",
    "PrimalInfeasible": "infeasible",
    "AlmostPrimalInfeasible": "infeasible",
}
# Clarabel stopped with a point. Its residuals tell whether it is a solution.
INEXACT_STATUSES = ("AlmostSolved", "InsufficientProgress")


def solve_clarabel(problem: ConicProgram) -> SolverResult:
    """Solve one program with Clarabel."""
    return ClarabelSession(problem, DEFAULT_TOLERANCE, presolve=True).solve_first()


class ClarabelSession:
    """Program that is set up once; a result does not depend on the programs solved before."""

    def __init__(self, problem: ConicProgram, tolerance: float, presolve: bool = False) -> None:
        """Set up the program; presolve may drop rows, and b cannot be updated then."""
        settings = clarabel.DefaultSettings()
        settings.verbose, settings.presolve_enable = False, presolve
        # A tenth, because its residuals are scaled in another way than those of verification.
        settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance / 10
        settings.max_threads = 1
        cones = [clarabel.ZeroConeT(problem.zero), clarabel.NonnegativeConeT(problem.nonnegative)]
        cones += [clarabel.SecondOrderConeT(size) for size in problem.soc_sizes]
        cones += [clarabel.PSDTriangleConeT(order) for order in problem.psd_orders]
        P = problem.hessian if problem.P is None else problem.P
        self._solver = clarabel.DefaultSolver(P, problem.q, problem.A, problem.b, cones, settings)

    def solve(self, b: Vector) -> SolverResult:
        """Solve with another right-hand side."""
        self._solver.update(b=b)
        return self.solve_first()

    def solve_first(self) -> SolverResult:
        """Solve the program as it was set up."""
        found = self._solver.solve()
        message = str(found.status)
        status = STATUSES.get(message, "stopped")
        has_point = status == "solved" or message in INEXACT_STATUSES
        x, y = np.array(found.x) if has_point else None, np.array(found.z)
        return make_result(status, message, found.iterations, x, y, y)


ADAPTERS = (SolverAdapter("clarabel", SDP, True, ClarabelSession),)
