"""QOCO: interior point, quadratic programmes over second-order cones [Chari2025]."""

from time import perf_counter
from typing import Any

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.conic import Conic
from problems.solvers.adapter import Adapter, Claim, Said
from problems.solvers.rows import parts


class Once:
    """A problem that is set up once. It does not find out that there is no point."""

    def __init__(self, problem: Conic, tolerance: float) -> None:
        """Read the problem."""
        import qoco

        self._zero = problem.zero
        self._solver: Any = qoco.QOCO()
        equal, other = parts(problem)
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
            nsoc=len(problem.cones),
            q=np.array(problem.cones, dtype=np.int32),
            abstol=tolerance / 10,
            reltol=tolerance / 10,
            verbose=0,
        )

    def solve(self, b: Float[Array, " m"]) -> Claim:
        """Solve with another right-hand side."""
        began = perf_counter()
        self._solver.update_vector_data(b=b[: self._zero], h=b[self._zero :])
        result = self._solver.solve()
        seconds = perf_counter() - began
        said: Said = "solved" if result.status == "QOCO_SOLVED" else "stopped"
        y = np.concatenate([result.y, result.z])
        return Claim(said, result.status, np.array(result.x), y, result.iters, seconds)


ADAPTERS = (
    Adapter(
        name="qoco",
        cones=frozenset({"linear", "second-order"}),
        proves=False,
        module="qoco",
        pip="qoco",
        begin=Once,
    ),
)
