"""ECOS: interior point, second-order cones [Domahidi2013]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import SOCP, SolverAdapter, split_equalities

SOLVED, INFEASIBLE, INACCURATE = 0, 1, 10  # exit flags; INACCURATE is added to the other two


class EcosSession:
    """Program that is set up anew at every solve, which is all that the library offers."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Convert the program."""
        import ecos

        self._solve, self._q, self._zero = ecos.solve, problem.q, problem.zero
        self._equalities, self._inequalities = split_equalities(problem)
        self._cones = {"l": problem.nonnegative, "q": list(problem.soc_sizes)}
        self._tolerances = dict.fromkeys(("feastol", "abstol", "reltol"), tolerance / 10)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        equations: dict[str, Any] = {}
        if self._zero:
            equations = {"A": self._equalities, "b": b[: self._zero]}
        began = perf_counter()
        result = self._solve(
            self._q, self._inequalities, b[self._zero :], self._cones,
            verbose=False, **equations, **self._tolerances,
        )  # fmt: skip
        seconds = perf_counter() - began
        info = result["info"]
        message, flag, iterations = info["infostring"], info["exitFlag"], info["iter"]
        y = np.concatenate([np.zeros(0) if not self._zero else result["y"], result["z"]])
        if flag in (INFEASIBLE, INFEASIBLE + INACCURATE):
            return SolverResult("infeasible", message, None, y, iterations, seconds)
        status: Status = "solved" if flag == SOLVED else "stopped"
        return SolverResult(status, message, np.array(result["x"]), y, iterations, seconds)


ADAPTERS = (SolverAdapter("ecos", SOCP, True, EcosSession),)
