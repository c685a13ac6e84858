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
    n = len(problem.q)
    cones = [clarabel.ZeroConeT(problem.zero), clarabel.NonnegativeConeT(problem.nonnegative)]
    cones += [clarabel.SecondOrderConeT(size) for size in problem.cones]
    solver = clarabel.DefaultSolver(
        csc_array((n, n)), problem.q, problem.A, problem.b, cones, _settings()
    )
    solution = solver.solve()
    status = str(solution.status)
    if status in ("PrimalInfeasible", "AlmostPrimalInfeasible"):
        raise Infeasible(problem, f"Clarabel: {status}", np.array(solution.z))
    if status not in JUDGED:
        raise Unsolved(problem, f"Clarabel stopped: {status}")
    return Answer.of(problem, np.array(solution.x), np.array(solution.z))


def _settings() -> clarabel.DefaultSettings:
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-9
    settings.max_threads = 1
    return settings
