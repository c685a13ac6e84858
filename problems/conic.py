"""Conic programs in one standard form, and verification of what solvers return."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import accumulate, pairwise
from math import isqrt
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from annotated_types import Ge, Gt
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_array, tril, triu

from dynamics.doors import ANY_NUMBER, checked

TOLERANCE = 1e-6  # relative, of residuals and gap; a solution with larger ones is refused
RAY_TOLERANCE = 1e-3  # of a certificate: no feasible point is smaller than 1 / RAY_TOLERANCE
CONVEXITY_TOLERANCE = 1e-9  # of the largest entry of P: rounding of an eigenvalue

ConeType = Literal["linear", "second-order", "semidefinite"]
Status = Literal["solved", "infeasible", "stopped"]
Verified = Literal["solved", "infeasible", "wrong claim", "unproven", "failed"]

AnyNumber = Annotated[float, ANY_NUMBER]  # also NaN, of a solver that fails
AnyPoint = Annotated[Float[Array, " n"], ANY_NUMBER]
AnyDuals = Annotated[Float[Array, " m"], ANY_NUMBER]


@checked
@dataclass(frozen=True, eq=False)
class ConicProgram:
    """Linear or convex quadratic cost over a product of cones.

        minimize ½ xᵀP x + qᵀx  subject to  b − A x ∈ {0}ᶻ × ℝ₊ˡ × Q₁ × … × S₁ × …

    Rows stand in that order. Q are second-order cones, (t, y) with ‖y‖₂ ≤ t. S are positive
    semidefinite matrices, each as its upper triangle, column by column, with off-diagonal entries
    multiplied by √2, so that the norm of the rows is the Frobenius norm of the matrix. Numbers
    are dimensionless here.

    Args:
        q: Linear coefficients of the cost.
        A: Sparse matrix, m × n.
        b: Right-hand side, dimensionless.
        zero: z, number of equations.
        nonnegative: l, number of inequalities.
        soc_sizes: Rows of each second-order cone.
        psd_orders: Orders of the semidefinite matrices.
        P: Upper triangle, n × n; None where the cost is linear.

    Raises:
        ValueError: Shapes do not fit, a number is not finite, or the cost is not convex.
    """

    q: Float[Array, " n"]
    A: csc_array
    b: Float[Array, " m"]
    zero: Annotated[int, Ge(0)]
    nonnegative: Annotated[int, Ge(0)]
    soc_sizes: tuple[Annotated[int, Ge(1)], ...] = ()
    psd_orders: tuple[Annotated[int, Ge(1)], ...] = ()
    P: csc_array | None = None

    def __post_init__(self) -> None:
        """Sort the entries of the matrices, and check the data."""
        object.__setattr__(self, "A", _canonical(self.A))
        if self.P is not None:
            object.__setattr__(self, "P", _canonical(self.P))
        rows = [slice(self.linear), *self.soc_rows, *self.psd_rows][-1].stop
        if self.A.shape != (rows, len(self.q)) or len(self.b) != rows:
            reason = f"the cones have {rows} rows and the cost {len(self.q)} columns"
            raise ValueError(f"{reason}, but A is {self.A.shape} and b has {len(self.b)}")
        curvature = np.zeros(0) if self.P is None else self.P.data
        for name, numbers in (("q", self.q), ("A", self.A.data), ("b", self.b), ("P", curvature)):
            if not np.isfinite(numbers).all():
                raise ValueError(f"{name} must be finite: leave out the row that is not wanted")
        if self.P is not None:
            _check_convex(self.P, len(self.q))

    @property
    def array_sizes(self) -> dict[str, Any]:
        """Sizes of points and of rows."""
        return {"n": len(self.q), "m": len(self.b)}

    @cached_property
    def hessian(self) -> csc_array:
        """P with both triangles; without entries where the cost is linear."""
        if self.P is None:
            return csc_array((len(self.q), len(self.q)))
        return csc_array(self.P + triu(self.P, 1).T)

    def cost(self, x: Float[Array, " n"]) -> float:
        """Compute ½ xᵀP x + qᵀx, a dimensionless number.

        Args:
            x: Point, dimensionless.
        """
        linear = float(self.q @ x)
        return linear if self.P is None else linear + 0.5 * float(x @ (self.hessian @ x))

    @property
    def linear(self) -> int:
        """Number of equations and inequalities, which are the first rows."""
        return self.zero + self.nonnegative

    @cached_property
    def soc_rows(self) -> tuple[slice, ...]:
        """Rows of each second-order cone."""
        return _consecutive_slices(self.linear, self.soc_sizes)

    @cached_property
    def psd_rows(self) -> tuple[slice, ...]:
        """Rows of each semidefinite matrix."""
        sizes = [n * (n + 1) // 2 for n in self.psd_orders]
        return _consecutive_slices(self.linear + sum(self.soc_sizes), sizes)

    def differs_in_b_only(self, other: "ConicProgram") -> bool:
        """Tell whether another program has the same cost, the same A and the same cones."""
        cones = [(p.zero, p.nonnegative, p.soc_sizes, p.psd_orders) for p in (self, other)]
        return (
            cones[0] == cones[1]
            and np.array_equal(self.q, other.q)
            and _are_equal(self.A, other.A)
            and _are_equal(self.P, other.P)
        )

    @property
    def cone_types(self) -> frozenset[ConeType]:
        """Types of cones that a solver of this program must support."""
        found: set[ConeType] = {"linear"}
        if self.soc_sizes:
            found.add("second-order")
        if self.psd_orders:
            found.add("semidefinite")
        return frozenset(found)

    def cone_violation(self, s: Float[Array, " m"], dual: bool = False) -> float:
        """Compute the largest violation of the cones by a point, a dimensionless number.

        Args:
            s: Point, dimensionless.
            dual: True for the dual cones.
        """
        worst = [0.0] if dual else [np.abs(s[: self.zero]).max(initial=0.0)]
        worst.append(0.0 - s[self.zero : self.linear].min(initial=0.0))  # 0.0 − avoids −0
        for rows in self.soc_rows:
            worst.append(np.linalg.norm(s[rows][1:]) - s[rows][0])
        worst += [-np.linalg.eigvalsh(smat(s[rows]))[0] for rows in self.psd_rows]
        return _max_or_nan(worst)

    def violation_cost(self, v: Float[Array, " m"]) -> float:
        """Bound the change of vᵀs, a number, v in one cone and s in the other, s violated by 1.

        Args:
            v: Point of a cone, dimensionless.
        """
        total = float(np.abs(v[: self.linear]).sum())
        total += sum(abs(float(v[rows][0])) for rows in self.soc_rows)
        return total + sum(abs(float(np.trace(smat(v[rows])))) for rows in self.psd_rows)

    def move_into_dual_cone(self, y: Float[Array, " m"]) -> Float[Array, " m"]:
        """Compute a point of the dual cone near another, dimensionless.

        Args:
            y: That one, dimensionless.
        """
        y = y.copy()
        y[self.zero : self.linear] = np.maximum(y[self.zero : self.linear], 0)
        for rows in self.soc_rows:
            y[rows.start] = max(y[rows.start], np.linalg.norm(y[rows][1:]))
        for rows in self.psd_rows:
            values, vectors = np.linalg.eigh(smat(y[rows]))
            y[rows] = svec((vectors * np.maximum(values, 0)) @ vectors.T)
        return y


def _canonical(matrix: csc_array) -> csc_array:
    """Return a matrix with sorted rows in each column and no entry twice, the same if it is so."""
    if matrix.has_canonical_format:
        return matrix
    matrix = matrix.copy()
    matrix.sum_duplicates()  # sorts too
    return matrix


def _are_equal(one: csc_array | None, two: csc_array | None) -> bool:
    if one is None or two is None or one is two:
        return one is two
    parts = ("shape", "indptr", "indices", "data")
    return all(np.array_equal(getattr(one, part), getattr(two, part)) for part in parts)


def _check_convex(P: csc_array, n: int) -> None:
    if P.shape != (n, n) or tril(P, -1).nnz:
        reason = f"P must be an upper triangle, {n} × {n}, got {P.shape}"
        raise ValueError(f"{reason} with {tril(P, -1).nnz} entries below the diagonal")
    diagonal = P.diagonal()
    if np.count_nonzero(P.data) == np.count_nonzero(diagonal):
        least = float(diagonal.min(initial=0.0))
    else:
        least = float(np.linalg.eigvalsh(P.toarray(), UPLO="U")[0])
    if least < -CONVEXITY_TOLERANCE * np.abs(P.data).max(initial=0.0):
        raise ValueError(f"P must be positive semidefinite: its least eigenvalue is {least:.3g}")


def _consecutive_slices(start: int, sizes: Sequence[int]) -> tuple[slice, ...]:
    return tuple(slice(*ends) for ends in pairwise(accumulate(sizes, initial=start)))


def smat(triangle: Float[Array, " k"]) -> Float[Array, "n n"]:
    """Unpack the rows of a `ConicProgram` into a symmetric matrix."""
    n = isqrt(2 * len(triangle))
    matrix = np.zeros((n, n))
    column, row = np.tril_indices(n)
    matrix[row, column] = matrix[column, row] = triangle / np.sqrt(2)
    matrix[np.diag_indices(n)] *= np.sqrt(2)
    return matrix


def svec(matrix: Float[Array, "n n"]) -> Float[Array, " k"]:
    """Pack a symmetric matrix into the rows of a `ConicProgram`."""
    n = len(matrix)
    weight = np.where(np.eye(n, dtype=bool), 1.0, np.sqrt(2))
    return np.asarray((weight * matrix.T)[np.tri(n, dtype=bool)])


def _max_or_nan(numbers: Sequence[float | np.floating]) -> float:
    # The built-in max can lose a NaN, and a wrong solution would be accepted.
    return float(np.max(np.array(numbers)))


@checked
class SolverResult(NamedTuple):
    """Result as a solver reports it, not yet verified."""

    status: Status
    message: str  # the solver's own
    x: Annotated[Float[Array, " n"] | None, ANY_NUMBER] = None  # also where it stopped with one
    y: Annotated[Float[Array, " m"] | None, ANY_NUMBER] = None  # duals, or a ray of infeasibility
    iterations: int | None = None


@checked
class ConicSolution(NamedTuple):
    """Primal and dual point, with residuals recomputed from their numbers."""

    x: AnyPoint
    y: AnyDuals  # duals: P x + q + Aᵀy = 0, y in the dual cone
    primal_residual: AnyNumber  # distance of b − A x from the cone, relative
    dual_residual: AnyNumber  # of P x + q + Aᵀy from zero and y from the dual cone, relative
    gap: AnyNumber  # |xᵀP x + qᵀx + bᵀy|, relative to the cost

    @classmethod
    def evaluate(cls, problem: ConicProgram, x: AnyPoint, y: AnyDuals) -> "ConicSolution":
        """Compute residuals and duality gap of a primal and dual point."""
        q, A, b = problem.q, problem.A, problem.b
        curvature = problem.hessian @ x
        value = float(q @ x) + float(curvature @ x) / 2
        primal = problem.cone_violation(b - A @ x) / (1 + np.abs(b).max(initial=0.0))
        stationary = float(np.abs(curvature + q + A.T @ y).max(initial=0.0))
        dual = _max_or_nan([stationary, problem.cone_violation(y, dual=True)])
        dual = dual / (1 + np.abs(q).max(initial=0.0))
        gap = abs(value + float(curvature @ x) / 2 + float(b @ y)) / (1 + abs(value))
        return cls(x, y, float(primal), float(dual), float(gap))

    @property
    def max_residual(self) -> float:
        """Largest of residuals and gap; NaN where one of them is."""
        return _max_or_nan([self.primal_residual, self.dual_residual, self.gap])


class Unsolved(RuntimeError):
    """No verified solution was found. The problem is kept, so that it can be solved again."""

    def __init__(self, problem: object, reason: str) -> None:
        """Keep the problem and the reason."""
        super().__init__(reason)
        self.problem = problem

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle by the arguments, so that worker processes can raise it."""
        return type(self), (self.problem, *self.args), self.__dict__


