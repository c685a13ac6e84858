"""QPALM: augmented Lagrangian, quadratic programmes over linear cones [Hermans2022]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_matrix

from problems.conic import Conic
from problems.solvers.adapter import Adapter, Claim, Said
from problems.solvers.rows import lower, nothing

# What stands for infinite: with a bound that it knows to be infinite it takes rays outside the dual
# cone for proofs, and calls what has a solution infeasible.
ENDLESS = 1e15
ITERATIONS = 100_000  # at most


class Lagrangian:
    """A problem that is set up once."""

    def __init__(self, problem: Conic, tolerance: float) -> None:
        """Read the problem."""
        import qpalm

        self._zero = problem.zero
        data = qpalm.Data(len(problem.q), len(problem.b))
        data.Q, data.q = csc_matrix(nothing(problem)), problem.q
        data.A, data.bmin = csc_matrix(problem.A), lower(problem.b, problem.zero, ENDLESS)
        data.bmax = problem.b
        settings = qpalm.Settings()
        settings.eps_abs = settings.eps_rel = tolerance / 10
        settings.eps_prim_inf = tolerance / 10
        settings.max_iter = ITERATIONS
        settings.verbose = 0
        self._solver: Any = qpalm.Solver(data, settings)

    def solve(self, b: Float[Array, " m"]) -> Claim:
        """Solve with another right-hand side."""
        below = lower(b, self._zero, ENDLESS)
        began = perf_counter()
        self._solver.update_bounds(below, b)
        self._solver.solve()
        info, solution = self._solver.info, self._solver.solution
        seconds = perf_counter() - began
        if info.status_val == info.PRIMAL_INFEASIBLE:
            ray = np.array(self._solver.prim_inf_certificate)
            return Claim("infeasible", info.status, None, ray, info.iter, seconds)
        said: Said = "solved" if info.status_val == info.SOLVED else "stopped"
        x, y = np.array(solution.x), np.array(solution.y)
        return Claim(said, info.status, x, y, info.iter, seconds)


ADAPTERS = (
    Adapter(
        name="qpalm",
        cones=frozenset({"linear"}),
        proves=True,
        module="qpalm",
        pip="qpalm",
        begin=Lagrangian,
    ),
)
