"""Rows of programs by their entries."""

import numpy as np

from problems.sparse_rows import SparseRows, stack_with_bounds


def test_stacked_rows_are_those_of_the_dense_matrix(rng):
    for _ in range(20):
        m, T, height, more = (int(n) for n in rng.integers(1, 6, 4))
        block, N = rng.choice([0.0, 1.0, -0.5], (height, m)), m * T
        zero, cone = rng.normal(size=(2, N + more)), rng.normal(size=(m + 1, N + more))
        steps = np.kron(np.eye(T), block)
        norms = np.kron(np.eye(T), np.ones((height, 1)))
        wide = N + max(T, more)
        zero, cone = (np.pad(rows, ((0, 0), (0, wide - N - more))) for rows in (zero, cone))
        rhs = [rng.normal(size=size) for size in (2, height, m + 1)]
        part = SparseRows.from_steps(block, T, rhs[1])
        part = part.join(SparseRows.from_steps(np.ones((height, 1)), T, rhs[1]), N)
        equal, last = SparseRows.from_dense(zero, rhs[0]), SparseRows.from_dense(cone, rhs[2])
        A, b, sizes = stack_with_bounds(equal, [part.negate()], [last], N, wide, m + 1, 0.5)
        linear = -np.hstack([steps, norms, np.zeros((T * height, wide - N - T))])
        bounds = [np.eye(N, wide), -np.eye(wide)]
        np.testing.assert_array_equal(A.toarray(), np.vstack([zero, linear, *bounds, cone]))
        floor = np.concatenate([np.full(N, 0.5), np.zeros(wide - N)])
        expected = [rhs[0], np.tile(rhs[1], T), np.ones(N), floor, rhs[2]]
        np.testing.assert_array_equal(b, np.concatenate(expected))
        assert sizes == (2, T * height + N + wide, (m + 1,))
        assert A.has_canonical_format
