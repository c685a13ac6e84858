"""Equations made well conditioned: rows of length one, square to each other."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems.certificates import CERTIFICATE_TOLERANCE


@dataclass(frozen=True, eq=False)
class OrthonormalRows:
    """Q u = b' in place of C u = b.

    With fewer steps than it takes to reach every state, what no control reaches is left
    out, and questions that ask for it are listed.
    """

    rows: Float[Array, "r N"]  # Q
    factor: Float[Array, "s r"]  # L of C = L Q, in the units below
    row_scale: Float[Array, " s"]  # of the rows of C
    has_full_rank: bool  # whether no row had to be left out

    @classmethod
    def from_matrix(cls, columns: Float[Array, "s N"]) -> "OrthonormalRows":
        """The same questions, from the coefficients C."""
        s, N = columns.shape
        if N == 0:
            return cls(np.zeros((0, 0)), np.zeros((s, 0)), np.ones(s), False)
        if np.linalg.matrix_rank(columns) == s:
            Q, R = np.linalg.qr(columns.T)
            return cls(np.ascontiguousarray(Q.T), R.T, np.ones(s), True)
        # States in metres and in metres a second are made comparable before a rank is read.
        unit = np.maximum(np.abs(columns).max(axis=1, initial=0.0), 1e-300)
        left, size, right = np.linalg.svd(columns / unit[:, None], full_matrices=False)
        keep = size > 1e-12 * size.max(initial=0.0)
        return cls(right[keep], left[:, keep] * size[keep], unit, False)

    def transform(
        self, b: Float[Array, "questions s"], U: float
    ) -> tuple[Float[Array, "questions r"], Int[Array, " missed"]]:
        """b', and the questions that ask for what no control of size U or any other reaches."""
        b = b / self.row_scale
        if self.has_full_rank:
            white = np.linalg.solve(self.factor, b.T).T
            return np.ascontiguousarray(white), np.zeros(0, np.int64)
        white = b @ np.linalg.pinv(self.factor).T
        missing = np.abs(b - white @ self.factor.T).max(axis=1, initial=0.0)
        missed = missing > CERTIFICATE_TOLERANCE * (U + np.abs(b).max(axis=1, initial=0.0))
        return np.ascontiguousarray(white), np.flatnonzero(missed)
