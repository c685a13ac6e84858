"""Design problem of formation gains along one axis group: constraints, rate and dual bound."""

from dataclasses import dataclass
from functools import cache, cached_property, partial
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Inexact
from numpy import ndarray as Array
from scipy.linalg import cho_factor, lapack, null_space

from dynamics.doors import ANY_NUMBER, checked
from problems.desired_formation import DesiredFormation

Axes = Literal["xy", "z"]  # horizontal (complex) or vertical (real) gains

MIN_RATE = 1e-6  # of the mean eigenvalue: slower gains, or a bound below it, count as none
ZERO_TOLERANCE = 1e-9  # of the largest possible trace: taken for zero
ROUNDOFF = 1e-14  # relative error of products and eigenvalues
EIGENVALUE_ERROR = 1e-15  # times n, relative: upper limit of the eigenvalue error in a bound
REGULARIZATION = 1e-10  # of the mean diagonal: far above rounding, far below the data
MAX_REFINEMENTS = 6  # iterations; two usually suffice


class NoGainMatrix(RuntimeError):
    """The graph and the kernel admit matrices of trace 0 only.

    Attributes:
        dual: Certificate Y on the non-edges with Qᴴ Y Q = I.
    """

    def __init__(self, dual: Inexact[Array, "n n"]) -> None:
        super().__init__("no matrix with this graph and kernel has a positive trace")
        self.dual = dual


class GainSolution(NamedTuple):
    """Primal and dual matrices of a method; `GainProblem` computes their values.

    Of a projection, L is the nearest feasible matrix but for positivity, and Y what is removed.
    """

    L: Inexact[Array, "n n"]  # the gain is −L
    Y: Inexact[Array, "n n"]  # dual matrix on the non-edges


