"""λ₂ from relayed rows: every robot passes on all rows of the adjacency that it knows.

A row is what its robot has computed of its own edges, with the time of it. Robots keep the
newest copy of each, forget what is older than a second, and take the eigenvalues of what is
left, by themselves. News from the other end of the graph is as many steps old as it is far.
"""

from typing import no_type_check

import numba
import numpy as np

from problems.fiedler_tracking import fiedler_vectors


@no_type_check
@numba.njit
def merge_rows(rows, stamp, rows_heard, stamp_heard):
    """Take over what a neighbour knows better.

    Args:
        rows: The adjacency as this robot has it, (n, n), changed in place.
        stamp: When each row was computed, (n,) [s], changed in place.
        rows_heard: As the neighbour has it.
        stamp_heard: And when.
    """
    for k in range(len(stamp)):
        if stamp_heard[k] > stamp[k]:
            stamp[k] = stamp_heard[k]
            rows[k] = rows_heard[k]


@no_type_check
@numba.njit
def estimate_lambda2_from_rows(rows, stamp, me, oldest, modes, felt):
    """λ₂ of the graph that a robot knows of, and what its own edges do to it.

    Args:
        rows: The adjacency as it has it, (n, n).
        stamp: When each row was computed, (n,) [s].
        me: The robot.
        oldest: What was computed before is forgotten [s].
        modes: Where its search for eigenvectors begins, (3, n), and where it ends.
        felt: Where ∂λ₂/∂A of its own edges go, (n,); 0 for who is forgotten.

    Returns:
        λ₂, or NaN where it knows of nobody else.
    """
    known = np.flatnonzero(stamp >= oldest)
    felt[:] = 0.0
    if len(known) < 2:
        return np.nan
    lambda2, vectors = known_fiedler_vectors(rows, known, modes)
    compute_lambda2_gradient(vectors, known, me, felt)
    return lambda2


@no_type_check
@numba.njit
def known_fiedler_vectors(rows, known, modes):
    """λ₂ and its eigenvectors, of the graph of some robots.

    Args:
        rows: The adjacency of all, (n, n).
        known: Which of them count, m ≥ 2.
        modes: Where the search begins, (3, n), and where it ends.

    Returns:
        λ₂, and its eigenvectors, (s, m).
    """
    basis = np.empty((3, len(known)))
    for a in range(len(known)):
        basis[:, a] = modes[:, known[a]]
    lambda2, vectors = fiedler_vectors(_laplacian(rows, known), basis)
    for a in range(len(known)):
        modes[:, known[a]] = basis[:, a]
    return lambda2, vectors


@no_type_check
@numba.njit
def compute_lambda2_gradient(vectors, known, me, felt):
    """∂λ₂/∂A of a robot's edges, the mean over the eigenvectors of λ₂.

    Args:
        vectors: Of λ₂, (s, m).
        known: Whose entries they have, (m,).
        me: The robot, one of them.
        felt: Where the derivatives go, (n,).
    """
    at = np.searchsorted(known, me)
    for a in range(len(known)):
        square = 0.0
        for v in vectors:
            square += (v[at] - v[a]) ** 2
        felt[known[a]] = square / len(vectors)


@no_type_check
@numba.njit
def smallest_eigenvalues(rows, stamp):
    """λ₂ and λ₃ of those with a stamp; infinite where there are too few."""
    known = np.flatnonzero(stamp > -np.inf)
    value = np.linalg.eigvalsh(_laplacian(rows, known))
    m = len(known)
    return (value[1] if m > 1 else np.inf), (value[2] if m > 2 else np.inf)


@no_type_check
@numba.njit
def _laplacian(rows, known):
    m = len(known)
    L = np.zeros((m, m))
    for a in range(m):
        for b in range(a):
            # Both ends compute the weight; noise and age make them differ a little.
            weight = (rows[known[a], known[b]] + rows[known[b], known[a]]) / 2
            L[a, b] = L[b, a] = -weight
            L[a, a] += weight
            L[b, b] += weight
    return L
