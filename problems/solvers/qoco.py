"""QOCO: interior point, quadratic programmes over second-order cones [Chari2025]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import ConicProgram
from problems.solvers.adapter import SolverAdapter, SolverResult, Status
from problems.solvers.rows import split_equalities


class QocoSession:
    """A problem that is set up once. It does not find out that there is no point."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Read the problem."""
        import qoco

        self._zero = problem.zero
        self._solver: Any = qoco.QOCO()
        equal, other = split_equalities(problem)
        self._solver.setup(
            n=len(problem.q),
            m=other.shape[0],
            p=problem.zero,
            P=None,
            c=problem.q,
            A=equal if problem.zero else None,
            b=problem.b[: self._zero],
            G=other if other.shape[0] else None,
            h=problem.b[self._zero :],
            l=problem.nonnegative,
            nsoc=len(problem.soc_sizes),
            q=np.array(problem.soc_sizes, dtype=np.int32),
            abstol=tolerance / 10,
            reltol=tolerance / 10,
            verbose=0,
        )

    def solve(self, b: Float[Array, " m"]) -> SolverResult:
        """Solve with another right-hand side."""
        began = perf_counter()
        self._solver.update_vector_data(b=b[: self._zero], h=b[self._zero :])
        result = self._solver.solve()
        seconds = perf_counter() - began
        said: Status = "solved" if result.status == "QOCO_SOLVED" else "stopped"
        y = np.concatenate([result.y, result.z])
        return SolverResult(said, result.status, np.array(result.x), y, result.iters, seconds)


ADAPTERS = (
    SolverAdapter(
        name="qoco",
        cone_types=frozenset({"linear", "second-order"}),
        certifies_infeasibility=False,
        module="qoco",
        pip_packages="qoco",
        session_factory=QocoSession,
    ),
)
