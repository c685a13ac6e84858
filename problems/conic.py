"""The one standard form, and an answer that can judge itself."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_array

TOLERANCE = 1e-6  # relative; a "solved" with larger residuals or gap is not solved
RAY_TOLERANCE = 1e-3  # of a proof: no point smaller than 1 / FAR, in the units of the problem


ConeType = Literal["linear", "second-order", "semidefinite"]


@dataclass(frozen=True, eq=False)
class ConicProgram:
    """A linear cost over cones.

        minimise qᵀx  subject to  b − A x ∈ {0}ᶻ × ℝ₊ˡ × Q₁ × Q₂ × … × S₁ × S₂ × …

    Rows stand in that order. Q are second-order cones, (t, y) with ‖y‖₂ ≤ t. S are positive
    semidefinite matrices, each as its upper triangle, column by column, with √2 before what is
    not on the diagonal, so that lengths are those of the matrices.
    """

    q: Float[Array, " n"]
    A: csc_array  # m rows
    b: Float[Array, " m"]
    zero: int  # z, rows that are equations
    nonnegative: int  # l, rows that are inequalities
    soc_sizes: tuple[int, ...] = ()  # sizes of the second-order cones
    psd_orders: tuple[int, ...] = ()  # orders of the semidefinite matrices

    def __post_init__(self) -> None:
        """Refuse rows that belong to no cone, and numbers that are none."""
        if min(self.zero, self.nonnegative, 0) or min((*self.soc_sizes, *self.psd_orders, 1)) < 1:
            raise ValueError(
                "counts of rows cannot be negative, and every cone has at least one, got "
                f"{self.zero}, {self.nonnegative}, cones {self.soc_sizes}, matrices {self.psd_orders}"
            )
        rows = self.zero + self.nonnegative + sum(self.soc_sizes)
        rows += sum(n * (n + 1) // 2 for n in self.psd_orders)
        if self.A.shape != (rows, len(self.q)) or len(self.b) != rows:
            raise ValueError(
                f"the cones have {rows} rows and the cost {len(self.q)} columns, "
                f"but A is {self.A.shape} and b has {len(self.b)}"
            )
        for name, numbers in (("q", self.q), ("A", self.A.data), ("b", self.b)):
            if not np.isfinite(numbers).all():
                raise ValueError(f"{name} must be finite: leave out the row that is not wanted")

    def cone_violation(self, s: Float[Array, " m"], dual: bool = False) -> float:
        """How far s is from the cone, or from its dual: the largest violation."""
        linear = self.zero + self.nonnegative
        worst = [0.0] if dual else [np.abs(s[: self.zero]).max(initial=0.0)]
        worst.append(0.0 - s[self.zero : linear].min(initial=0.0))  # and never −0
        start = linear
        for size in self.soc_sizes:
            t, y = s[start], s[start + 1 : start + size]
            worst.append(np.linalg.norm(y) - t)
            start += size
        for n in self.psd_orders:
            size = n * (n + 1) // 2
            worst.append(-np.linalg.eigvalsh(smat(s[start : start + size], n))[0])
            start += size
        return _max_or_nan(worst)

    def violation_cost(self, v: Float[Array, " m"]) -> float:
        """What vᵀs can lose, v of one cone and s of the other, where s lies 1 outside it."""
        linear = self.zero + self.nonnegative
        total, start = float(np.abs(v[:linear]).sum()), linear
        for size in self.soc_sizes:
            total += abs(float(v[start]))
            start += size
        for n in self.psd_orders:
            size = n * (n + 1) // 2
            total += abs(float(np.trace(smat(v[start : start + size], n))))
            start += size
        return total

    def move_into_dual_cone(self, y: Float[Array, " m"]) -> Float[Array, " m"]:
        """A point of the dual cone near y."""
        linear = self.zero + self.nonnegative
        y = y.copy()
        y[self.zero : linear] = np.maximum(y[self.zero : linear], 0)
        start = linear
        for size in self.soc_sizes:
            y[start] = max(y[start], np.linalg.norm(y[start + 1 : start + size]))
            start += size
        for n in self.psd_orders:
            size = n * (n + 1) // 2
            values, vectors = np.linalg.eigh(smat(y[start : start + size], n))
            y[start : start + size] = svec((vectors * np.maximum(values, 0)) @ vectors.T)
            start += size
        return y

    @property
    def cone_types(self) -> frozenset["ConeType"]:
        """The cones that a solver has to know."""
        found: set[ConeType] = {"linear"}
        if self.soc_sizes:
            found.add("second-order")
        if self.psd_orders:
            found.add("semidefinite")
        return frozenset(found)


def smat(triangle: Float[Array, " k"], n: int) -> Float[Array, "n n"]:
    """The symmetric matrix of a triangle as it stands in the rows of a `Conic`."""
    found = np.zeros((n, n))
    column, row = np.tril_indices(n)
    found[row, column] = found[column, row] = triangle / np.sqrt(2)
    found[np.diag_indices(n)] *= np.sqrt(2)
    return found


def svec(matrix: Float[Array, "n n"]) -> Float[Array, " k"]:
    """The rows of a `Conic` for a symmetric matrix."""
    n = len(matrix)
    weight = np.where(np.eye(n, dtype=bool), 1.0, np.sqrt(2))
    return np.asarray((weight * matrix.T)[np.tri(n, dtype=bool)])


def _max_or_nan(numbers: Sequence[float | np.floating]) -> float:
    # NaN where one of them is: the built-in max would lose it, and a lie with it.
    return float(np.max(np.array(numbers)))


class ConicSolution(NamedTuple):
    """What a solver says, and what recomputing shows of it."""

    x: Float[Array, " n"]
    y: Float[Array, " m"]  # duals, with q + Aᵀy = 0 and y in the dual cone
    primal_residual: float  # distance of b − A x from the cone, relative
    dual_residual: float  # of q + Aᵀy from zero and of y from the dual cone, relative
    gap: float  # |qᵀx + bᵀy|, relative

    @classmethod
    def evaluate(
        cls, problem: ConicProgram, x: Float[Array, " n"], y: Float[Array, " m"]
    ) -> "ConicSolution":
        """Recompute residuals and gap from the numbers alone."""
        q, A, b = problem.q, problem.A, problem.b
        value = float(q @ x)
        primal = problem.cone_violation(b - A @ x) / (1 + np.abs(b).max(initial=0.0))
        stationary = float(np.abs(q + A.T @ y).max(initial=0.0))
        dual = _max_or_nan([stationary, problem.cone_violation(y, dual=True)]) / (
            1 + np.abs(q).max(initial=0.0)
        )
        gap = abs(value + float(b @ y)) / (1 + abs(value))
        return cls(x, y, float(primal), float(dual), float(gap))

    @property
    def max_residual(self) -> float:
        """The largest of residuals and gap; NaN where one of them is."""
        return _max_or_nan([self.primal_residual, self.dual_residual, self.gap])


class Unsolved(RuntimeError):
    """A solver gave no answer that stands. The problem is kept, so it can be replayed."""

    def __init__(self, problem: object, why: str) -> None:
        """Keep the problem and say how the attempt ended."""
        super().__init__(why)
        self.problem = problem


class Infeasible(Unsolved):
    """No point satisfies every constraint, and here is why.

    The ray y is in the dual cone, Aᵀy = 0 and bᵀy = −1: a point x would give
    0 ≤ yᵀ(b − A x) = −1. What is left of Aᵀy says how large x would have to be, at
    least 1 / ‖Aᵀy‖₁, in the units of the problem.
    """

    ray: Float[Array, " m"] | None

    def __init__(self, problem: object, why: str, ray: Float[Array, " m"] | None = None) -> None:
        """Keep the proof with the problem."""
        super().__init__(problem, why)
        self.ray = ray


Solver = Callable[[ConicProgram], ConicSolution]


def solve(problem: ConicProgram, solver: Solver) -> ConicSolution:
    """Solve, and believe the answer only after recomputing it.

    Raises:
        Infeasible: The solver proved that no point satisfies every constraint.
        Unsolved: It stopped for another reason, or its answer or proof fails the residuals.
    """
    try:
        answer = solver(problem)
    except Infeasible as verdict:
        _verify_infeasible(problem, verdict)
        raise
    if not answer.max_residual <= TOLERANCE:
        raise Unsolved(
            problem,
            f"the solver said solved, but the primal residual is {answer.primal_residual:.1e}, "
            f"the dual residual {answer.dual_residual:.1e} and the gap {answer.gap:.1e}, "
            f"above {TOLERANCE:.0e}",
        )
    return answer


def _verify_infeasible(problem: ConicProgram, verdict: Infeasible) -> None:
    if verdict.ray is None:
        raise Unsolved(problem, f"{verdict}, but no proof came with it") from verdict
    y, doubt = verify_ray(problem, verdict.ray)
    if doubt:
        raise Unsolved(problem, f"{verdict}, but {doubt}") from verdict
    verdict.ray = y


def verify_ray(problem: ConicProgram, ray: Float[Array, " m"]) -> tuple[Float[Array, " m"], str]:
    """A ray that should prove that no point satisfies every constraint, and what is against it.

    Args:
        problem: What it is of.
        ray: As a solver gives it, of any length.

    Returns:
        The ray, moved into the dual cone, with bᵀy = −1, and why it is none; nothing where it is.
        What it proves is that no point smaller than 1 / FAR satisfies every constraint: problems
        are stated in units in which their points are not that large.
    """
    y = problem.move_into_dual_cone(ray)
    against = -float(problem.b @ y)
    if not 0 < against < np.inf:
        return y, "its ray proves nothing: bᵀy ≥ 0"
    y = y / against
    left = np.abs(problem.A.T @ y).sum()
    return (
        y,
        ""
        if left <= RAY_TOLERANCE
        else f"its ray leaves {left:.1e} of Aᵀy = 0, above {RAY_TOLERANCE:.0e}",
    )
