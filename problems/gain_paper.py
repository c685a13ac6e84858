"""Gains as the paper designs them, for teaching and comparison [Lusk2020, eq. 8 to 10]."""

import numpy as np
from numpy import ndarray as Array
from scipy.linalg import block_diag, null_space
from scipy.sparse import csr_array, eye_array, vstack
from scipy.sparse.linalg import splu

from problems.gain_problem import GainProblem, GainSolution

ADMM_PENALTY = 1.0  # μ, as in the paper's code
REGULARIZATION = 1e-12  # shift by which equations that follow from others do no harm

LinearConstraint = tuple[csr_array, Array]


def solve(
    question: GainProblem,
    max_iterations: int = 10,
    trace_tolerance: float = 0.1,
    change_tolerance: float = 1e-4,
) -> GainSolution:
    """Alternating directions on the dual [Wen2010] of the paper's programme.

        minimise ⟨C, X⟩  subject to  A(X) = b,  X ⪰ 0

        X = [γI I; I Z],  C = [I 0; 0 0],  so that X ⪰ 0 says Z ⪰ I/γ, and

        y ← (A A*)⁻¹ (A(C − S − μX) + μb)
        W ← C − A*(y) − μX
        S ← W without its negative eigenvalues
        X ← (S − W)/μ

    In the plane all is real, of twice the size, and equations make Z a matrix of blocks
    [a −b; b a]. Eigenvalues are thus those of a matrix four times as large as is needed, and
    its structure costs more equations than the question has.

    By default it stops as the paper's code does: after at most 10 rounds, or as soon as the
    trace is right to 10 %. That is far from the optimum, and what there is by then is
    projected on the equations, where it need not be positive any more. So these gains are
    slower than need be, and on sparse graphs may be unstable; where no gains stabilise,
    there is no γ, and it returns some nevertheless. The bound does not fail, but is loose.
    With `trace_slack=0` and thousands of rounds it converges.

    In the paper, the norm in (9) is to be squared, in Proposition 1 the gains are −R Z Rᵀ,
    and on the complete graph the rounds are six; it is the projection that needs but one.

    Args:
        question: Kernel and graph.
        iterations: Rounds at most.
        trace_slack: The share of the trace that may lack or be too much when it stops.
        until: It stops too where the sum of all changes in X is less.

    Returns:
        L = Q Z Qᴴ, projected, and the prices y of the non-edges as a matrix Y.

    Raises:
        ValueError: There is not even one round.
        NoMatrix: Graph and kernel leave no matrix with a trace.
    """
    if max_iterations < 1:
        raise ValueError(f"gains take at least one round, got {max_iterations}")
    question.project(np.eye(len(question.graph), dtype=question.kernel.dtype))
    Q = _to_real_blocks(null_space(question.kernel.conj().T))
    p = Q.shape[1]
    rows = _graph_free_constraints(p, np.iscomplexobj(question.kernel))
    prices_from = sum(len(b) for _, b in rows)
    rows.append(_non_edge_constraints(question, Q))
    A, b = vstack([row for row, _ in rows], format="csr"), np.concatenate([b for _, b in rows])
    factor = splu(
        (A @ A.T + REGULARIZATION * eye_array(len(b))).tocsc(), permc_spec="MMD_AT_PLUS_A"
    )

    C = block_diag(np.eye(p), np.zeros((p, p)))
    X, S, μ = np.tile(np.eye(p), (2, 2)), np.zeros((2 * p, 2 * p)), ADMM_PENALTY
    for _ in range(max_iterations):
        y = factor.solve(A @ (C - S - μ * X).ravel() + μ * b)
        W = C - (A.T @ y).reshape(2 * p, 2 * p) - μ * X
        S = _project_psd(W)
        before, X = X, (S - W) / μ
        lacks = abs(X[p:, p:].trace() - p)
        if lacks <= trace_tolerance * p or np.abs(X - before).sum() < change_tolerance:
            break
    L = question.project(_from_real_blocks(Q @ X[p:, p:] @ Q.T, question))
    return GainSolution(L, _dual_matrix(y[prices_from:], question))


