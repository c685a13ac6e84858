"""The toolkit's own dual simplex method, on one program at a time.

`problems.minimum_fuel` solves thousands at once with it. It supports the one form that transfers
have after the states are eliminated.
"""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import eye_array, vstack

from problems.conic import ConicProgram, SolverResult
from problems.dual_simplex import INFEASIBLE, OPTIMAL, choose_basis, solve_batches
from problems.minimum_fuel import MAX_PIVOTS, OrthonormalRows
from problems.solvers.adapter import LP, SolverAdapter, Vector

SUPPORTED_FORM = "takes only [C −C] z = b, 0 ≤ z ≤ 1, independent rows, equal costs > 0 of halves"


def unsupported_reason(problem: ConicProgram) -> str:
    """Give the reason why a program is not supported; empty where it is."""
    (_, n), zero = problem.A.shape, problem.zero
    if n % 2 or not 0 < zero <= n // 2 or problem.nonnegative != 2 * n:
        return SUPPORTED_FORM
    equations, box = problem.A[:zero].toarray(), vstack([eye_array(n), -eye_array(n)])
    C, opposite = np.hsplit(equations, 2)
    plus, minus = np.hsplit(problem.q, 2)
    fits = (
        np.array_equal(opposite, -C)
        and np.array_equal(minus, plus)
        and (plus > 0).all()
        and abs(problem.A[zero:] - box).sum() == 0
        and np.array_equal(problem.b[zero:], np.repeat([1.0, 0.0], n))
        and np.linalg.matrix_rank(C) == zero
    )
    return "" if fits else SUPPORTED_FORM


class _DualSimplexSession:
    """Program whose equations are made orthonormal once."""

    def __init__(self, problem: ConicProgram, tolerance: float) -> None:
        """Set up the program. Solutions are exact, whatever the tolerance."""
        n = len(problem.q)
        self._zero, self._w = problem.zero, problem.q[: n // 2].copy()
        self._bounds = problem.b[self._zero :]
        C = problem.A[: self._zero].toarray()[:, : n // 2]
        self._orthonormal = OrthonormalRows.from_matrix(C)
        self._first_basis = choose_basis(self._orthonormal.rows)

    def solve(self, b: Vector) -> SolverResult:
        """Solve with another right-hand side of the equations."""
        if not np.array_equal(b[self._zero :], self._bounds):
            raise ValueError("only the right-hand side of the equations may change")
        x, λ = np.empty((1, len(self._w))), np.empty((1, self._zero))
        status = np.empty(1, np.int64)
        transformed, _ = self._orthonormal.transform(b[None, : self._zero], 1.0)
        data = self._orthonormal.rows, self._first_basis, self._w, transformed
        solve_batches(*data, np.array([0, 1]), MAX_PIVOTS, x, λ, status)
        if status == OPTIMAL:
            z = np.maximum(np.concatenate([x[0], -x[0]]), 0)
            return SolverResult("solved", "optimal", z, self._duals(λ[0], self._w))
        if status == INFEASIBLE:
            ray = self._duals(λ[0], np.zeros_like(self._w))
            return SolverResult("infeasible", "unreachable", None, ray)
        return SolverResult("stopped", "too many pivots")

    def _duals(self, λ: Float[Array, " r"], w: Float[Array, " N"]) -> Float[Array, " m"]:
        along = self._orthonormal.rows.T @ λ
        over = np.concatenate([along - w, -along - w])
        equations = -np.linalg.solve(self._orthonormal.factor.T, λ)
        return np.concatenate([equations, np.maximum(over, 0), np.maximum(-over, 0)])


_MODULES = "problems", "sato-swarm"
ADAPTERS = (
    SolverAdapter("batched", LP, True, _DualSimplexSession, *_MODULES, unsupported_reason, False),
)
