"""DAQP: dual active set, dense quadratic programmes over linear cones [Arnstrom2022]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import Conic
from problems.solvers.adapter import Adapter, Claim
from problems.solvers.rows import lower

ENDLESS = 1e30  # what it takes for infinite
EQUATION, INEQUALITY = 5, 0  # the sense of a row
ITERATIONS = 100_000  # at most
ENDS = {1: "optimal", 2: "soft optimal", -1: "infeasible", -2: "cycling", -3: "unbounded",
        -4: "iteration limit", -5: "nonconvex", -6: "overdetermined initial set"}  # fmt: skip


class ActiveSet:
    """A problem that is set up once. Where there is no point it keeps no proof."""

    def __init__(self, problem: Conic, tolerance: float) -> None:
        """Read the problem."""
        import daqp

        self._zero, n = problem.zero, len(problem.q)
        sense = np.full(len(problem.b), INEQUALITY, dtype=np.intc)
        sense[: self._zero] = EQUATION
        self._solver: Any = daqp.Model()
        self._solver.settings = {
            "primal_tol": tolerance / 10,
            "dual_tol": tolerance / 10,
            "iter_limit": ITERATIONS,
        }
        self._solver.setup(
            np.zeros((n, n)),
            problem.q,
            problem.A.toarray(),
            problem.b,
            lower(problem.b, self._zero, ENDLESS),
            sense,
        )

    def solve(self, b: Float[Array, " m"]) -> Claim:
        """Solve with another right-hand side."""
        below = lower(b, self._zero, ENDLESS)
        began = perf_counter()
        self._solver.update(bupper=b, blower=below)
        x, _, flag, info = self._solver.solve()
        seconds = perf_counter() - began
        words, steps = ENDS.get(flag, f"exit flag {flag}"), info["iterations"]
        y = np.array(info["lam"])
        if flag == -1:
            return Claim("infeasible", words, None, None, steps, seconds)
        return Claim("solved" if flag == 1 else "stopped", words, np.array(x), y, steps, seconds)


ADAPTERS = (
    Adapter(
        name="daqp",
        cones=frozenset({"linear"}),
        proves=False,
        module="daqp",
        pip="daqp",
        begin=ActiveSet,
    ),
)
