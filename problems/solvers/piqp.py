"""PIQP: interior point with proximal terms, quadratic programmes over linear cones [Schwan2023]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_matrix

from problems.conic import Conic
from problems.solvers.adapter import Adapter, Claim, Said
from problems.solvers.rows import nothing, parts


class Proximal:
    """A problem that is set up once."""

    def __init__(self, problem: Conic, tolerance: float) -> None:
        """Read the problem."""
        import piqp

        self._zero, self._status = problem.zero, piqp.Status
        self._solver: Any = piqp.SparseSolver()
        settings = self._solver.settings
        settings.eps_abs = settings.eps_rel = tolerance / 10
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = tolerance / 10
        equal, other = parts(problem)
        self._solver.setup(
            csc_matrix(nothing(problem)),
            problem.q,
            A=equal,
            b=problem.b[: self._zero],
            G=other,
            h_u=problem.b[self._zero :],
        )

    def solve(self, b: Float[Array, " m"]) -> Claim:
        """Solve with another right-hand side."""
        began = perf_counter()
        self._solver.update(b=b[: self._zero], h_u=b[self._zero :])
        status, result = self._solver.solve(), self._solver.result
        words, steps = status.name, result.info.iter
        point, equal, other = result.x, result.y, result.z_u
        seconds = perf_counter() - began
        x, y = np.array(point), np.concatenate([equal, other])
        if status == self._status.PIQP_PRIMAL_INFEASIBLE:
            return Claim("infeasible", words, None, y, steps, seconds)
        said: Said = "solved" if status == self._status.PIQP_SOLVED else "stopped"
        return Claim(said, words, x, y, steps, seconds)


ADAPTERS = (
    Adapter(
        name="piqp",
        cones=frozenset({"linear"}),
        proves=True,
        module="piqp",
        pip="piqp",
        begin=Proximal,
    ),
)
