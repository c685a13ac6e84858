"""DAQP: dual active set, dense quadratic programs over linear cones [Arnstrom2022]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import LP, SolverAdapter, lower_bounds

INFINITY = 1e30  # number that the library takes for infinite
EQUALITY, INEQUALITY = 5, 0  # sense of a row
MAX_ITERATIONS = 100_000
EXIT_FLAGS = {1: "optimal", 2: "soft optimal", -1: "infeasible", -2: "cycling", -3: "unbounded",
        -4: "iteration limit", -5: "nonconvex", -6: "overdetermined initial set"}  # fmt: skip


class DaqpSession:
    """Program that is set up once. Infeasible programs get no certificate."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Set up the program."""
        import daqp

        self._zero, n = problem.zero, len(problem.q)
        sense = np.full(len(problem.b), INEQUALITY, dtype=np.intc)
        sense[: self._zero] = EQUALITY
        lower = lower_bounds(problem.b, self._zero, INFINITY)
        self._solver: Any = daqp.Model()
        tolerances = dict.fromkeys(("primal_tol", "dual_tol"), tolerance / 10)
        self._solver.settings = {**tolerances, "iter_limit": MAX_ITERATIONS}
        H, A = np.zeros((n, n)), problem.A.toarray()
        self._solver.setup(H, problem.q, A, problem.b, lower, sense)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        lower = lower_bounds(b, self._zero, INFINITY)
        began = perf_counter()
        self._solver.update(bupper=b, blower=lower)
        x, _, flag, info = self._solver.solve()
        seconds = perf_counter() - began
        message, iterations = EXIT_FLAGS.get(flag, f"exit flag {flag}"), info["iterations"]
        if flag == -1:
            return SolverResult("infeasible", message, None, None, iterations, seconds)
        status: Status = "solved" if flag == 1 else "stopped"
        y = np.array(info["lam"])
        return SolverResult(status, message, np.array(x), y, iterations, seconds)


ADAPTERS = (SolverAdapter("daqp", LP, False, DaqpSession),)
