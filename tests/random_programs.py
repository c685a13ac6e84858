"""Random conic programs whose optimum, or infeasibility, is known by construction."""

import numpy as np
from scipy.sparse import csc_array

from problems.conic import ConicProgram, svec


def random_program(rng, kind="linear", n=8, zero=3, nonnegative=20, rank=0):
    """Draw a feasible program with cones up to a kind, and its optimal x and y.

    The cost is linear, or quadratic with a matrix of some rank.
    """
    soc = () if kind == "linear" else (3, 4)
    psd = (3,) if kind == "semidefinite" else ()
    count = zero + nonnegative + sum(soc) + sum(k * (k + 1) // 2 for k in psd)
    A, x = rng.normal(size=(count, n)), rng.normal(size=n)
    problem = ConicProgram(np.zeros(n), csc_array(A), np.zeros(count), zero, nonnegative, soc, psd)
    s, y = np.zeros(count), np.zeros(count)
    y[:zero] = rng.normal(size=zero)
    is_active = rng.random(nonnegative) < 0.4
    linear = slice(zero, zero + nonnegative)
    s[linear] = np.where(is_active, 0, rng.uniform(0.5, 2, nonnegative))
    y[linear] = np.where(is_active, rng.uniform(0.5, 2, nonnegative), 0)
    for rows in problem.soc_rows:
        edge = rng.normal(size=rows.stop - rows.start - 1)
        edge /= np.linalg.norm(edge)
        s[rows], y[rows] = [1.5, *(1.5 * edge)], [0.7, *(-0.7 * edge)]
    for order, rows in zip(psd, problem.psd_rows, strict=True):
        basis = np.linalg.qr(rng.normal(size=(order, order)))[0]
        s[rows] = svec(basis[:, :1] @ basis[:, :1].T)
        y[rows] = svec(basis[:, 1:] @ basis[:, 1:].T)
    M = rng.normal(size=(rank, n))
    q, P = -A.T @ y - M.T @ (M @ x), csc_array(np.triu(M.T @ M)) if rank else None
    return ConicProgram(q, problem.A, A @ x + s, zero, nonnegative, soc, psd, P), x, y


def infeasible_program(rng):
    """Draw a program with two contradictory half-spaces among its rows."""
    problem, x, _ = random_program(rng)
    normal = rng.normal(size=8)
    A = np.vstack([problem.A.toarray(), normal, -normal])
    b = np.concatenate([problem.b, [normal @ x - 1.0, -(normal @ x)]])
    return ConicProgram(problem.q, csc_array(A), b, problem.zero, problem.nonnegative + 2)
