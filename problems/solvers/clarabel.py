"""Clarabel: interior point, all cones [Goulart2024]."""

from time import perf_counter

import clarabel
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_array

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import SDP, SolverAdapter

DEFAULT_TOLERANCE = 1e-8  # well below the tolerance of verification
# Clarabel stopped with a point. Its residuals tell whether it is a solution.
INEXACT_STATUSES = ("AlmostSolved", "InsufficientProgress")


def solve_clarabel(problem: ConicProgram) -> SolverResult:
    """Solve one program with Clarabel."""
    return _run(_setup(problem, _settings(DEFAULT_TOLERANCE)), perf_counter())


class ClarabelSession:
    """Clarabel, set up once for programs that differ in b alone.

    A result does not depend on the programs solved before. One thread at a time.
    """

    def __init__(self, first: ConicProgram, tolerance: float = DEFAULT_TOLERANCE) -> None:
        """Set up the first program."""
        settings = _settings(tolerance)
        settings.presolve_enable = False  # it would drop rows, and b could not be updated
        self._first, self._b = first, first.b.copy()
        self._solver = _setup(first, settings)

    def __call__(self, problem: ConicProgram) -> SolverResult:
        """Solve a program that shares q and A with the first.

        Raises:
            ValueError: The program differs in more than b.
        """
        if problem.A is not self._first.A or problem.q is not self._first.q:
            raise ValueError("only b may differ from the problem that came first")
        return self.solve(problem.b)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        began = perf_counter()
        if not np.array_equal(b, self._b):
            self._solver.update(b=b)
            self._b = b.copy()
        return _run(self._solver, began)


def _run(solver: clarabel.DefaultSolver, began: float) -> SolverResult:
    solution = solver.solve()
    message, iterations = str(solution.status), solution.iterations
    x, z = solution.x, solution.z  # lists, made at every access
    seconds = perf_counter() - began
    if message in ("PrimalInfeasible", "AlmostPrimalInfeasible"):
        return SolverResult("infeasible", message, None, np.array(z), iterations, seconds)
    if message != "Solved" and message not in INEXACT_STATUSES:
        return SolverResult("stopped", message, iterations=iterations, seconds=seconds)
    status: Status = "solved" if message == "Solved" else "stopped"
    return SolverResult(status, message, np.array(x), np.array(z), iterations, seconds)


def _setup(problem: ConicProgram, settings: clarabel.DefaultSettings) -> clarabel.DefaultSolver:
    n = len(problem.q)
    cones = [clarabel.ZeroConeT(problem.zero), clarabel.NonnegativeConeT(problem.nonnegative)]
    cones += [clarabel.SecondOrderConeT(size) for size in problem.soc_sizes]
    cones += [clarabel.PSDTriangleConeT(order) for order in problem.psd_orders]
    P, q, A, b = csc_array((n, n)), problem.q, problem.A, problem.b
    return clarabel.DefaultSolver(P, q, A, b, cones, settings)


def _settings(tolerance: float) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # A tenth, because its residuals are scaled in another way than those of verification.
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance / 10
    settings.max_threads = 1
    return settings


ADAPTERS = (SolverAdapter("clarabel", SDP, True, ClarabelSession),)
