"""Known wrong results of solvers, and the project's own solver for transfers."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.sparse import csc_array

from problems.conic import ConicProgram, svec, verify
from problems.families import load_family
from problems.solvers import load_adapters

ADAPTERS = load_adapters()


@cache
def transfers(size="small"):
    """Transfers of one agent with the states eliminated; they differ in b alone."""
    return [instance.problem for instance in load_family("transfer-lp", size).instances]


def solve_and_verify(name, problem, tolerance=1e-6):
    result = ADAPTERS[name].open_session(problem, 1e-6).solve(problem.b)
    return verify(problem, result, tolerance)


INSTALLED = sorted(name for name, adapter in ADAPTERS.items() if adapter.is_installed)
FOR_TRANSFERS = [name for name in INSTALLED if not ADAPTERS[name].refusal(transfers()[0])]
SEMIDEFINITE = [name for name in INSTALLED if "semidefinite" in ADAPTERS[name].cone_types]


@pytest.mark.parametrize("name", FOR_TRANSFERS)
def test_reachable_targets_are_never_reported_infeasible(name):
    for problem in transfers()[:4]:
        verdict = solve_and_verify(name, problem)
        assert verdict.kind == "solved", verdict.reason


@pytest.mark.parametrize("name", FOR_TRANSFERS)
def test_an_unreachable_target_is_never_solved_and_leaves_no_trace(name):
    problem = transfers()[0]
    factor = np.where(np.arange(len(problem.b)) < problem.zero, 100.0, 1.0)
    far = replace(problem, b=factor * problem.b)
    session = ADAPTERS[name].open_session(problem, 1e-6)
    first = verify(problem, session.solve(problem.b), 1e-6).solution
    result = session.solve(far.b)
    certifies = ADAPTERS[name].certifies_infeasibility
    kinds = ("infeasible",) if certifies else ("unproven", "failed")
    assert result.status != "solved" and verify(far, result, 1e-6).kind in kinds
    again = verify(problem, session.solve(problem.b), 1e-6)
    assert again.kind == "solved", again.reason
    assert problem.q @ again.solution.x == pytest.approx(problem.q @ first.x, rel=1e-6)


@pytest.mark.parametrize("name", SEMIDEFINITE)
def test_matrices_of_several_orders_are_in_the_right_rows(rng, name):
    orders, n = (2, 4, 1), 5
    bases = [np.linalg.qr(rng.normal(size=(order, order)))[0] for order in orders]
    s = np.concatenate([svec(Q[:, :1] @ Q[:, :1].T) for Q in bases])
    y = np.concatenate([svec(Q[:, 1:] @ Q[:, 1:].T) for Q in bases])
    A, x = rng.normal(size=(len(s), n)), rng.normal(size=n)
    problem = ConicProgram(-A.T @ y, csc_array(A), A @ x + s, 0, 0, (), orders)
    verdict = solve_and_verify(name, problem)
    assert verdict.kind == "solved", verdict.reason
    assert problem.q @ verdict.solution.x == pytest.approx(problem.q @ x, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("size", ["small", "medium", "large"])
def test_the_own_dual_simplex_method_is_exact_on_transfers(size):
    for problem in transfers(size):
        verdict = solve_and_verify("batched", problem, 1e-12)
        assert verdict.kind == "solved", verdict.reason


def test_the_own_dual_simplex_method_refuses_every_other_form():
    problem = transfers()[0]
    q, A, b = problem.q, problem.A.toarray(), problem.b
    one = np.eye(len(b))[0] + np.eye(len(b))[-1]
    others = {
        "two prices": ConicProgram(q + np.arange(len(q)), csc_array(A), b, 4, len(b) - 4),
        "no price": ConicProgram(0 * q, csc_array(A), b, 4, len(b) - 4),
        "wider bounds": ConicProgram(q, csc_array(A), b + one, 4, len(b) - 4),
        "other rows": ConicProgram(q, csc_array(A + np.outer(one, q)), b, 4, len(b) - 4),
        "one bound less": ConicProgram(q, csc_array(A[:-1]), b[:-1], 4, len(b) - 5),
        "equal rows": ConicProgram(q, csc_array(A[[0, 0, *range(2, len(b))]]), b, 4, len(b) - 4),
        "no equations": ConicProgram(q, csc_array(A[4:]), b[4:], 0, len(b) - 4),
    }
    for what, other in others.items():
        assert ADAPTERS["batched"].refusal(other), what
        with pytest.raises(ValueError, match=r"batched takes only \[C −C\] z = b, 0 ≤ z ≤ 1"):
            ADAPTERS["batched"].open_session(other, 1e-6)
    session = ADAPTERS["batched"].open_session(problem, 1e-6)
    with pytest.raises(ValueError, match="only the right-hand side of the equations may change"):
        session.solve(2 * problem.b)
