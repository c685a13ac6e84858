"""Formation gains by the method of the paper, for comparison [Lusk2020, eq. 8 to 10]."""

from functools import partial
from typing import Annotated

import numpy as np
from annotated_types import Ge
from numpy import ndarray as Array
from scipy.linalg import block_diag
from scipy.sparse import csr_array, eye_array, vstack
from scipy.sparse.linalg import splu

from dynamics.doors import checked
from problems.gain_problem import GainProblem, GainSolution

ADMM_PENALTY = 1.0  # μ, as in the paper's code
REGULARIZATION = 1e-12  # makes the normal equations definite where constraints are redundant


@checked
def solve(
    problem: GainProblem,
    max_iterations: Annotated[int, Ge(1)] = 10,
    trace_tolerance: float = 0.1,
    change_tolerance: float = 1e-4,
) -> GainSolution:
    """Apply the alternating direction method to the dual of the paper's program [Wen2010].

        minimize ⟨C, X⟩  subject to  A(X) = b,  X ⪰ 0

        X = [γI I; I Z],  C = [I 0; 0 0],  so that X ⪰ 0 means Z ⪰ I/γ, and

        y ← (A A*)⁻¹ (A(C − S − μX) + μb)
        W ← C − A*(y) − μX
        S ← W without its negative eigenvalues
        X ← (S − W)/μ

    For the horizontal gains all matrices are real, of twice the size, and equations make Z
    consist of blocks [a −b; b a]. The eigenvalue problems are thus four times as large as
    necessary, with more constraints than the problem has.

    The default limits are those of the paper's code: at most 10 iterations, or a trace
    within 10 %, or changes of X that sum to less than the tolerance. That is far from the
    optimum, and the iterate is then projected onto the equations, where it may lose positivity.
    So these gains are slower than the optimum, and may be unstable on sparse graphs. Where no
    gains stabilize, there is no γ, and unstable gains are returned. The bound stays valid, but
    is loose. The method converges with `trace_tolerance=0` and thousands of iterations.

    Errata of the paper: the norm in (9) must be squared, the gains in Proposition 1 are
    −R Z Rᵀ, and the complete graph takes six iterations; only the projection takes one.

    L = Q Z Qᴴ is projected; the dual variables y of the non-edges are a matrix Y.
    """
    _ = problem.trace_direction  # raises where only matrices of trace 0 are left
    Q = _to_real_blocks(problem.complement)
    p = Q.shape[1]
    X = np.tile(np.eye(p), (2, 2))  # satisfies all but the non-edges, of which b is zero
    graph_free = _graph_free_constraints(p, np.iscomplexobj(problem.kernel))
    non_edges = _non_edge_constraints(problem, Q)
    A = vstack([graph_free, non_edges], format="csr")
    b = np.concatenate([graph_free @ X.ravel(), np.zeros(non_edges.shape[0])])
    normal = (A @ A.T + REGULARIZATION * eye_array(len(b))).tocsc()
    factor = splu(normal, permc_spec="MMD_AT_PLUS_A")

    C = block_diag(np.eye(p), np.zeros((p, p)))
    S, μ = np.zeros((2 * p, 2 * p)), ADMM_PENALTY
    for _ in range(max_iterations):
        y = factor.solve(A @ (C - S - μ * X).ravel() + μ * b)
        W = C - (A.T @ y).reshape(2 * p, 2 * p) - μ * X
        λ, V = np.linalg.eigh((W + W.T) / 2)
        S = (V * np.maximum(λ, 0)) @ V.T
        previous, X = X, (S - W) / μ
        trace_error = abs(X[p:, p:].trace() - p)
        change = np.abs(X - previous).sum()
        if trace_error <= trace_tolerance * p or change < change_tolerance:
            break
    L = problem.project(_from_real_blocks(Q @ X[p:, p:] @ Q.T, problem)).L
    return GainSolution(L, _dual_matrix(y[graph_free.shape[0] :], problem))


def _graph_free_constraints(p: int, planar: bool) -> csr_array:
    # The rows of A(X) = b that do not depend on the graph.
    k, (i, j) = np.arange(p), np.triu_indices(p, 1)
    block_row, block_column = np.indices((p, p)).reshape(2, -1)
    entries = partial(_symmetric_entry_rows, p)
    rows = [
        entries(k[1:], k[1:]) - entries(0 * k[1:], 0 * k[1:]),
        entries(i, j),
        entries(block_row, p + block_column),
        csr_array(np.ones((1, p))) @ entries(p + k, p + k),
    ]
    if planar:
        i, j = p + 2 * np.array(np.triu_indices(p // 2))
        rows.append(entries(i, j) - entries(i + 1, j + 1))
        rows.append(entries(i, j + 1) + entries(i + 1, j))
    return vstack(rows)


def _symmetric_entry_rows(p: int, i: Array, j: Array) -> csr_array:
    # Rows that select (X_ij + X_ji)/2, so that every iterate stays symmetric.
    size, row = 2 * p, np.arange(len(i))
    at = (np.concatenate([row, row]), np.concatenate([i * size + j, j * size + i]))
    return csr_array((np.full(2 * len(i), 0.5), at), shape=(len(i), size * size))


def _non_edge_constraints(problem: GainProblem, Q: Array) -> csr_array:
    # The block of Q Z Qᵀ of a non-edge is zero; of a planar block the first column suffices.
    p, planar = Q.shape[1], np.iscomplexobj(problem.kernel)
    i, j = problem.non_edges
    first, second = (np.r_[2 * i, 2 * i + 1], np.r_[2 * j, 2 * j]) if planar else (i, j)
    outer = np.einsum("ea,eb->eab", Q[first], Q[second])
    within = p + np.indices((p, p)).reshape(2, -1)
    dense = csr_array(((outer + outer.transpose(0, 2, 1)) / 2).reshape(len(first), p * p))
    return dense @ _symmetric_entry_rows(p, *within)


def _dual_matrix(y: Array, problem: GainProblem) -> Array:
    i, j = problem.non_edges
    Y = np.zeros(problem.graph.shape, dtype=problem.kernel.dtype)
    Y[i, j] = -(y[: len(i)] + 1j * y[len(i) :] if np.iscomplexobj(Y) else y)
    return Y + Y.conj().T


def _to_real_blocks(Q: Array) -> Array:
    # Write every entry a + jb as the block [a −b; b a].
    if not np.iscomplexobj(Q):
        return Q
    return np.kron(Q.real, np.eye(2)) + np.kron(Q.imag, np.array([[0, -1], [1, 0]]))


def _from_real_blocks(L: Array, problem: GainProblem) -> Array:
    # Average each block to the complex entry a + jb that it stands for.
    if not np.iscomplexobj(problem.kernel):
        return L
    return np.asarray(L[::2, ::2] + L[1::2, 1::2] + 1j * (L[1::2, ::2] - L[::2, 1::2])) / 2
