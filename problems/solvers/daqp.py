"""DAQP: dual active set, dense quadratic programmes over linear cones [Arnstrom2022]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram
from problems.solvers.adapter import SolverAdapter, SolverResult
from problems.solvers.rows import lower_bounds

INFINITY = 1e30  # what it takes for infinite
EQUALITY, INEQUALITY = 5, 0  # the sense of a row
MAX_ITERATIONS = 100_000  # at most
EXIT_FLAGS = {1: "optimal", 2: "soft optimal", -1: "infeasible", -2: "cycling", -3: "unbounded",
        -4: "iteration limit", -5: "nonconvex", -6: "overdetermined initial set"}  # fmt: skip


class DaqpSession:
    """A problem that is set up once. Where there is no point it keeps no proof."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Read the problem."""
        import daqp

        self._zero, n = problem.zero, len(problem.q)
        sense = np.full(len(problem.b), INEQUALITY, dtype=np.intc)
        sense[: self._zero] = EQUALITY
        self._solver: Any = daqp.Model()
        self._solver.settings = {
            "primal_tol": tolerance / 10,
            "dual_tol": tolerance / 10,
            "iter_limit": MAX_ITERATIONS,
        }
        self._solver.setup(
            np.zeros((n, n)),
            problem.q,
            problem.A.toarray(),
            problem.b,
            lower_bounds(problem.b, self._zero, INFINITY),
            sense,
        )

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        below = lower_bounds(b, self._zero, INFINITY)
        began = perf_counter()
        self._solver.update(bupper=b, blower=below)
        x, _, flag, info = self._solver.solve()
        seconds = perf_counter() - began
        words, steps = EXIT_FLAGS.get(flag, f"exit flag {flag}"), info["iterations"]
        y = np.array(info["lam"])
        if flag == -1:
            return SolverResult("infeasible", words, None, None, steps, seconds)
        return SolverResult(
            "solved" if flag == 1 else "stopped", words, np.array(x), y, steps, seconds
        )


ADAPTERS = (
    SolverAdapter(
        name="daqp",
        cone_types=frozenset({"linear"}),
        certifies_infeasibility=False,
        module="daqp",
        pip_packages="daqp",
        session_factory=DaqpSession,
    ),
)
