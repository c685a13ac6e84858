"""PIQP: interior point with proximal terms, quadratic programmes over linear cones [Schwan2023]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_matrix

from problems.conic import ConicProgram
from problems.solvers.adapter import SolverAdapter, SolverResult, Status
from problems.solvers.rows import split_equalities, zero_hessian


class PiqpSession:
    """A problem that is set up once."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Read the problem."""
        import piqp

        self._zero, self._status = problem.zero, piqp.Status
        self._solver: Any = piqp.SparseSolver()
        settings = self._solver.settings
        settings.eps_abs = settings.eps_rel = tolerance / 10
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = tolerance / 10
        equal, other = split_equalities(problem)
        self._solver.setup(
            csc_matrix(zero_hessian(problem)),
            problem.q,
            A=equal,
            b=problem.b[: self._zero],
            G=other,
            h_u=problem.b[self._zero :],
        )

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        began = perf_counter()
        self._solver.update(b=b[: self._zero], h_u=b[self._zero :])
        status, result = self._solver.solve(), self._solver.result
        words, steps = status.name, result.info.iter
        point, equal, other = result.x, result.y, result.z_u
        seconds = perf_counter() - began
        x, y = np.array(point), np.concatenate([equal, other])
        if status == self._status.PIQP_PRIMAL_INFEASIBLE:
            return SolverResult("infeasible", words, None, y, steps, seconds)
        said: Status = "solved" if status == self._status.PIQP_SOLVED else "stopped"
        return SolverResult(said, words, x, y, steps, seconds)


ADAPTERS = (
    SolverAdapter(
        name="piqp",
        cone_types=frozenset({"linear"}),
        certifies_infeasibility=True,
        module="piqp",
        pip_packages="piqp",
        session_factory=PiqpSession,
    ),
)
