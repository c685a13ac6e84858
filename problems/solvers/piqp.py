"""PIQP: interior point with proximal terms, quadratic programs over linear cones [Schwan2023]."""

from typing import Any

import numpy as np
from scipy.sparse import csc_matrix

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, Vector, make_result, split_rows

STATUSES: dict[str, Status] = {"PIQP_SOLVED": "solved", "PIQP_PRIMAL_INFEASIBLE": "infeasible"}


class PiqpSession:
    """Program that is set up once."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Set up the program."""
        import piqp

        self._zero, self._solver = problem.zero, piqp.SparseSolver()
        settings: Any = self._solver.settings
        settings.eps_abs = settings.eps_rel = tolerance / 10
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = tolerance / 10
        A, G, b, h = split_rows(problem)
        self._solver.setup(csc_matrix(problem.hessian), problem.q, A=A, b=b, G=G, h_u=h)

    def solve(self, b: Vector) -> SolverResult:
        """Solve with another right-hand side."""
        self._solver.update(b=b[: self._zero], h_u=b[self._zero :])
        message, found = self._solver.solve().name, self._solver.result
        status, y = STATUSES.get(message, "stopped"), np.concatenate([found.y, found.z_u])
        return make_result(status, message, found.info.iter, found.x, y, y)


ADAPTERS = (SolverAdapter("piqp", LP, True, PiqpSession),)
