"""Eigenvalues of Hermitian matrices by LAPACK, without the overhead of `scipy.linalg.eigh`.

Checks and workspace queries of SciPy take four times as long as a matrix of 6 × 6 does. The
routines and their workspaces are the same, and so is every bit of the result.
"""

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
from jaxtyping import Float, Inexact
from numpy import ndarray as Array
from scipy.linalg import lapack

WORKSPACES = {
    "dsyevd": ("lwork", "liwork"),
    "zheevd": ("lwork", "liwork", "lrwork"),
    "dsyevr": ("lwork", "liwork"),
    "zheevr": ("lwork", "lrwork", "liwork"),
}


def eigh(A: Inexact[Array, "n n"]) -> tuple[Float[Array, " n"], Inexact[Array, "n n"]]:
    """Compute all eigenvalues, ascending, and their vectors as columns.

    Raises:
        LinAlgError: LAPACK does not converge.
    """
    values, vectors = _call("zheevd" if np.iscomplexobj(A) else "dsyevd", A)
    return values, vectors


def least_eigenvalue(A: Inexact[Array, "n n"]) -> float:
    """Compute the least eigenvalue.

    Raises:
        LinAlgError: LAPACK does not converge.
    """
    values = _call("zheevr" if np.iscomplexobj(A) else "dsyevr", A)[0]
    return float(values[0])


def _call(name: str, A: Array) -> tuple[Array, Array]:
    values, vectors, *_, info = _routine(name, len(A))(A)
    if info != 0:
        raise np.linalg.LinAlgError(f"{name} stopped with {info} for a matrix of {A.shape}")
    return values, vectors


@cache
def _routine(name: str, n: int) -> Callable[[Array], Any]:
    every = name.endswith("evd")
    *sizes, _ = getattr(lapack, f"{name}_lwork")(n, lower=1)
    workspace = zip(WORKSPACES[name], (int(size.real) for size in sizes), strict=True)
    options = {} if every else {"compute_v": 0, "range": "I", "il": 1, "iu": 1}
    return partial(getattr(lapack, name), lower=1, **options, **dict(workspace))
