"""QOCO: interior point, quadratic programs over second-order cones [Chari2025]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import SOCP, SolverAdapter, split_equalities


class QocoSession:
    """Program that is set up once. Infeasible programs are not detected."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Set up the program."""
        import qoco

        self._zero = problem.zero
        self._solver: Any = qoco.QOCO()
        (A, G), h = split_equalities(problem), problem.b[self._zero :]
        equalities = A if self._zero else None, problem.b[: self._zero]
        inequalities = G if len(h) else None, h
        soc = np.array(problem.soc_sizes, dtype=np.int32)
        sizes, cones = (len(problem.q), len(h), self._zero), (problem.nonnegative, len(soc), soc)
        limits = {"abstol": tolerance / 10, "reltol": tolerance / 10, "verbose": 0}
        self._solver.setup(*sizes, None, problem.q, *equalities, *inequalities, *cones, **limits)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        began = perf_counter()
        self._solver.update_vector_data(b=b[: self._zero], h=b[self._zero :])
        result = self._solver.solve()
        seconds = perf_counter() - began
        status: Status = "solved" if result.status == "QOCO_SOLVED" else "stopped"
        y = np.concatenate([result.y, result.z])
        return SolverResult(status, result.status, np.array(result.x), y, result.iters, seconds)


ADAPTERS = (SolverAdapter("qoco", SOCP, False, QocoSession),)
