"""Clarabel: interior point, all cones [Goulart2024]."""

import clarabel
import numpy as np
from scipy.sparse import csc_array

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
    return _solve(_setup(problem, _settings(DEFAULT_TOLERANCE)))


class ClarabelSession:
    """Program that is set up once; a result does not depend on the programs solved before."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Set up the program."""
        settings = _settings(tolerance)
        settings.presolve_enable = False  # it would drop rows, and b could not be updated
        self._solver = _setup(problem, settings)

    def solve(self, b: Vector) -> SolverResult:
        """Solve with another right-hand side."""
        self._solver.update(b=b)
        return _solve(self._solver)


def _solve(solver: clarabel.DefaultSolver) -> SolverResult:
    found = solver.solve()
    message = str(found.status)
    status = STATUSES.get(message, "stopped")
    has_point = status == "solved" or message in INEXACT_STATUSES
    x, y = np.array(found.x) if has_point else None, np.array(found.z)
    return make_result(status, message, found.iterations, x, y)


def _setup(problem: ConicProgram, settings: clarabel.DefaultSettings) -> clarabel.DefaultSolver:
    n = len(problem.q)
    cones = [clarabel.ZeroConeT(problem.zero), clarabel.NonnegativeConeT(problem.nonnegative)]
    cones += [clarabel.SecondOrderConeT(size) for size in problem.soc_sizes]
    cones += [clarabel.PSDTriangleConeT(order) for order in problem.psd_orders]
    P = csc_array((n, n)) if problem.P is None else problem.P
    return clarabel.DefaultSolver(P, problem.q, problem.A, problem.b, cones, settings)


def _settings(tolerance: float) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # A tenth, because its residuals are scaled in another way than those of verification.
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance / 10
    settings.max_threads = 1
    return settings


ADAPTERS = (SolverAdapter("clarabel", SDP, True, ClarabelSession),)
