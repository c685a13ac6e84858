"""Gains by an interior-point method: the programme as it is stated, given to a general solver."""

from warnings import catch_warnings, filterwarnings

import numpy as np
from scipy.linalg import null_space

from problems.conic import Unsolved
from problems.gain_problem import GainProblem, GainSolution

RATE_TOLERANCE = 1e-5  # between the rate and its proven bound, relative where the rate is above 1


def solve(question: GainProblem) -> GainSolution:
    """The fastest gains and the proof that none are faster [Lusk2020, eq. 16].

        maximise    t
        subject to  Z − t I ⪰ 0,  tr Z = m
                    (Q Z Qᴴ)_ij = 0  at non-edges  : y_ij

    over Hermitian Z, real ones upwards; the columns of Q complete those of the kernel. This
    is the slow method that the others are measured with: 1 s for 20 vehicles, a minute for
    50, and the work grows with n⁶.

    Returns:
        L = Q Z Qᴴ, projected so that it fits to rounding, and the matrix Y of the prices y,
        for which `question.bound(Y)` is the rate of L: less than zero where no gains of this
        graph stabilise.

    Raises:
        NoMatrix: Graph and kernel leave no matrix with a trace.
        Unsolved: The solver stopped too early; its rate and its bound are not one.
    """
    import cvxpy as cp

    question.project(np.eye(len(question.graph), dtype=question.kernel.dtype))
    Q, m = null_space(question.kernel.conj().T), question.m
    kind = "hermitian" if np.iscomplexobj(Q) else "symmetric"
    Z, t = cp.Variable((m, m), **{kind: True}), cp.Variable()
    i, j = np.nonzero(np.triu(~question.graph, 1))
    limits = [Z - t * np.eye(m) >> 0, cp.trace(Z) == m]
    if len(i):
        limits.append((Q @ Z @ Q.conj().T)[i, j] == 0)
    problem = cp.Problem(cp.Maximize(t), limits)
    with catch_warnings():
        filterwarnings("ignore", "Solution may be inaccurate")  # judged below, by its proof
        problem.solve(solver=cp.CLARABEL, max_threads=1)
    if Z.value is None:
        raise Unsolved(question, f"Clarabel stopped without a point: {problem.status}")

    L = question.project(Q @ Z.value @ Q.conj().T)
    Y = np.zeros_like(L)
    if len(i):
        Y[i, j] = limits[-1].dual_value
    Y = (Y + Y.conj().T) / 2
    rate, bound = question.convergence_rate(L), question.rate_bound(Y)
    if not bound - rate <= RATE_TOLERANCE * max(1, abs(rate)):
        raise Unsolved(
            question,
            f"Clarabel said {problem.status}, but its gains reach {rate:.6f} and its proof "
            f"allows {bound - rate:.1e} more, above {RATE_TOLERANCE:.0e}",
        )
    return GainSolution(L, Y)
