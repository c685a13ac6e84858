"""λ₂ from relayed rows: every robot passes on all rows of the adjacency that it knows.

A row is what its robot has computed of its own edges, with the time of it. Robots keep the
newest copy of each, forget what is older than a second, and take the eigenvalues of what is
left, by themselves. News from the other end of the graph is as many steps old as it is far.
"""

from typing import no_type_check

import numba
import numpy as np

from problems.graph import ALIKE


@no_type_check
@numba.njit
def relay(rows, stamp, rows_heard, stamp_heard):
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
def eigen(rows, stamp, me, oldest, felt):
    """λ₂ of the graph that a robot knows of, and what its own edges do to it.

    Args:
        rows: The adjacency as it has it, (n, n).
        stamp: When each row was computed, (n,) [s].
        me: The robot.
        oldest: What was computed before is forgotten [s].
        felt: Where ∂λ₂/∂A of its own edges go, (n,); 0 for who is forgotten.

    Returns:
        λ₂, or NaN where it knows of nobody else.
    """
    known = np.flatnonzero(stamp >= oldest)
    felt[:] = 0.0
    m = len(known)
    if m < 2:
        return np.nan
    at = np.searchsorted(known, me)
    value, vector = np.linalg.eigh(_laplacian(rows, known))
    same = 1
    while same + 1 < m and value[same + 1] - value[1] <= ALIKE * max(1.0, value[1]):
        same += 1
    for a in range(m):
        for k in range(1, same + 1):
            felt[known[a]] += (vector[at, k] - vector[a, k]) ** 2 / same
    return value[1]


@no_type_check
@numba.njit
def two_least(rows, stamp):
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
