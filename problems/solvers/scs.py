"""SCS: operator splitting, all cones [ODonoghue2016]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import csc_array

from problems.conic import ConicProgram
from problems.solvers.adapter import SolverAdapter, SolverResult, Status

MAX_ITERATIONS = 100_000  # at most


class ScsSession:
    """A problem that is set up once; each answer is where the next begins."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Read the problem."""
        import scs

        self._order, self._status = _row_order(problem), scs
        self._solver: Any = scs.SCS(
            {"A": csc_array(problem.A[self._order]), "b": problem.b[self._order], "c": problem.q},
            {
                "z": problem.zero,
                "l": problem.nonnegative,
                "q": list(problem.soc_sizes),
                "s": list(problem.psd_orders),
            },
            eps_abs=tolerance / 10,
            eps_rel=tolerance / 10,
            eps_infeas=tolerance / 10,
            max_iters=MAX_ITERATIONS,
            verbose=False,
            linear_solver="qdldl",  # of one thread, and the same on every machine
        )

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side, from the last answer."""
        ordered = b[self._order]
        began = perf_counter()
        self._solver.update(b=ordered)
        result = self._solver.solve()
        seconds = perf_counter() - began
        info = result["info"]
        words, status, steps = info["status"], info["status_val"], info["iter"]
        y = np.empty(len(b))
        y[self._order] = result["y"]
        if status == self._status.INFEASIBLE:
            return SolverResult("infeasible", words, None, y, steps, seconds)
        if not np.isfinite(result["x"]).all():
            return SolverResult("stopped", words, iterations=steps, seconds=seconds)
        said: Status = "solved" if status == self._status.SOLVED else "stopped"
        return SolverResult(said, words, np.array(result["x"]), y, steps, seconds)


def _row_order(problem: ConicProgram) -> Int[Array, " m"]:
    """Which of our rows stands where SCS wants one: it reads the lower triangles of matrices."""
    start = problem.zero + problem.nonnegative + sum(problem.soc_sizes)
    rows = [np.arange(start)]
    for n in problem.psd_orders:
        column, row = np.triu_indices(n)  # of a lower triangle, column by column
        rows.append(start + row * (row + 1) // 2 + column)
        start += n * (n + 1) // 2
    return np.concatenate(rows)


ADAPTERS = (
    SolverAdapter(
        name="scs",
        cone_types=frozenset({"linear", "second-order", "semidefinite"}),
        certifies_infeasibility=True,
        module="scs",
        pip_packages="scs",
        session_factory=ScsSession,
    ),
)
