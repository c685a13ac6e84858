"""Rows of the standard form, as libraries of two-sided rows and of two matrices want them."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.sparse import csc_array, csc_matrix

from problems.conic import ConicProgram


def lower_bounds(b: Float[Array, " m"], zero: int, infinity: float = np.inf) -> Float[Array, " m"]:
    """What A x is not below: b where there are equations, and nothing else.

    Args:
        b: What A x is not above.
        zero: How many equations there are; they come first.
        endless: What a library takes for infinite.
    """
    return np.concatenate([b[:zero], np.full(len(b) - zero, -infinity)])


def split_equalities(problem: ConicProgram) -> tuple[csc_matrix, csc_matrix]:
    """The equations and the other rows of A, in the class of SciPy that older libraries know."""
    A = problem.A
    return csc_matrix(A[: problem.zero]), csc_matrix(A[problem.zero :])


def zero_hessian(problem: ConicProgram) -> csc_array:
    """P, the quadratic cost of libraries that have one."""
    n = len(problem.q)
    return csc_array((n, n))
