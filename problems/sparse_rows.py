"""Rows of constraints by their entries that are not zero, and the matrix of a program of them."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import csc_array


class SparseRows(NamedTuple):
    """Rows of a matrix, by their entries that are not zero; rows ascend in each column."""

    row: Int[Array, " entries"]
    column: Int[Array, " entries"]
    value: Float[Array, " entries"]
    height: int  # number of rows

    @classmethod
    def from_dense(cls, rows: Float[Array, "height columns"]) -> "SparseRows":
        """Return the rows of an array."""
        row, column = np.nonzero(rows)
        return cls(row, column, rows[row, column], len(rows))

    @classmethod
    def from_steps(cls, block: Float[Array, "rows m"], steps: int) -> "SparseRows":
        """Return the rows of a block-diagonal matrix: the same block at each step."""
        (height, width), k = block.shape, np.arange(steps)[:, None]
        row, column = np.nonzero(block)
        value = np.tile(block[row, column], steps)
        at = (row + height * k).ravel(), (column + width * k).ravel()
        return cls(*at, value, height * steps)

    def join(self, others: "SparseRows", first: int) -> "SparseRows":
        """Return the rows with entries of others in the columns from the first on."""
        both = (self.row, others.row), (self.column, others.column + first)
        row, column, value = map(np.concatenate, (*both, (self.value, others.value)))
        return SparseRows(row, column, value, self.height)

    def negate(self) -> "SparseRows":
        """Return the rows times −1."""
        return self._replace(value=-self.value)


def stack_with_bounds(
    zero: SparseRows,
    linear: Sequence[SparseRows],
    cones: Sequence[SparseRows],
    count: int,
    columns: int,
    cone: int,
) -> tuple[csc_array, tuple[int, int, tuple[int, ...]]]:
    """Stack equalities, inequalities, x ≤ 1 for the first unknowns, x ≥ 0 for all, and cones.

    Returns the matrix, and the numbers of rows of equalities, of inequalities and of each cone.
    """
    every = np.arange(columns)
    upper = SparseRows(every[:count], every[:count], np.ones(count), count)
    parts = [zero, *linear, upper, SparseRows(every, every, -np.ones(columns), columns), *cones]
    first = np.cumsum([0, *(part.height for part in parts)])
    row = np.concatenate([part.row + begin for part, begin in zip(parts, first, strict=False)])
    column = np.concatenate([part.column for part in parts])
    value = np.concatenate([part.value for part in parts])
    total, last = int(first[-1]), sum(part.height for part in cones)
    A = csc_array((value, (row, column)), shape=(total, columns))
    return A, (zero.height, total - zero.height - last, (cone,) * (last // cone))