@checked
@dataclass(frozen=True, eq=False)
class GainProblem:
    """Fastest horizontal or vertical gains of a formation.

        maximize t  subject to  L ⪰ t (I − K Kᴴ),  L K = 0,  tr L = m,  L_ij = 0 at non-edges

    over Hermitian L; the gain is −L and its rate t. The kernel K is complex for the
    horizontal and real for the vertical gains [Lusk2020, eq. 5 and 7]. m = n − r counts the
    eigenvalues outside the kernel, so their mean is 1. With Q the orthogonal complement of
    K and L = Q Z Qᴴ this is the program in Z of the paper.

    The dual is over Hermitian Y that vanish except at the non-edges:

        minimize −l / (μ − l),   l = λ_min(Qᴴ Y Q),   μ = tr(Qᴴ Y Q) / m
    """

    kernel: Inexact[Array, "n r"]  # K, orthonormal columns
    graph: Bool[Array, "n n"]

    @classmethod
    def from_formation(cls, formation: DesiredFormation, axes: Axes) -> "GainProblem":
        """Pose the problem of the horizontal or the vertical gains."""
        return cls(formation.kernel_xy if axes == "xy" else formation.kernel_z, formation.graph)

    @property
    def m(self) -> int:
        """Number of eigenvalues outside the kernel."""
        n, r = self.kernel.shape
        return int(n - r)

    @property
    def is_complete(self) -> bool:
        """True where the graph has every edge."""
        return bool(self._allowed_entries.all())

    @property
    def edge_share(self) -> float:
        """Share of the pairs that are edges."""
        n = len(self.graph)
        return float(np.count_nonzero(self.graph)) / (n * (n - 1))

    @property
    def non_edges(self) -> tuple[Array, Array]:
        """Both vertices of every non-edge, the lower number first."""
        i, j = np.nonzero(np.triu(~self.graph, 1))
        return i, j

    @cached_property
    def complement(self) -> Inexact[Array, "n m"]:
        """Q, orthonormal columns that span the orthogonal complement of the kernel."""
        return np.asarray(null_space(self.kernel.conj().T))

    @property
    def complete_solution(self) -> Inexact[Array, "n n"]:
        """I − K Kᴴ, the L of the complete graph: its eigenvalues outside the kernel are 1."""
        return np.asarray(np.eye(len(self.graph)) - self._kernel_projector)

    def project(self, W: Inexact[Array, "n n"]) -> GainSolution:
        """Find the Hermitian L nearest to W with L K = 0, tr L = m and zeros at the non-edges."""
        kept, dropped = self._project_without_trace((W + W.conj().T) / 2)
        direction, rest = self.trace_direction
        deficit = (self.m - kept.trace().real) / direction.trace().real
        return GainSolution(kept + deficit * direction, dropped + deficit * rest)

    def convergence_rate(self, L: Inexact[Array, "n n"]) -> float:
        """Compute the least eigenvalue of L on the complement of the kernel."""
        return _least_eigenvalue(self.shift_kernel(L))

    def rate_bound(self, Y: Annotated[Inexact[Array, "n n"], ANY_NUMBER]) -> float:
        """Compute a rate that no feasible L exceeds, from any Hermitian Y on the non-edges.

        Proof. Let W = Qᴴ Y Q and S = W − l I, positive semidefinite by the choice of l.
        For every feasible L = Q Z Qᴴ, ⟨W, Z⟩ = ⟨Y, L⟩ = 0, so ⟨S, Z⟩ = −l m. From Z ⪰ t I
        follows t tr S ≤ −l m, and tr S = (μ − l) m. Origin and size of Y do not matter.

        Entries at edges are ignored, so the proof always holds. l and μ are reduced by an
        upper limit of their rounding errors, which only raises the bound.
        """
        Y = np.where(self._allowed_entries, 0, Y + Y.conj().T)
        size = float(np.abs(Y).max())
        if not 0 < size < np.inf:
            return 1.0  # the mean eigenvalue, which the least never exceeds
        Y = Y / size
        inside = Y - self.kernel @ (self.kernel.conj().T @ Y)
        inside = inside - (inside @ self.kernel) @ self.kernel.conj().T
        rounding = EIGENVALUE_ERROR * len(Y) * float(np.linalg.norm(Y))
        least = self.convergence_rate(inside) - rounding
        mean = float(inside.trace().real) / self.m - rounding
        if mean <= 0:
            return 1.0
        if mean <= least:
            return -np.inf  # W = c I, and c tr Z = 0 has no solution
        return -least / (mean - least)

    def shift_kernel(self, L: Inexact[Array, "n n"]) -> Inexact[Array, "n n"]:
        """Raise the zero eigenvalues of the kernel above all others."""
        return np.asarray(L + (1 + np.linalg.norm(L)) * self._kernel_projector)

    @cached_property
    def _kernel_projector(self) -> Array:
        return np.asarray(self.kernel @ self.kernel.conj().T)

    @cached_property
    def _allowed_entries(self) -> Array:
        return np.asarray(self.graph | np.eye(len(self.graph), dtype=bool))

    @cached_property
    def trace_direction(self) -> tuple[Array, Array]:
        """Projection of I without the equation of the trace, and what it removes.

        It has the largest trace of all matrices of its size, and its squared norm is its trace:
        where that vanishes, every matrix has trace 0, which `NoGainMatrix` tells.
        """
        identity = np.eye(len(self.graph), dtype=self.kernel.dtype)
        direction, rest = self._project_without_trace(identity)
        if direction.trace().real <= ZERO_TOLERANCE * self.m:
            raise NoGainMatrix(rest)
        return direction, rest

    def _project_without_trace(self, W: Array) -> tuple[Array, Array]:
        # L = E∘(W − X Kᴴ − K Xᴴ) with X such that L K = 0, where E is 1 on the diagonal and
        # the edges. Later iterations remove the error of the regularized first solution.
        K, size = self.kernel, np.linalg.norm(W)
        for _ in range(MAX_REFINEMENTS):
            residual = np.where(self._allowed_entries, W, 0) @ K
            if np.linalg.norm(residual) <= ROUNDOFF * size:
                break
            half = self._multiplier(residual) @ K.conj().T
            W = W - (half + half.conj().T)
        return np.where(self._allowed_entries, W, 0), np.where(self._allowed_entries, 0, W)

    def _multiplier(self, residual: Array) -> Array:
        # X with E∘(X Kᴴ + K Xᴴ) K = residual, linear in the real and imaginary parts of X.
        planar = np.iscomplexobj(residual)
        parts = np.stack([residual.real, residual.imag]) if planar else residual[None]
        factor, lower = self._normal_factor
        X = lapack.dpotrs(factor, parts.ravel(), lower=lower)[0].reshape(parts.shape)
        return np.asarray(X[0] + 1j * X[1] if planar else X[0])

    @cached_property
    def _normal_factor(self) -> tuple[Array, bool]:
        # X ↦ G X + H X̄ in real and imaginary parts, symmetric and positive semidefinite. It
        # maps K times any anti-Hermitian matrix to zero; the regularization makes it definite.
        K, (n, r) = self.kernel, self.kernel.shape
        G = np.zeros((n, r, n, r), dtype=K.dtype)
        E, i = self._allowed_entries, np.arange(n)
        G[i, :, i] = np.einsum("ij,ja,jb->iab", E, K, K.conj())
        H = np.einsum("ij,ja,ib->iajb", E, K, K)
        G, H = G.reshape(n * r, n * r), H.reshape(n * r, n * r)
        if np.iscomplexobj(K):
            T = np.block([[G.real + H.real, H.imag - G.imag], [G.imag + H.imag, G.real - H.real]])
        else:
            T = G + H
        T[np.diag_indices_from(T)] += REGULARIZATION * T.diagonal().mean()
        factor, lower = cho_factor(T, overwrite_a=True, check_finite=False)
        return factor, bool(lower)


def _least_eigenvalue(A: Inexact[Array, "n n"]) -> float:
    values, *_, info = _find_routine(np.iscomplexobj(A), len(A))(A)
    if info != 0:
        raise np.linalg.LinAlgError(f"LAPACK stopped with {info} for a matrix of {A.shape}")
    return float(values[0])


@cache
def _find_routine(is_complex: bool, n: int) -> Any:
    # Checks and workspace queries of `scipy.linalg.eigvalsh` take four times as long as 6 × 6 do.
    name, keys = ("zheevr", ["lwork", "lrwork"]) if is_complex else ("dsyevr", ["lwork"])
    *sizes, _ = getattr(lapack, f"{name}_lwork")(n, lower=1)
    space = zip([*keys, "liwork"], (int(size.real) for size in sizes), strict=True)
    options = {"compute_v": 0, "range": "I", "il": 1, "iu": 1, "lower": 1}
    return partial(getattr(lapack, name), **options, **dict(space))
