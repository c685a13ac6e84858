"""Rows of constraints by their entries that are not zero, and the matrix of a program of them."""

from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.sparse import block_diag, coo_array, csc_array

Sides = Float[Array, " rows"]  # right-hand sides


def stack_diagonally(blocks: Iterable[Array]) -> Any:
    """Return a sparse block-diagonal matrix, with the zeros of the blocks among its entries."""
    return block_diag([coo_array((0, 0)), *blocks])  # without a sparse block, SciPy warns


class SparseRows(NamedTuple):
    """Rows of a matrix, by their entries that are not zero, and right-hand sides of constraints.

    Rows ascend in each column.
    """

    row: Int[Array, " entries"]
    column: Int[Array, " entries"]
    value: Float[Array, " entries"]
    rhs: Sides

    @classmethod
    def from_dense(cls, rows: Float[Array, "rows columns"], rhs: Sides) -> "SparseRows":
        """Return the rows of an array."""
        row, column = np.nonzero(rows)
        return cls(row, column, rows[row, column], rhs)

    @classmethod
    def from_steps(cls, block: Float[Array, "rows m"], steps: int, rhs: Sides) -> "SparseRows":
        """Return the rows of a block-diagonal matrix: the same block at each step."""
        (height, width), k = block.shape, np.arange(steps)[:, None]
        row, column = np.nonzero(block)
        places = (row + height * k).ravel(), (column + width * k).ravel()
        return cls(*places, np.tile(block[row, column], steps), np.tile(rhs, steps))

    def join(self, others: "SparseRows", first: int) -> "SparseRows":
        """Return the rows with entries of others in the columns from the first on."""
        both = (self.row, others.row), (self.column, others.column + first)
        row, column, value = map(np.concatenate, (*both, (self.value, others.value)))
        return SparseRows(row, column, value, self.rhs)

    def negate(self) -> "SparseRows":
        """Return the rows times −1, with the same right-hand sides."""
        return self._replace(value=-self.value)


def stack_with_bounds(
    zero: SparseRows,
    linear: Sequence[SparseRows],
    cones: Sequence[SparseRows],
    count: int,
    columns: int,
    cone: int,
    negative: float = 0.0,
) -> tuple[csc_array, Sides, tuple[int, int, tuple[int, ...]]]:
    """Stack equalities, inequalities, bounds of the unknowns, and cones of so many rows.

    The bounds are −negative ≤ x ≤ 1 for the first unknowns, and x ≥ 0 for the others. Returns the
    matrix, right-hand sides, and the numbers of rows of equalities, inequalities and each cone.
    """
    every, floor = np.arange(columns), np.zeros(columns)
    floor[:count] = negative
    upper = SparseRows(every[:count], every[:count], np.ones(count), np.ones(count))
    parts = [zero, *linear, upper, SparseRows(every, every, -np.ones(columns), floor), *cones]
    first = np.cumsum([0, *(len(part.rhs) for part in parts)])
    row = np.concatenate([part.row + begin for part, begin in zip(parts, first, strict=False)])
    column = np.concatenate([part.column for part in parts])
    value = np.concatenate([part.value for part in parts])
    rhs = np.concatenate([part.rhs for part in parts])
    A = csc_array((value, (row, column)), shape=(len(rhs), columns))
    equal, last = len(zero.rhs), sum(len(part.rhs) for part in cones)
    return A, rhs, (equal, len(rhs) - equal - last, (cone,) * (last // cone))