def _graph_free_constraints(p: int, planar: bool) -> list[LinearConstraint]:
    # All of A(X) = b that does not depend on the graph.
    each, (i, j) = np.arange(p), np.triu_indices(p, 1)
    across = [grid.ravel() for grid in np.indices((p, p))]
    trace = csr_array(np.ones((1, p))) @ _symmetric_entry_rows(p, p + each, p + each)
    rows = [
        (
            _symmetric_entry_rows(p, each[1:], each[1:])
            - _symmetric_entry_rows(p, 0 * each[1:], 0 * each[1:]),
            np.zeros(p - 1),
        ),
        (_symmetric_entry_rows(p, i, j), np.zeros(len(i))),
        (_symmetric_entry_rows(p, across[0], p + across[1]), np.eye(p).ravel()),
        (trace, np.array([float(p)])),
    ]
    if planar:
        i, j = p + 2 * np.array(np.triu_indices(p // 2))
        rows.append(
            (
                _symmetric_entry_rows(p, i, j) - _symmetric_entry_rows(p, i + 1, j + 1),
                np.zeros(len(i)),
            )
        )
        rows.append(
            (
                _symmetric_entry_rows(p, i, j + 1) + _symmetric_entry_rows(p, i + 1, j),
                np.zeros(len(i)),
            )
        )
    return rows


def _symmetric_entry_rows(p: int, i: Array, j: Array) -> csr_array:
    # Rows that pick (X_ij + X_ji)/2 out of X, so that everything stays symmetric.
    size, row = 2 * p, np.arange(len(i))
    at = (np.concatenate([row, row]), np.concatenate([i * size + j, j * size + i]))
    return csr_array((np.full(2 * len(i), 0.5), at), shape=(len(i), size * size))


def _non_edge_constraints(question: GainProblem, Q: Array) -> LinearConstraint:
    # The block of Q Z Qᵀ of a non-edge is zero: in the plane, its first column is.
    p, planar = Q.shape[1], np.iscomplexobj(question.kernel)
    i, j = _non_edges(question)
    first, second = (np.r_[2 * i, 2 * i + 1], np.r_[2 * j, 2 * j]) if planar else (i, j)
    outer = np.einsum("ea,eb->eab", Q[first], Q[second])
    within = [p + grid.ravel() for grid in np.indices((p, p))]
    dense = csr_array(((outer + outer.transpose(0, 2, 1)) / 2).reshape(len(first), p * p))
    return dense @ _symmetric_entry_rows(p, *within), np.zeros(len(first))


def _non_edges(question: GainProblem) -> tuple[Array, Array]:
    i, j = np.nonzero(np.triu(~question.graph, 1))
    return i, j


def _dual_matrix(y: Array, question: GainProblem) -> Array:
    i, j = _non_edges(question)
    Y = np.zeros(question.graph.shape, dtype=question.kernel.dtype)
    Y[i, j] = -(y[: len(i)] + 1j * y[len(i) :] if np.iscomplexobj(Y) else y)
    return Y + Y.conj().T


def _project_psd(W: Array) -> Array:
    λ, V = np.linalg.eigh((W + W.T) / 2)
    return np.asarray((V * np.maximum(λ, 0)) @ V.T)


def _to_real_blocks(Q: Array) -> Array:
    # Every entry a + jb as the block [a −b; b a].
    if not np.iscomplexobj(Q):
        return Q
    return np.kron(Q.real, np.eye(2)) + np.kron(Q.imag, np.array([[0, -1], [1, 0]]))


def _from_real_blocks(L: Array, question: GainProblem) -> Array:
    # And back.
    if not np.iscomplexobj(question.kernel):
        return L
    return np.asarray(L[::2, ::2] + L[1::2, 1::2] + 1j * (L[1::2, ::2] - L[::2, 1::2])) / 2
