"""Clarabel: interior point, all cones [Goulart2024]."""

from time import perf_counter

import clarabel
import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_array

from problems.conic import ConicProgram, ConicSolution
from problems.solvers.adapter import SolverAdapter, SolverResult, Status, to_solution

DEFAULT_TOLERANCE = 1e-8  # what the toolkit asks for, well below what it judges by
# Ends that come with a point. Whether it is an answer is judged by its residuals.
INEXACT_STATUSES = ("AlmostSolved", "InsufficientProgress")


def solve_clarabel(problem: ConicProgram) -> ConicSolution:
    """Solve with Clarabel.

    Raises:
        Infeasible: Clarabel proved that no point satisfies every constraint.
        Unsolved: It stopped for another reason.
    """
    solver = _setup(problem, _settings(DEFAULT_TOLERANCE))
    return to_solution(problem, _run(solver, perf_counter()), "Clarabel")


class ClarabelSession:
    """Solve with Clarabel, over and over with another right-hand side.

    What it needs to begin is kept; an answer does not depend on those before it. One
    thread at a time.
    """

    def __init__(self, first: ConicProgram, tolerance: float = DEFAULT_TOLERANCE) -> None:
        """Keep what all the problems share."""
        settings = _settings(tolerance)
        settings.presolve_enable = False  # it would drop rows, and data could not be updated
        self._first, self._b = first, first.b.copy()
        self._solver = _setup(first, settings)

    def __call__(self, problem: ConicProgram) -> ConicSolution:
        """Solve with the right-hand side of this problem, the rest being that of the first.

        Raises:
            ValueError: The problem differs in more than b.
            Infeasible: Clarabel proved that no point satisfies every constraint.
            Unsolved: It stopped for another reason.
        """
        if problem.A is not self._first.A or problem.q is not self._first.q:
            raise ValueError("only b may differ from the problem that came first")
        return to_solution(problem, self.solve(problem.b), "Clarabel")

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side, and say what comes of it."""
        began = perf_counter()
        if not np.array_equal(b, self._b):
            self._solver.update(b=b)
            self._b = b.copy()
        return _run(self._solver, began)


def _run(solver: clarabel.DefaultSolver, began: float) -> SolverResult:
    solution = solver.solve()
    words, steps = str(solution.status), solution.iterations
    x, z = solution.x, solution.z  # lists, made at every reading
    seconds = perf_counter() - began
    if words in ("PrimalInfeasible", "AlmostPrimalInfeasible"):
        return SolverResult("infeasible", words, None, np.array(z), steps, seconds)
    if words != "Solved" and words not in INEXACT_STATUSES:
        return SolverResult("stopped", words, iterations=steps, seconds=seconds)
    said: Status = "solved" if words == "Solved" else "stopped"
    return SolverResult(said, words, np.array(x), np.array(z), steps, seconds)


def _setup(problem: ConicProgram, settings: clarabel.DefaultSettings) -> clarabel.DefaultSolver:
    n = len(problem.q)
    cones = [clarabel.ZeroConeT(problem.zero), clarabel.NonnegativeConeT(problem.nonnegative)]
    cones += [clarabel.SecondOrderConeT(size) for size in problem.soc_sizes]
    cones += [clarabel.PSDTriangleConeT(order) for order in problem.psd_orders]
    return clarabel.DefaultSolver(
        csc_array((n, n)), problem.q, problem.A, problem.b, cones, settings
    )


def _settings(tolerance: float) -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    # A tenth: its residuals are scaled in another way than ours.
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = tolerance / 10
    settings.max_threads = 1
    return settings


ADAPTERS = (
    SolverAdapter(
        name="clarabel",
        cone_types=frozenset({"linear", "second-order", "semidefinite"}),
        certifies_infeasibility=True,
        module="clarabel",
        pip_packages="clarabel",
        session_factory=ClarabelSession,
    ),
)