class Infeasible(Unsolved):
    """No point satisfies every constraint, with a certificate.

    The ray y is in the dual cone, Aᵀy = 0 and bᵀy = −1: a feasible point x would give
    0 ≤ yᵀ(b − A x) = −1. The remainder of Aᵀy tells how large x would have to be: at
    least 1 / ‖Aᵀy‖₁, in the units of the problem.
    """

    ray: Float[Array, " m"] | None

    def __init__(self, problem: object, reason: str, ray: Float[Array, " m"] | None = None) -> None:
        """Keep the certificate with the problem."""
        super().__init__(problem, reason)
        self.ray = ray


class Verification(NamedTuple):
    """Verdict on a `SolverResult`."""

    kind: Verified
    solution: ConicSolution | None  # where there is a point with duals
    reason: str
    ray: Float[Array, " m"] | None = None  # the verified certificate of infeasibility

    def require(self, problem: ConicProgram) -> ConicSolution:
        """Return the solution of a program; raise `Infeasible`, or `Unsolved` if it is neither."""
        if self.kind == "infeasible":
            raise Infeasible(problem, self.reason, self.ray)
        if self.solution is None or self.kind != "solved":
            raise Unsolved(problem, self.reason)
        return self.solution


@checked
def verify(
    problem: ConicProgram, result: SolverResult, tolerance: Annotated[float, Gt(0)]
) -> Verification:
    """Recompute residuals, gap and certificates of a solver's result.

    The verdict is *solved* for a point with residuals and gap within the tolerance, even where
    the solver stopped early; *infeasible* with a ray that certifies it, see `verify_ray`;
    *wrong claim* where the solver reports "solved" and the residuals are too large; *unproven*
    where it reports "infeasible" without a ray that certifies it; and *failed* otherwise.
    """
    said = f"{result.status} ({result.message})"
    if result.status == "infeasible":
        if result.y is None:
            return Verification("unproven", None, f"{said}, without a certificate")
        ray, objection = verify_ray(problem, result.y)
        if objection:
            return Verification("unproven", None, f"{said}, but {objection}")
        return Verification("infeasible", None, result.message, ray)
    kind: Verified = "wrong claim" if result.status == "solved" else "failed"
    if result.x is None or result.y is None:
        return Verification(kind, None, f"{said}, without a point and its duals")
    found = ConicSolution.evaluate(problem, result.x, result.y)
    if found.max_residual <= tolerance:
        return Verification("solved", found, result.message)
    reason = (
        f"{said}, but the primal residual is {found.primal_residual:.1e}, "
        f"the dual residual {found.dual_residual:.1e} and the gap {found.gap:.1e}, "
        f"above {tolerance:.0e}"
    )
    return Verification(kind, found, reason)


@checked
def verify_ray(problem: ConicProgram, ray: AnyDuals) -> tuple[Float[Array, " m"], str]:
    """Check a certificate of infeasibility, a ray of any length.

    Return the ray in the dual cone, scaled to bᵀy = −1, and an objection, which is empty where the
    ray shows that no feasible x has ‖x‖_∞ < 1 / RAY_TOLERANCE. Problems are stated in units in
    which their points are not that large.
    """
    if not np.isfinite(ray).all():
        return ray, "its ray is no certificate: it is not finite"
    y = problem.move_into_dual_cone(ray)
    against = -float(problem.b @ y)
    if not 0 < against < np.inf:
        return y, "its ray is no certificate: bᵀy ≥ 0"
    y = y / against
    remainder = np.abs(problem.A.T @ y).sum()
    if remainder <= RAY_TOLERANCE:
        return y, ""
    return y, f"its ray leaves {remainder:.1e} of Aᵀy = 0, above {RAY_TOLERANCE:.0e}"


Solver = Callable[[ConicProgram], SolverResult]


def solve(problem: ConicProgram, solver: Solver) -> ConicSolution:
    """Solve, and verify the solution; raise what `Verification.require` does."""
    return verify(problem, solver(problem), TOLERANCE).require(problem)
