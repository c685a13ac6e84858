"""ECOS: interior point, second-order cones [Domahidi2013]."""

import numpy as np

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import SOCP, SolverAdapter, Vector, make_result, split_rows

STATUSES: dict[str, Status] = {
    "Optimal solution found": "solved",
    "Primal infeasible": "infeasible",
    "Close to primal infeasible": "infeasible",
}


class _EcosSession:
    """Program that is set up anew at every solve, which is all that the library offers."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        import ecos

        self._solve, self._q, self._zero = ecos.solve, problem.q, problem.zero
        self._A, self._G, _, _ = split_rows(problem)
        self._cones = {"l": problem.nonnegative, "q": list(problem.soc_sizes)}
        tolerances = dict.fromkeys(("feastol", "abstol", "reltol"), tolerance / 10)
        self._options = {"verbose": False, **tolerances}

    def solve(self, b: Vector) -> SolverResult:
        equations = {"A": self._A, "b": b[: self._zero]} if self._zero else {}
        inequalities = self._G, b[self._zero :], self._cones
        found = self._solve(self._q, *inequalities, **equations, **self._options)
        message, iterations = found["info"]["infostring"], found["info"]["iter"]
        y = np.concatenate([found["y"] if self._zero else np.zeros(0), found["z"]])
        return make_result(STATUSES.get(message, "stopped"), message, iterations, found["x"], y, y)


ADAPTERS = (SolverAdapter("ecos", SOCP, True, _EcosSession, takes_quadratic_cost=False),)
