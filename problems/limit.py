"""Limits of a vector: balls of the norms 1, 2 and ∞, and boxes with sides of their own."""

from dataclasses import dataclass
from functools import cached_property, reduce
from itertools import product
from typing import Any, Literal

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.vehicle import vector_lengths

Norm = Literal[1, 2, "inf"]
LIMIT_TOLERANCE = 1e-9  # relative, by which rounding may exceed a limit in flight
Bound = float | Float[Array, " m"]  # the same on all axes, or one an axis


@dataclass(frozen=True, eq=False)
class Limit:
    """Set of vectors ‖v / s‖_r ≤ L, with 0 < s ≤ 1 the share of each axis in L.

    All shares are 1 unless the bound has an entry an axis; with r = ∞ it is then a box.
    """

    bound: Bound
    norm: Norm
    axes: int

    @cached_property
    def most(self) -> float:
        """L, the largest entry of the bound."""
        return float(np.max(self.bound))

    @cached_property
    def shares(self) -> Float[Array, " m"]:
        """Share s of each axis, 1 where its bound is the largest."""
        if np.ndim(self.bound) == 0:
            return np.ones(self.axes)
        return np.asarray(self.bound) / self.most

    def measure(self, v: Float[Array, "*k m"]) -> Float[Array, "*k"]:
        """Compute ‖v / s‖_r, which may be at most L."""
        return vector_norm(v if np.ndim(self.bound) == 0 else v / self.shares, self.norm)

    def excess(self, v: Float[Array, "*k m"]) -> float:
        """Compute by how much the largest vector exceeds the limit, relative to it."""
        return float(self.measure(v).max(initial=0.0)) / self.most - 1

    def is_exceeded(self, v: Float[Array, "*k m"]) -> Bool[Array, "*k"]:
        """Tell which vectors exceed the limit by more than rounding."""
        most = self.most * (1 + LIMIT_TOLERANCE)
        if self.norm != 2:
            return np.asarray(self.measure(v) > most)
        scaled = v if np.ndim(self.bound) == 0 else v / self.shares
        # NumPy's norm takes several times as long.
        return np.asarray(np.einsum("...m,...m->...", scaled, scaled) > most**2)

    def cut(self, v: Float[Array, "*k m"]) -> Float[Array, "*k m"]:
        """Shorten the vectors outside the set, as those of solvers are by rounding.

        Where there are none, the argument itself is returned.
        """
        size = self.measure(v)
        if (size <= self.most).all():
            return v
        return np.asarray(v * np.minimum(1.0, self.most / np.maximum(size, 1e-300))[..., None])

    def most_along(self, direction: Float[Array, "*k m"]) -> Float[Array, "*k"]:
        """Compute the largest product of a vector in the set with a direction."""
        duals: dict[Norm, Norm] = {1: "inf", 2: 2, "inf": 1}
        return np.asarray(self.most * vector_norm(direction * self.shares, duals[self.norm]))

    @cached_property
    def largest_length(self) -> float:
        """Largest Euclidean length of a vector in the set."""
        return self.most if self.norm != "inf" else self.most * float(np.linalg.norm(self.shares))

    @cached_property
    def least_length(self) -> float:
        """Euclidean length of the shortest vector on the boundary of the set."""
        if self.norm == 1:
            return self.most / float(np.linalg.norm(1 / self.shares))
        return self.most * float(self.shares.min())

    @cached_property
    def faces(self) -> Float[Array, "k m"] | None:
        """Rows F with F v ≤ L everywhere in the set, and only there; None for r = 2."""
        if self.norm == 2:
            return None
        corners = np.array(list(product((1.0, -1.0), repeat=self.axes)))
        rows = corners if self.norm == 1 else np.vstack([np.eye(self.axes), -np.eye(self.axes)])
        return np.asarray(rows / self.shares)

    def constrain(
        self, response: Float[Array, "k m unknowns"], drift: Float[Array, "k m"]
    ) -> tuple[Float[Array, "rows unknowns"], Float[Array, " rows"]]:
        """Return rows and rhs: −rows · u ≤ rhs where all response[k] u + drift[k] are in the set.

        Where the norm is Euclidean, rhs + rows · u are cones of m + 1 rows, (t, y) with ‖y‖₂ ≤ t.
        """
        if self.faces is None:
            scaled = response / self.shares[:, None]
            rows = np.concatenate([np.zeros_like(scaled[:, :1]), scaled], axis=1)
            rhs = np.insert(drift / self.shares, 0, self.most, axis=1)
        else:
            rows, rhs = -self.faces @ response, self.most - drift @ self.faces.T
        return rows.reshape(-1, response.shape[-1]), rhs.ravel()

    def to_cvxpy(self, rows: Any) -> Any:
        """Constrain every row of an expression in CVXPY."""
        import cvxpy as cp

        scaled = rows if np.ndim(self.bound) == 0 else rows @ np.diag(1 / self.shares)
        return cp.norm(scaled, self.norm, axis=1) <= self.most


def vector_norm(u: Float[Array, "*k m"], norm: Norm) -> Float[Array, "*k"]:
    """Compute the norm of vectors: 1, 2 or "inf"."""
    if norm == 2:
        return vector_lengths(u)
    parts = np.moveaxis(np.abs(u), -1, 0)  # NumPy's sums take longer along an axis of three
    return np.asarray(reduce(np.maximum if norm == "inf" else np.add, parts))
