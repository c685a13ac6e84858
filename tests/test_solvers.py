"""Every adapter, on questions whose answers are known; and what judges their claims."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csc_array

from problems.conic import ConicProgram, smat, svec
from problems.solvers import SolverAdapter, load_adapters
from problems.solvers.adapter import SolverResult, accept_all, verify

KNOWN = load_adapters()
# Who takes only problems of a form of their own is tried by itself.
INSTALLED = sorted(
    name
    for name, adapter in KNOWN.items()
    if adapter.is_installed and adapter.unsupported_reason is accept_all
)
KINDS = ("linear", "second-order", "semidefinite")


def known(rng, kind, n=8, zero=3, nonnegative=20):
    """A feasible problem with cones up to a kind, and its optimum: all conditions hold."""
    cones = () if kind == "linear" else (3, 4)
    matrices = (3,) if kind == "semidefinite" else ()
    rows = zero + nonnegative + sum(cones) + sum(k * (k + 1) // 2 for k in matrices)
    A, x = rng.normal(size=(rows, n)), rng.normal(size=n)
    s, y = np.zeros(rows), np.zeros(rows)
    y[:zero] = rng.normal(size=zero)
    tight = rng.random(nonnegative) < 0.4
    at = zero + nonnegative
    s[zero:at] = np.where(tight, 0, rng.uniform(0.5, 2, nonnegative))
    y[zero:at] = np.where(tight, rng.uniform(0.5, 2, nonnegative), 0)
    for size in cones:
        edge = rng.normal(size=size - 1)
        edge /= np.linalg.norm(edge)
        s[at : at + size], y[at : at + size] = [1.5, *(1.5 * edge)], [0.7, *(-0.7 * edge)]
        at += size
    for order in matrices:
        basis = np.linalg.qr(rng.normal(size=(order, order)))[0]
        size = order * (order + 1) // 2
        s[at : at + size] = svec(basis[:, :1] @ basis[:, :1].T)
        y[at : at + size] = svec(basis[:, 1:] @ basis[:, 1:].T)
        at += size
    return ConicProgram(-A.T @ y, csc_array(A), A @ x + s, zero, nonnegative, cones, matrices), x, y


def impossible(rng):
    """A side of a plane and the other, with room between, among other rows."""
    problem, x, _ = known(rng, "linear")
    along = rng.normal(size=8)
    A = np.vstack([problem.A.toarray(), along, -along])
    b = np.concatenate([problem.b, [along @ x - 1.0, -(along @ x)]])
    return ConicProgram(problem.q, csc_array(A), b, problem.zero, problem.nonnegative + 2)


def able(kind):
    """The solvers that can be asked about a kind of cones."""
    return [name for name in INSTALLED if kind in KNOWN[name].cone_types]


@pytest.mark.parametrize(("kind", "name"), [(kind, name) for kind in KINDS for name in able(kind)])
def test_what_a_solver_solves_is_the_optimum(rng, kind, name):
    for _ in range(5):
        problem, x, _ = known(rng, kind)
        verdict = verify(problem, KNOWN[name].open_session(problem, 1e-6).solve(problem.b), 1e-6)
        assert verdict.kind == "solved", verdict.reason
        assert problem.q @ verdict.solution.x == pytest.approx(problem.q @ x, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("name", INSTALLED)
def test_another_right_hand_side_is_answered_as_if_it_came_first(rng, name):
    kind = max((k for k in KINDS if k in KNOWN[name].cone_types), key=KINDS.index)
    problem, x, y = known(rng, kind)
    session = KNOWN[name].open_session(problem, 1e-6)
    for _ in range(4):
        b = problem.b + problem.A @ rng.normal(size=len(x))  # the same problem, moved
        verdict = verify(replace(problem, b=b), session.solve(b), 1e-6)
        assert verdict.kind == "solved", verdict.reason
        assert -b @ y == pytest.approx(problem.q @ verdict.solution.x, rel=1e-4, abs=1e-4)


@pytest.mark.parametrize("name", [n for n in INSTALLED if KNOWN[n].certifies_infeasibility])
def test_who_claims_to_find_out_that_there_is_no_point_proves_it(rng, name):
    problem = impossible(rng)
    verdict = verify(problem, KNOWN[name].open_session(problem, 1e-6).solve(problem.b), 1e-6)
    assert verdict.kind == "infeasible", verdict.reason


BOTTOMLESS = ConicProgram(np.ones(1), csc_array([[1.0]]), np.zeros(1), 0, 1)


@pytest.mark.parametrize("name", [n for n in INSTALLED if KNOWN[n].supports(BOTTOMLESS)])
def test_a_cost_without_a_bottom_is_neither_solved_nor_infeasible(name):
    claim = KNOWN[name].open_session(BOTTOMLESS, 1e-6).solve(BOTTOMLESS.b)
    assert claim.status != "infeasible", claim.message
    assert verify(BOTTOMLESS, claim, 1e-6).kind in ("failed", "wrong claim")


@pytest.mark.parametrize("name", INSTALLED)
def test_a_right_hand_side_that_is_written_over_is_another(rng, name):
    kind = max((k for k in KINDS if k in KNOWN[name].cone_types), key=KINDS.index)
    problem, _, _ = known(rng, kind)
    session, b = KNOWN[name].open_session(problem, 1e-6), problem.b.copy()
    session.solve(b)
    b += problem.A @ rng.normal(size=len(problem.q))
    verdict = verify(replace(problem, b=b), session.solve(b), 1e-6)
    assert verdict.kind == "solved", verdict.reason


def test_a_triangle_is_as_long_as_its_matrix(rng):
    for order in (1, 2, 5):
        M = rng.normal(size=(order, order))
        M = M + M.T
        assert np.linalg.norm(svec(M)) == pytest.approx(np.linalg.norm(M))
        np.testing.assert_allclose(smat(svec(M), order), M, atol=1e-14)


def test_a_matrix_out_of_its_cone_is_seen(rng):
    problem, x, _ = known(rng, "semidefinite")
    s = problem.b - problem.A @ x
    assert problem.cone_violation(s) < 1e-12
    s[-6:] = svec(np.diag([1.0, -0.25, 2.0]))
    assert problem.cone_violation(s) == pytest.approx(0.25)


def test_a_solver_is_believed_only_as_far_as_its_numbers_go(rng):
    problem, x, y = known(rng, "linear")

    def kind(said, x, y):
        return verify(problem, SolverResult(said, "words", x, y), 1e-6).kind

    assert kind("solved", x, y) == "solved"
    assert kind("stopped", x, y) == "solved"  # too modest
    assert kind("solved", x + 1e-3, y) == "wrong claim"
    assert kind("solved", x, None) == "wrong claim"
    assert kind("solved", x * np.nan, y) == "wrong claim"
    assert kind("stopped", x + 1e-3, y) == "failed"
    assert kind("infeasible", None, None) == "unproven"
    assert kind("infeasible", None, rng.normal(size=len(y))) == "wrong claim"


def test_a_solver_that_is_missing_says_what_installs_it(rng):
    problem, _, _ = known(rng, "linear")
    absent = SolverAdapter(
        "nobody",
        frozenset({"linear"}),
        False,
        "nobody_at_all",
        "nobody",
        lambda problem, tolerance: problem,
    )
    with pytest.raises(ValueError, match=r"nobody is not installed; pip install nobody would do"):
        absent.open_session(problem, 1e-6)


def test_a_solver_that_cannot_take_a_cone_says_so(rng):
    problem, _, _ = known(rng, "second-order")
    with pytest.raises(ValueError, match=r"highs cannot take second-order cones"):
        KNOWN["highs"].open_session(problem, 1e-6)
