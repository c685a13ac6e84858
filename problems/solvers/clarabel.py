"""Clarabel: interior point, all cones [Goulart2024]."""

import clarabel
import numpy as np
from scipy.sparse import csc_array

from problems.conic import Answer, Conic, Infeasible, Unsolved

# Ends that come with a point. Whether it is an answer is judged by its residuals.
JUDGED = ("Solved", "AlmostSolved", "InsufficientProgress")


def solve_clarabel(problem: Conic) -> Answer:
    """Solve with Clarabel.

    Raises:
        Infeasible: Clarabel proved that no point satisfies every constraint.
        Unsolved: It stopped for another reason.
    """
    return _run(problem, _solver(problem, _settings()))


class Again:
    """Solve with Clarabel, over and over with another right-hand side.

    What it needs to begin is kept; an answer does not depend on those before it. One
    thread at a time.
    """

    def __init__(self, first: Conic) -> None:
        """Keep what all the problems share."""
        settings = _settings()
        settings.presolve_enable = False  # it would drop rows, and data could not be updated
        self._first = first
        self._solver = _solver(first, settings)

    def __call__(self, problem: Conic) -> Answer:
        """Solve with the right-hand side of this problem, the rest being that of the first.

        Raises:
            ValueError: The problem differs in more than b.
            Infeasible: Clarabel proved that no point satisfies every constraint.
            Unsolved: It stopped for another reason.
        """
        if problem.A is not self._first.A or problem.q is not self._first.q:
            raise ValueError("only b may differ from the problem that came first")
        self._solver.update(b=problem.b)
        return _run(problem, self._solver)


def _run(problem: Conic, solver: clarabel.DefaultSolver) -> Answer:
    solution = solver.solve()
    status = str(solution.status)
    if status in ("PrimalInfeasible", "AlmostPrimalInfeasible"):
        raise Infeasible(problem, f"Clarabel: {status}", np.array(solution.z))
    if status not in JUDGED:
        raise Unsolved(problem, f"Clarabel stopped: {status}")
    return Answer.of(problem, np.array(solution.x), np.array(solution.z))


def _solver(problem: Conic, settings: clarabel.DefaultSettings) -> clarabel.DefaultSolver:
    n = len(problem.q)
    cones = [clarabel.ZeroConeT(problem.zero), clarabel.NonnegativeConeT(problem.nonnegative)]
    cones += [clarabel.SecondOrderConeT(size) for size in problem.cones]
    return clarabel.DefaultSolver(
        csc_array((n, n)), problem.q, problem.A, problem.b, cones, settings
    )


def _settings() -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-9
    settings.max_threads = 1
    return settings
