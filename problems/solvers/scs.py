"""SCS: operator splitting, all cones [ODonoghue2016]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import csc_array

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import SDP, SolverAdapter

MAX_ITERATIONS = 100_000


class ScsSession:
    """Program that is set up once; each solve starts from the last solution."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Set up the program."""
        import scs

        self._order, self._status = _row_order(problem), scs
        A, b = csc_array(problem.A[self._order]), problem.b[self._order]
        cones: dict[str, Any] = {"z": problem.zero, "l": problem.nonnegative}
        cones |= {"q": list(problem.soc_sizes), "s": list(problem.psd_orders)}
        options: dict[str, Any] = {"max_iters": MAX_ITERATIONS, "verbose": False}
        options |= dict.fromkeys(("eps_abs", "eps_rel", "eps_infeas"), tolerance / 10)
        options["linear_solver"] = "qdldl"  # single-threaded: the same result on every machine
        self._solver: Any = scs.SCS({"A": A, "b": b, "c": problem.q}, cones, **options)

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side, from the last solution."""
        ordered = b[self._order]
        began = perf_counter()
        self._solver.update(b=ordered)
        result = self._solver.solve()
        seconds = perf_counter() - began
        info = result["info"]
        message, code, iterations = info["status"], info["status_val"], info["iter"]
        y = np.empty(len(b))
        y[self._order] = result["y"]
        if code == self._status.INFEASIBLE:
            return SolverResult("infeasible", message, None, y, iterations, seconds)
        if not np.isfinite(result["x"]).all():
            return SolverResult("stopped", message, iterations=iterations, seconds=seconds)
        status: Status = "solved" if code == self._status.SOLVED else "stopped"
        return SolverResult(status, message, np.array(result["x"]), y, iterations, seconds)


def _row_order(problem: ConicProgram) -> Int[Array, " m"]:
    """Compute the row of the program for each row of SCS, which takes lower triangles."""
    order = [np.arange(problem.linear + sum(problem.soc_sizes))]
    for n, rows in zip(problem.psd_orders, problem.psd_rows, strict=True):
        column, row = np.triu_indices(n)  # of a lower triangle, column by column
        order.append(rows.start + row * (row + 1) // 2 + column)
    return np.concatenate(order)


ADAPTERS = (SolverAdapter("scs", SDP, True, ScsSession),)
