"""PIQP: interior point with proximal terms, quadratic programs over linear cones [Schwan2023]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, split_equalities, zero_hessian


class PiqpSession:
    """Program that is set up once."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Set up the program."""
        import piqp

        self._zero, self._status = problem.zero, piqp.Status
        self._solver: Any = piqp.SparseSolver()
        settings = self._solver.settings
        settings.eps_abs = settings.eps_rel = tolerance / 10
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = tolerance / 10
        (A, G), b, h = split_equalities(problem), problem.b[: self._zero], problem.b[self._zero :]
        self._solver.setup(zero_hessian(problem), problem.q, A=A, b=b, G=G, h_u=h)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        began = perf_counter()
        self._solver.update(b=b[: self._zero], h_u=b[self._zero :])
        status, result = self._solver.solve(), self._solver.result
        message, iterations = status.name, result.info.iter
        point, equal, other = result.x, result.y, result.z_u
        seconds = perf_counter() - began
        x, y = np.array(point), np.concatenate([equal, other])
        if status == self._status.PIQP_PRIMAL_INFEASIBLE:
            return SolverResult("infeasible", message, None, y, iterations, seconds)
        kind: Status = "solved" if status == self._status.PIQP_SOLVED else "stopped"
        return SolverResult(kind, message, x, y, iterations, seconds)


ADAPTERS = (SolverAdapter("piqp", LP, True, PiqpSession),)
