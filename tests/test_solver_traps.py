"""What solvers are known to get wrong, and that the toolkit does not fall for it."""

from dataclasses import replace
from functools import cache

import numpy as np
import osqp
import pytest
from scipy.sparse import csc_array, csc_matrix

from problems.conic import ConicProgram, svec
from problems.families import load_family
from problems.solvers import load_adapters
from problems.solvers.adapter import SolverResult, verify
from problems.solvers.rows import lower_bounds

KNOWN = load_adapters()


@cache
def transfers(size="small"):
    """Transfers of one agent, without their states, which share all but their ends."""
    return [instance.problem for instance in load_family("transfer-lp", size).instances]


def out_of_reach(problem):
    """A hundred times as far as a problem asks for."""
    far = np.where(np.arange(len(problem.b)) < problem.zero, 100.0, 1.0)
    return replace(problem, b=far * problem.b)


ABLE = sorted(
    name
    for name, adapter in KNOWN.items()
    if adapter.is_installed and adapter.supports(transfers()[0])
)
SEMIDEFINITE = sorted(
    name
    for name, adapter in KNOWN.items()
    if adapter.is_installed and "semidefinite" in adapter.cone_types
)


@pytest.mark.parametrize("problem", transfers("medium")[:5])
def test_osqp_as_it_comes_says_solved_too_early_and_is_not_believed(problem):
    solver, n = osqp.OSQP(), len(problem.q)
    solver.setup(
        P=csc_matrix((n, n)),
        q=problem.q,
        A=csc_matrix(problem.A),
        l=lower_bounds(problem.b, problem.zero),
        u=problem.b,
        verbose=False,
    )
    result = solver.solve(raise_error=False)
    assert result.info.status_val == osqp.SolverStatus.OSQP_SOLVED
    verdict = verify(problem, SolverResult("solved", "as it comes", result.x, result.y), 1e-6)
    assert verdict.kind == "wrong claim"
    assert verdict.solution.max_residual > 1e-4


@pytest.mark.parametrize("problem", transfers("medium")[:5])
def test_osqp_as_the_toolkit_asks_it_is_right(problem):
    claim = KNOWN["osqp"].open_session(problem, 1e-6).solve(problem.b)
    assert verify(problem, claim, 1e-6).kind == "solved"


def test_one_nan_anywhere_is_no_answer():
    problem = transfers()[0]
    claim = KNOWN["clarabel"].open_session(problem, 1e-6).solve(problem.b)
    for field in ("x", "y"):
        for place in (0, -1):
            numbers = getattr(claim, field).copy()
            numbers[place] = np.nan
            assert verify(problem, claim._replace(**{field: numbers}), 1e-6).kind == "wrong claim"


def test_a_ray_of_nan_proves_nothing():
    problem = transfers()[0]
    ray = np.full(len(problem.b), np.nan)
    assert verify(problem, SolverResult("infeasible", "so", None, ray), 1e-6).kind == "wrong claim"


@pytest.mark.parametrize("name", ABLE)
def test_what_is_in_reach_is_never_called_out_of_reach(name):
    for problem in transfers()[:4]:
        claim = KNOWN[name].open_session(problem, 1e-6).solve(problem.b)
        verdict = verify(problem, claim, 1e-6)
        assert verdict.kind == "solved", verdict.reason


@pytest.mark.parametrize("name", ABLE)
def test_what_is_out_of_reach_is_never_called_solved_and_leaves_no_trace(name):
    problem = transfers()[0]
    far, session = out_of_reach(problem), KNOWN[name].open_session(problem, 1e-6)
    first = verify(problem, session.solve(problem.b), 1e-6).solution
    claim = session.solve(far.b)
    kinds = ("infeasible",) if KNOWN[name].certifies_infeasibility else ("unproven", "failed")
    assert claim.status != "solved" and verify(far, claim, 1e-6).kind in kinds
    again = verify(problem, session.solve(problem.b), 1e-6)
    assert again.kind == "solved", again.reason
    assert problem.q @ again.solution.x == pytest.approx(problem.q @ first.x, rel=1e-6)


@pytest.mark.parametrize("name", SEMIDEFINITE)
def test_matrices_of_several_orders_stand_in_the_right_rows(rng, name):
    orders, n = (2, 4, 1), 5
    bases = [np.linalg.qr(rng.normal(size=(order, order)))[0] for order in orders]
    s = np.concatenate([svec(Q[:, :1] @ Q[:, :1].T) for Q in bases])
    y = np.concatenate([svec(Q[:, 1:] @ Q[:, 1:].T) for Q in bases])
    A, x = rng.normal(size=(len(s), n)), rng.normal(size=n)
    problem = ConicProgram(-A.T @ y, csc_array(A), A @ x + s, 0, 0, (), orders)
    verdict = verify(problem, KNOWN[name].open_session(problem, 1e-6).solve(problem.b), 1e-6)
    assert verdict.kind == "solved", verdict.reason
    assert problem.q @ verdict.solution.x == pytest.approx(problem.q @ x, rel=1e-5, abs=1e-5)


@pytest.mark.parametrize("size", ["small", "medium", "large"])
def test_the_projects_own_way_is_exact_where_it_is_at_home(size):
    for problem in transfers(size):
        claim = KNOWN["batched"].open_session(problem, 1e-6).solve(problem.b)
        verdict = verify(problem, claim, 1e-12)
        assert verdict.kind == "solved", verdict.reason


def test_the_projects_own_way_refuses_every_other_form():
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
        assert not KNOWN["batched"].supports(other), what
        with pytest.raises(ValueError, match=r"batched takes only \[C −C\] z = b, 0 ≤ z ≤ 1"):
            KNOWN["batched"].open_session(other, 1e-6)


def test_the_projects_own_way_keeps_its_bounds():
    problem = transfers()[0]
    with pytest.raises(ValueError, match=r"only the right-hand side of the equations may change"):
        KNOWN["batched"].open_session(problem, 1e-6).solve(2 * problem.b)
