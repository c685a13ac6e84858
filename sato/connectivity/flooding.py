"""Estimate of λ₂ from flooded rows of the adjacency matrix.

Every agent computes the row of its own edges, with the time, and relays all rows that it
knows. Each keeps the newest copy of a row, forgets old ones, and decomposes what is left. A
row from the other end of the graph is as many steps old as it is hops away.
"""

from typing import no_type_check

import numba
import numpy as np

from problems.fiedler_tracking import fiedler_vectors


@no_type_check
@numba.njit
def merge_rows(rows, row_time, received_rows, received_time):
    """Take over the rows that a neighbor has newer.

    Args:
        rows: Adjacency matrix as known to this agent, (n, n), changed in place.
        row_time: Time at which each row was computed, (n,) [s], changed in place.
        received_rows: Matrix of the neighbor.
        received_time: Times of the neighbor.
    """
    for k in range(len(row_time)):
        if received_time[k] > row_time[k]:
            row_time[k] = received_time[k]
            rows[k] = received_rows[k]


@no_type_check
@numba.njit
def estimate_lambda2_from_rows(rows, row_time, i, oldest, guess, gradient):
    """Estimate λ₂ of the graph known to agent i, and its gradient in the edges of i.

    Args:
        rows: Adjacency matrix as known to the agent, (n, n).
        row_time: Time at which each row was computed, (n,) [s].
        i: Index of the agent.
        oldest: Time before which rows are forgotten [s].
        guess: Start of the search for eigenvectors, (3, n); overwritten with its end.
        gradient: Output ∂λ₂/∂A_ij, (n,); 0 for forgotten agents.

    Returns:
        λ₂, or NaN where no other agent is known.
    """
    known = np.flatnonzero(row_time >= oldest)
    gradient[:] = 0.0
    if len(known) < 2:
        return np.nan
    lambda2, vectors = known_fiedler_vectors(rows, known, guess)
    compute_lambda2_gradient(vectors, known, i, gradient)
    return lambda2


@no_type_check
@numba.njit
def known_fiedler_vectors(rows, known, guess):
    """Compute λ₂ and its eigenvectors for the graph of some agents.

    Args:
        rows: Adjacency matrix of all agents, (n, n).
        known: Indices of the agents of the graph, m ≥ 2.
        guess: Start of the search for eigenvectors, (3, n); overwritten with its end.

    Returns:
        λ₂, and its eigenvectors, (s, m).
    """
    basis = np.ascontiguousarray(guess[:, known])
    lambda2, vectors = fiedler_vectors(_laplacian(rows, known), basis)
    guess[:, known] = basis
    return lambda2, vectors


@no_type_check
@numba.njit
def compute_lambda2_gradient(vectors, known, i, gradient):
    """Compute ∂λ₂/∂A_ij of the edges of agent i, as the mean over the eigenvectors of λ₂.

    Args:
        vectors: Eigenvectors of λ₂, (s, m).
        known: Agents of their entries, (m,).
        i: Index of the agent, one of them.
        gradient: Output, (n,).
    """
    at = np.searchsorted(known, i)
    for a in range(len(known)):
        square = 0.0
        for v in vectors:
            square += (v[at] - v[a]) ** 2
        gradient[known[a]] = square / len(vectors)


@no_type_check
@numba.njit
def smallest_eigenvalues(rows, row_time):
    """Compute λ₂ and λ₃ of agents whose row has a time; infinite for too few agents."""
    known = np.flatnonzero(row_time > -np.inf)
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
            # Both ends of an edge compute its weight; noise and age make the two differ.
            weight = (rows[known[a], known[b]] + rows[known[b], known[a]]) / 2
            L[a, b] = L[b, a] = -weight
            L[a, a] += weight
            L[b, b] += weight
    return L
