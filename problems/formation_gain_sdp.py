"""Gains by an interior-point method: the programme as it is stated, given to a general solver."""

from warnings import catch_warnings, filterwarnings

import numpy as np
from jaxtyping import Inexact
from numpy import ndarray as Array
from scipy.linalg import null_space

from problems.conic import Unsolved
from problems.gain_question import Question

TOLERANCE = 1e-5  # between the rate and its proven bound; a wider gap is no answer


def solve(question: Question) -> tuple[Inexact[Array, "n n"], Inexact[Array, "n n"]]:
    """The fastest gains and the proof that none are faster [Lusk2020, eq. 16].

        maximise    t
        subject to  Z − t I ⪰ 0,  tr Z = m
                    (Q Z Qᴴ)_ij = 0  at non-edges  : y_ij

    over Hermitian Z, real ones upwards; the columns of Q complete those of the kernel. This
    is the slow method that the others are measured with: the work grows with n⁶, seconds
    for 15 vehicles and minutes for 30.

    Returns:
        L = Q Z Qᴴ, projected so that it fits to rounding, and the matrix Y of the prices y,
        for which `question.bound(Y)` is the rate of L: less than zero where no gains of this
        graph stabilise.

    Raises:
        NoMatrix: Graph and kernel leave no matrix with a trace.
        Unsolved: The solver stopped too early; its rate and its bound are not one.
    """
    import cvxpy as cp

    L = question.project(np.eye(len(question.graph), dtype=question.kernel.dtype))
    apart = np.argwhere(np.triu(~question.graph, 1))
    if not len(apart):
        return L, np.zeros_like(L)  # nothing to decide, and I cannot be beaten

    Q, m = null_space(question.kernel.conj().T), question.m
    kind = "hermitian" if np.iscomplexobj(Q) else "symmetric"
    Z, t = cp.Variable((m, m), **{kind: True}), cp.Variable()
    i, j = apart.T
    absent = (Q @ Z @ Q.conj().T)[i, j] == 0
    limits = [Z - t * np.eye(m) >> 0, cp.trace(Z) == m, absent]
    problem = cp.Problem(cp.Maximize(t), limits)
    with catch_warnings():
        filterwarnings("ignore", "Solution may be inaccurate")  # judged below, by its proof
        problem.solve(solver=cp.CLARABEL, max_threads=1)
    if Z.value is None:
        raise Unsolved(question, f"Clarabel stopped without a point: {problem.status}")

    L = question.project(Q @ Z.value @ Q.conj().T)
    Y = np.zeros_like(L)
    Y[i, j] = absent.dual_value
    Y = (Y + Y.conj().T) / 2
    gap = question.bound(Y) - question.rate(L)
    if not gap <= TOLERANCE:
        raise Unsolved(
            question,
            f"Clarabel said {problem.status}, but its gains reach {question.rate(L):.6f} "
            f"and its proof allows {gap:.1e} more, above {TOLERANCE:.0e}",
        )
    return L, Y
