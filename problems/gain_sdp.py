"""Formation gains by semidefinite programming: the program as stated, with a general solver."""

from warnings import catch_warnings, filterwarnings

import numpy as np

from problems.conic import Unsolved
from problems.gain_problem import GainProblem, GainSolution

RATE_TOLERANCE = 1e-5  # between the rate and its proven bound, relative where the rate is above 1


def solve(problem: GainProblem) -> GainSolution:
    """Find the fastest gains and the proof that none are faster [Lusk2020, eq. 16].

        maximize    t
        subject to  Z − t I ⪰ 0,  tr Z = m
                    (Q Z Qᴴ)_ij = 0  at non-edges  : y_ij

    over Hermitian Z, real for the vertical gains; the columns of Q span the complement of
    the kernel. This slow method is the reference for the others: 1 s for 20 agents, a
    minute for 50, growing with n⁶.

    L = Q Z Qᴴ is projected to satisfy the equations to rounding. The `rate_bound` of the matrix Y
    of the dual variables y equals the rate of L, and is negative where no gains of this graph
    stabilize.
    """
    import cvxpy as cp

    _ = problem.trace_direction  # raises where only matrices of trace 0 are left
    Q, m = problem.complement, problem.m
    kind = "hermitian" if np.iscomplexobj(Q) else "symmetric"
    Z, t = cp.Variable((m, m), **{kind: True}), cp.Variable()
    i, j = problem.non_edges
    constraints = [Z - t * np.eye(m) >> 0, cp.trace(Z) == m]
    if len(i):
        constraints.append((Q @ Z @ Q.conj().T)[i, j] == 0)
    program = cp.Problem(cp.Maximize(t), constraints)
    with catch_warnings():
        filterwarnings("ignore", "Solution may be inaccurate")  # the bound below decides
        try:
            program.solve(solver=cp.CLARABEL, max_threads=1)
        except cp.error.SolverError as error:
            raise Unsolved(problem, "Clarabel failed, at the limits of its numbers") from error
    if Z.value is None:
        raise Unsolved(problem, f"Clarabel stopped without a point: {program.status}")

    L = problem.project(Q @ Z.value @ Q.conj().T).L
    Y = np.zeros_like(L)
    if len(i):
        Y[i, j] = constraints[-1].dual_value
    Y = (Y + Y.conj().T) / 2
    rate, bound = problem.convergence_rate(L), problem.rate_bound(Y)
    if not bound - rate <= RATE_TOLERANCE * max(1, abs(rate)):
        gap = f"higher by {bound - rate:.1e}, above the tolerance of {RATE_TOLERANCE:.0e}"
        found = f"the rate is {rate:.6f} and its bound is {gap}"
        raise Unsolved(problem, f"Clarabel reported {program.status}, but {found}")
    return GainSolution(L, Y)
