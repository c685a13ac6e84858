"""Equations with orthonormal rows, which makes them well conditioned."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems.certificates import CERTIFICATE_TOLERANCE


@dataclass(frozen=True, eq=False)
class OrthonormalRows:
    """Equations Q u = b' in place of C u = b.

    With too few steps to reach every state, Q has fewer rows than C, and `transform` lists the
    right-hand sides that no control reaches.
    """

    rows: Float[Array, "r N"]  # Q
    factor: Float[Array, "s r"]  # L of C = L Q, in the units below
    row_scale: Float[Array, " s"]  # of the rows of C
    has_full_rank: bool  # True where Q has as many rows as C

    @classmethod
    def from_matrix(cls, C: Float[Array, "s N"]) -> "OrthonormalRows":
        """Orthonormalize the rows of C."""
        s, N = C.shape
        if N == 0:
            return cls(np.zeros((0, 0)), np.zeros((s, 0)), np.ones(s), False)
        if np.linalg.matrix_rank(C) == s:
            Q, R = np.linalg.qr(C.T)
            return cls(np.ascontiguousarray(Q.T), R.T, np.ones(s), True)
        # Positions and velocities are made comparable before the rank is determined.
        unit = np.maximum(np.abs(C).max(axis=1, initial=0.0), 1e-300)
        left, size, right = np.linalg.svd(C / unit[:, None], full_matrices=False)
        keep = size > 1e-12 * size.max(initial=0.0)
        return cls(right[keep], left[:, keep] * size[keep], unit, False)

    def transform(
        self, b: Float[Array, "programs s"], U: float
    ) -> tuple[Float[Array, "programs r"], Int[Array, " unreachable"]]:
        """Compute b', and the indices of those that no control reaches, at the scale U."""
        b = b / self.row_scale
        if self.has_full_rank:
            transformed = np.linalg.solve(self.factor, b.T).T
            return np.ascontiguousarray(transformed), np.zeros(0, np.int64)
        transformed = b @ np.linalg.pinv(self.factor).T
        residual = np.abs(b - transformed @ self.factor.T).max(axis=1, initial=0.0)
        unreachable = residual > CERTIFICATE_TOLERANCE * (U + np.abs(b).max(axis=1, initial=0.0))
        return np.ascontiguousarray(transformed), np.flatnonzero(unreachable)
