"""What gains must satisfy in one of the two directions, and what bounds their rate."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Inexact
from numpy import ndarray as Array
from scipy.linalg import cho_factor, cho_solve, eigvalsh

from problems.desired_formation import DesiredFormation

Axes = Literal["xy", "z"]  # in the plane, or upwards

MIN_RATE = 1e-6  # of the mean: gains as slow as this, or proven to be slower, are none
ZERO_TOLERANCE = 1e-9  # of what it could be: taken for zero
ROUNDOFF = 1e-14  # relative: what products and eigenvalues are exact to
EIGENVALUE_ERROR = 1e-15  # times n, relative: more than what the eigenvalues of a bound are off by
REGULARIZATION = 1e-10  # of the mean: far above rounding, far below what matters
MAX_REFINEMENTS = 6  # at most; two are the rule


class NoGainMatrix(RuntimeError):
    """The graph and the kernel leave no matrix but those of trace 0.

    Attributes:
        dual: Matrix Y on the non-edges with Qᴴ Y Q = I, which proves it.
    """

    def __init__(self, dual: Inexact[Array, "n n"]) -> None:
        super().__init__("no matrix with this graph and kernel has a positive trace")
        self.dual = dual


class GainSolution(NamedTuple):
    """What a method has to say to a question; `Question` says what it is worth."""

    L: Inexact[Array, "n n"]  # the gain is −L
    Y: Inexact[Array, "n n"]  # the dual, on the non-edges


class GainProjection(NamedTuple):
    """A matrix parted in two by a projection."""

    projected: Inexact[Array, "n n"]  # L, the nearest that fits
    removed: Inexact[Array, "n n"]  # Y, what stood at the non-edges


@dataclass(frozen=True, eq=False)
class GainProblem:
    """How fast can a formation be made to form, in the plane or upwards?

    maximise t  subject to  L ⪰ t (I − K Kᴴ),  L K = 0,  tr L = m,  L_ij = 0 at non-edges

    over Hermitian L; the gain is −L, and its rate t. The kernel K is complex in the plane
    and real upwards [Lusk2020, eq. 5 and 7]; m = n − r counts the eigenvalues that are not
    in it, so that their mean is 1. With Q the complement of K and L = Q Z Qᴴ this is the
    programme in Z that the paper states.

    The dual is over Hermitian Y with entries at the non-edges alone:

    minimise −l / (μ − l),   l = λ_min(Qᴴ Y Q),   μ = tr(Qᴴ Y Q) / m
    """

    kernel: Inexact[Array, "n r"]  # K, of orthonormal columns
    graph: Bool[Array, "n n"]

    @classmethod
    def from_formation(cls, formation: DesiredFormation, which: Axes) -> "GainProblem":
        """What is asked of the gains of a formation in the plane, or upwards."""
        kernel = formation.kernel_xy if which == "xy" else formation.kernel_z
        return cls(kernel, formation.graph)

    @property
    def m(self) -> int:
        """The number of eigenvalues outside the kernel."""
        n, r = self.kernel.shape
        return int(n - r)

    @property
    def is_complete(self) -> bool:
        """Whether the graph lacks no edge."""
        return bool(self._allowed_entries.all())

    def project(self, W: Inexact[Array, "n n"]) -> Inexact[Array, "n n"]:
        """The nearest Hermitian L with L K = 0, tr L = m and zeros at the non-edges.

        Raises:
            NoMatrix: There is none.
        """
        return self.project_with_remainder(W).projected

    def project_with_remainder(self, W: Inexact[Array, "n n"]) -> GainProjection:
        """The projection of a Hermitian matrix and what it drops at the non-edges.

        Raises:
            NoMatrix: There is none to project on.
        """
        kept, dropped = self._project_without_trace(W)
        unit, rest = self._trace_direction
        lack = (self.m - kept.trace().real) / unit.trace().real
        return GainProjection(kept + lack * unit, dropped + lack * rest)

    def convergence_rate(self, L: Inexact[Array, "n n"]) -> float:
        """The least eigenvalue of L on the complement of the kernel."""
        return float(eigvalsh(self.shift_kernel(L), subset_by_index=[0, 0], check_finite=False)[0])

    def rate_bound(self, Y: Inexact[Array, "n n"]) -> float:
        """A rate that no L exceeds, from any Hermitian Y on the non-edges.

        Proof. Let W = Qᴴ Y Q and S = W − l I, positive semidefinite by the choice of l.
        For every L = Q Z Qᴴ of the question ⟨W, Z⟩ = ⟨Y, L⟩ = 0, so ⟨S, Z⟩ = −l m. With
        Z ⪰ t I follows t tr S ≤ −l m, and tr S = (μ − l) m. It does not matter where Y
        comes from, nor how large it is. Entries at edges are left out here, so that the
        proof always holds; and l and μ are taken for less than they are computed to be, by
        what rounding may have added, which only raises the bound.
        """
        Y = np.where(self._allowed_entries, 0, Y + Y.conj().T)
        size = float(np.abs(Y).max())
        if not 0 < size < np.inf:
            return 1.0  # the mean of all eigenvalues, which the least never exceeds
        Y = Y / size
        inside = Y - self.kernel @ (self.kernel.conj().T @ Y)
        inside = inside - (inside @ self.kernel) @ self.kernel.conj().T
        slack = EIGENVALUE_ERROR * len(Y) * float(np.linalg.norm(Y))
        least = self.convergence_rate(inside) - slack
        mean = float(inside.trace().real) / self.m - slack
        if mean <= 0:
            return 1.0
        if mean <= least:
            return -np.inf  # W = c I, and c tr Z = 0 has no answer
        return -least / (mean - least)

    def shift_kernel(self, L: Inexact[Array, "n n"]) -> Inexact[Array, "n n"]:
        """L with the zero eigenvalues of its kernel lifted above all others."""
        K = self.kernel
        return np.asarray(L + (1 + np.linalg.norm(L)) * (K @ K.conj().T))

    @cached_property
    def _allowed_entries(self) -> Array:
        return np.asarray(self.graph | np.eye(len(self.graph), dtype=bool))

    @cached_property
    def _trace_direction(self) -> tuple[Array, Array]:
        # Of what fits but for its trace, I is the farthest; and its square size is its trace.
        unit, rest = self._project_without_trace(np.eye(len(self.graph), dtype=self.kernel.dtype))
        if unit.trace().real <= ZERO_TOLERANCE * self.m:
            raise NoGainMatrix(rest)
        return unit, rest

    def _project_without_trace(self, W: Array) -> tuple[Array, Array]:
        # The projection without the trace: L = E∘(W − X Kᴴ − K Xᴴ) with X such that L K = 0,
        # E being 1 at the diagonal and the edges. Later passes repair what the shift of
        # _factor does to the first.
        K, size = self.kernel, np.linalg.norm(W)
        for _ in range(MAX_REFINEMENTS):
            miss = np.where(self._allowed_entries, W, 0) @ K
            if np.linalg.norm(miss) <= ROUNDOFF * size:
                break
            half = self._multiplier(miss) @ K.conj().T
            W = W - half - half.conj().T
        return np.where(self._allowed_entries, W, 0), np.where(self._allowed_entries, 0, W)

    def _multiplier(self, miss: Array) -> Array:
        # X with E∘(X Kᴴ + K Xᴴ) K = miss: linear in the real and imaginary parts of X.
        solved = cho_solve(self._normal_factor, _to_real_parts(miss).ravel(), check_finite=False)
        return _from_real_parts(solved.reshape(-1, *miss.shape))

    @cached_property
    def _normal_factor(self) -> tuple[Array, bool]:
        # X ↦ G X + H X̄ in real and imaginary parts, symmetric and positive semidefinite. Some X
        # change nothing, as K times an antihermitian matrix; the shift makes it definite.
        K, (n, r) = self.kernel, self.kernel.shape
        G = np.zeros((n, r, n, r), dtype=K.dtype)
        G[np.arange(n), :, np.arange(n)] = np.einsum(
            "ij,ja,jb->iab", self._allowed_entries, K, K.conj()
        )
        H = np.einsum("ij,ja,ib->iajb", self._allowed_entries, K, K)
        G, H = G.reshape(n * r, n * r), H.reshape(n * r, n * r)
        if np.iscomplexobj(K):
            T = np.block([[G.real + H.real, H.imag - G.imag], [G.imag + H.imag, G.real - H.real]])
        else:
            T = G + H
        T[np.diag_indices_from(T)] += REGULARIZATION * T.diagonal().mean()
        factor, lower = cho_factor(T, overwrite_a=True, check_finite=False)
        return factor, lower


def _to_real_parts(X: Array) -> Array:
    return np.stack([X.real, X.imag]) if np.iscomplexobj(X) else X[None]


def _from_real_parts(parts: Array) -> Array:
    return np.asarray(parts[0] + 1j * parts[1] if len(parts) == 2 else parts[0])
