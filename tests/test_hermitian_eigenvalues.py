"""Eigenvalues of Hermitian matrices: the routines of SciPy, called directly."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy import linalg

from problems.hermitian_eigenvalues import eigh, least_eigenvalue


@pytest.mark.parametrize("n", [1, 2, 6, 40, 130])
@pytest.mark.parametrize("planar", [True, False])
def test_results_are_those_of_scipy_bit_for_bit(n, planar, rng):
    A = rng.normal(size=(n, n)) + (1j * rng.normal(size=(n, n)) if planar else 0)
    A = A + A.conj().T
    before = A.copy()
    for found, expected in zip(eigh(A), linalg.eigh(A, driver="evd"), strict=True):
        assert_array_equal(found, expected)
    assert least_eigenvalue(A) == linalg.eigvalsh(A, subset_by_index=[0, 0])[0]
    assert_array_equal(A, before)


def test_matrix_without_eigenvalues_raises_an_error():
    with pytest.raises(np.linalg.LinAlgError, match=r"dsyevd stopped with \d .* \(3, 3\)"):
        eigh(np.full((3, 3), np.nan))
