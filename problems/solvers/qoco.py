"""QOCO: interior point, quadratic programs over second-order cones [Chari2025]."""

from typing import Any

import numpy as np
from scipy.sparse import csc_matrix

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import SOCP, SolverAdapter, Vector, make_result, split_rows


class _QocoSession:
    """Program that is set up once. Infeasible programs are not detected."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        import qoco

        self._zero = problem.zero
        self._solver: Any = qoco.QOCO()
        A, G, b, h = split_rows(problem)
        equalities, inequalities = (A if len(b) else None, b), (G if len(h) else None, h)
        soc = np.array(problem.soc_sizes, dtype=np.int32)
        sizes, cones = (len(problem.q), len(h), len(b)), (problem.nonnegative, len(soc), soc)
        limits = {"abstol": tolerance / 10, "reltol": tolerance / 10, "verbose": 0}
        P = None if problem.P is None else csc_matrix(problem.P)
        self._solver.setup(*sizes, P, problem.q, *equalities, *inequalities, *cones, **limits)

    def solve(self, b: Vector) -> SolverResult:
        self._solver.update_vector_data(b=b[: self._zero], h=b[self._zero :])
        found = self._solver.solve()
        y = np.concatenate([found.y, found.z])
        status: Status = "solved" if found.status == "QOCO_SOLVED" else "stopped"
        return make_result(status, found.status, found.iters, found.x, y)


ADAPTERS = (SolverAdapter("qoco", SOCP, False, _QocoSession),)
