"""ECOS: interior point, second-order cones [Domahidi2013]."""

from time import perf_counter

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
        tolerances = dict.fromkeys(("feastol", "abstol", "reltol"), tolerance / 10)
        self._options = {"verbose": False, **tolerances}

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        equations = {"A": self._equalities, "b": b[: self._zero]} if self._zero else {}
        began = perf_counter()
        inequalities = self._inequalities, b[self._zero :], self._cones
        result = self._solve(self._q, *inequalities, **equations, **self._options)
        seconds = perf_counter() - began
        info = result["info"]
        message, flag, iterations = info["infostring"], info["exitFlag"], info["iter"]
        y = np.concatenate([np.zeros(0) if not self._zero else result["y"], result["z"]])
        if flag in (INFEASIBLE, INFEASIBLE + INACCURATE):
            return SolverResult("infeasible", message, None, y, iterations, seconds)
        status: Status = "solved" if flag == SOLVED else "stopped"
        return SolverResult(status, message, np.array(result["x"]), y, iterations, seconds)


ADAPTERS = (SolverAdapter("ecos", SOCP, True, EcosSession),)
