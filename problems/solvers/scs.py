"""SCS: operator splitting, all cones [ODonoghue2016]."""

from typing import Any

import numpy as np
from jaxtyping import Int
from numpy import ndarray as Array
from scipy.sparse import csc_array

from problems.conic import ConicProgram, SolverResult, Status
from problems.solvers.adapter import SDP, SolverAdapter, Vector, make_result

MAX_ITERATIONS = 100_000
STATUSES: dict[str, Status] = {"solved": "solved", "infeasible": "infeasible"}


class _ScsSession:
    """Program that is set up once; each solve starts from the last solution."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        import scs

        self._order = _row_order(problem)
        A, b = csc_array(problem.A[self._order]), problem.b[self._order]
        cones: dict[str, Any] = {"z": problem.zero, "l": problem.nonnegative}
        cones |= {"q": list(problem.soc_sizes), "s": list(problem.psd_orders)}
        options: dict[str, Any] = {"max_iters": MAX_ITERATIONS, "verbose": False}
        options |= dict.fromkeys(("eps_abs", "eps_rel", "eps_infeas"), tolerance / 10)
        options["linear_solver"] = "qdldl"  # single-threaded: the same result on every machine
        data = {"A": A, "b": b, "c": problem.q, "P": problem.P}
        self._solver: Any = scs.SCS(data, cones, **options)

    def solve(self, b: Vector) -> SolverResult:
        """Solve with another right-hand side, from the last solution."""
        self._solver.update(b=b[self._order])
        found = self._solver.solve()
        message, iterations = found["info"]["status"], found["info"]["iter"]
        y = np.empty(len(b))
        y[self._order] = found["y"]
        return make_result(STATUSES.get(message, "stopped"), message, iterations, found["x"], y, y)


def _row_order(problem: ConicProgram) -> Int[Array, " m"]:
    """Compute the row of the program for each row of SCS, which takes lower triangles."""
    order = [np.arange(problem.linear + sum(problem.soc_sizes))]
    for n, rows in zip(problem.psd_orders, problem.psd_rows, strict=True):
        column, row = np.triu_indices(n)  # of a lower triangle, column by column
        order.append(rows.start + row * (row + 1) // 2 + column)
    return np.concatenate(order)


ADAPTERS = (SolverAdapter("scs", SDP, True, _ScsSession),)
