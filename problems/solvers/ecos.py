"""ECOS: interior point, second-order cones [Domahidi2013]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram
from problems.solvers.adapter import SolverAdapter, SolverResult, Status
from problems.solvers.rows import split_equalities

SOLVED, INFEASIBLE, INACCURATE = 0, 1, 10  # exit flags; nearly is added to what holds loosely


class EcosSession:
    """A problem that is set up at every solve, which is all that the library offers."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Keep the problem in the words of the library."""
        import ecos

        self._solve, self._q, self._zero = ecos.solve, problem.q, problem.zero
        self._equal, self._other = split_equalities(problem)
        self._cones = {"l": problem.nonnegative, "q": list(problem.soc_sizes)}
        self._within = dict.fromkeys(("feastol", "abstol", "reltol"), tolerance / 10)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side, anew."""
        equations: dict[str, Any] = {}
        if self._zero:
            equations = {"A": self._equal, "b": b[: self._zero]}
        began = perf_counter()
        result = self._solve(
            self._q, self._other, b[self._zero :], self._cones,
            verbose=False, **equations, **self._within,
        )  # fmt: skip
        seconds = perf_counter() - began
        info = result["info"]
        words, flag, steps = info["infostring"], info["exitFlag"], info["iter"]
        y = np.concatenate([np.zeros(0) if not self._zero else result["y"], result["z"]])
        if flag in (INFEASIBLE, INFEASIBLE + INACCURATE):
            return SolverResult("infeasible", words, None, y, steps, seconds)
        said: Status = "solved" if flag == SOLVED else "stopped"
        return SolverResult(said, words, np.array(result["x"]), y, steps, seconds)


ADAPTERS = (
    SolverAdapter(
        name="ecos",
        cone_types=frozenset({"linear", "second-order"}),
        certifies_infeasibility=True,
        module="ecos",
        pip_packages="ecos",
        session_factory=EcosSession,
    ),
)
