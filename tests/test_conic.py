"""Verification of solutions and certificates, whatever the solver reports."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from random_programs import infeasible_program, random_program
from scipy.sparse import csc_array

from problems.conic import (
    ConicProgram,
    ConicSolution,
    Infeasible,
    SolverResult,
    Unsolved,
    smat,
    solve,
    svec,
    verify,
    verify_ray,
)
from problems.solvers import solve_clarabel, solve_highs
from problems.solvers.clarabel import ClarabelSession


def reporting(status, x, y):
    """Make a solver that reports the same for every program."""
    return lambda problem: SolverResult(status, "message", x, y)


def test_the_known_optimum_has_no_residuals(rng):
    problem, x, y = random_program(rng, "second-order")
    assert ConicSolution.evaluate(problem, x, y).max_residual < 1e-13
    assert_array_equal(solve(problem, reporting("solved", x, y)).x, x)


def test_residuals_and_gap_follow_their_definition(rng):
    problem, x, y = random_program(rng)
    x, y = x + rng.normal(size=8), y + rng.normal(size=23)
    found = ConicSolution.evaluate(problem, x, y)
    s = problem.b - problem.A @ x
    primal = max(np.abs(s[:3]).max(), -s[3:].min())
    assert found.primal_residual == pytest.approx(primal / (1 + np.abs(problem.b).max()))
    dual = max(np.abs(problem.q + problem.A.T @ y).max(), -y[3:].min())
    assert found.dual_residual == pytest.approx(dual / (1 + np.abs(problem.q).max()))
    value = problem.q @ x
    assert found.gap == pytest.approx(abs(value + problem.b @ y) / (1 + abs(value)))


@pytest.mark.parametrize("kind", ["linear", "second-order", "semidefinite"])
@pytest.mark.parametrize("rank", [2, 8])
def test_quadratic_costs_are_judged_by_their_gradient_and_gap(rng, kind, rank):
    problem, x, y = random_program(rng, kind, rank=rank)
    assert ConicSolution.evaluate(problem, x, y).max_residual < 1e-12
    x, y = x + rng.normal(size=8), y + rng.normal(size=len(y))
    found, P = ConicSolution.evaluate(problem, x, y), problem.P.toarray()
    P = P + np.triu(P, 1).T
    assert problem.cost(x) == pytest.approx(x @ P @ x / 2 + problem.q @ x)
    gap = x @ P @ x + problem.q @ x + problem.b @ y
    assert found.gap == pytest.approx(abs(gap) / (1 + abs(problem.cost(x))))
    stationary = np.abs(P @ x + problem.q + problem.A.T @ y).max()
    dual = max(stationary, problem.cone_violation(y, dual=True))
    assert found.dual_residual == pytest.approx(dual / (1 + np.abs(problem.q).max()))


def test_infeasibility_does_not_depend_on_the_cost(rng):
    problem = infeasible_program(rng)
    problem = replace(problem, P=csc_array(np.eye(8)))
    with pytest.raises(Infeasible) as verdict:
        solve(problem, solve_clarabel)
    assert problem.b @ verdict.value.ray == pytest.approx(-1)


@pytest.mark.parametrize("row", [0, 5, 24], ids=["equation", "inequality", "cone"])
def test_a_violated_row_is_in_the_primal_residual(rng, row):
    problem, x, y = random_program(rng, "second-order")
    b = problem.b.copy()
    b[row] -= 10.0
    assert ConicSolution.evaluate(replace(problem, b=b), x, y).primal_residual > 0.1


def test_an_indefinite_matrix_violates_its_cone(rng):
    problem, x, _ = random_program(rng, "semidefinite")
    s = problem.b - problem.A @ x
    assert problem.cone_violation(s) < 1e-12
    s[-6:] = svec(np.diag([1.0, -0.25, 2.0]))
    assert problem.cone_violation(s) == pytest.approx(0.25)


def test_packing_a_matrix_keeps_its_norm(rng):
    for order in (1, 2, 5):
        M = rng.normal(size=(order, order))
        M = M + M.T
        assert np.linalg.norm(svec(M)) == pytest.approx(np.linalg.norm(M))
        assert_allclose(smat(svec(M)), M, atol=1e-14)


def test_verdicts_follow_the_numbers_and_not_the_status(rng):
    problem, x, y = random_program(rng)

    def kind(status, x, y):
        return verify(problem, SolverResult(status, "message", x, y), 1e-6).kind

    assert kind("solved", x, y) == "solved"
    assert kind("stopped", x, y) == "solved"
    assert kind("solved", x + 1e-3, y) == "wrong claim"
    assert kind("solved", x, None) == "wrong claim"
    assert kind("stopped", x + 1e-3, y) == "failed"
    assert kind("infeasible", None, None) == "unproven"
    assert kind("infeasible", None, rng.normal(size=len(y))) == "unproven"


def test_wrong_points_and_wrong_duals_are_refused(rng):
    problem, x, y = random_program(rng)
    with pytest.raises(Unsolved, match=r"solved .*, but the primal residual is") as refusal:
        solve(problem, reporting("solved", x + 1e-3, y))
    assert refusal.value.problem is problem
    found = ConicSolution.evaluate(problem, x, y + 1e-3)
    assert found.primal_residual < 1e-12 and found.dual_residual > 1e-4
    with pytest.raises(Unsolved, match=r"the dual residual \d\.\de-0[34]"):
        solve(problem, reporting("solved", x, y + 1e-3))


def test_a_feasible_pair_with_a_gap_is_refused():
    # min x, x ≥ 0: x = 1 and y = 1 are feasible, and not optimal together.
    problem = ConicProgram(np.ones(1), csc_array([[-1.0]]), np.zeros(1), 0, 1)
    found = ConicSolution.evaluate(problem, np.ones(1), np.ones(1))
    assert found.primal_residual == found.dual_residual == 0
    with pytest.raises(Unsolved, match=r"gap 5\.0e-01"):
        solve(problem, reporting("solved", np.ones(1), np.ones(1)))


@pytest.mark.parametrize("where", ["x", "y"])
@pytest.mark.parametrize("index", [0, -1])
@pytest.mark.parametrize("zero", [0, 3])
def test_a_single_nan_is_refused(rng, where, index, zero):
    problem, x, y = random_program(rng, "second-order", zero=zero)
    (x if where == "x" else y)[index] = np.nan
    assert np.isnan(ConicSolution.evaluate(problem, x, y).max_residual)
    with pytest.raises(Unsolved, match="nan"):
        solve(problem, reporting("solved", x, y))


@pytest.mark.parametrize("solver", [solve_clarabel, solve_highs])
def test_infeasible_programs_come_with_a_certificate(rng, solver):
    for _ in range(10):
        problem = infeasible_program(rng)
        with pytest.raises(Infeasible) as verdict:
            solve(problem, solver)
        y = verdict.value.ray
        assert verdict.value.problem is problem
        assert problem.b @ y == pytest.approx(-1)
        assert np.abs(problem.A.T @ y).max() < 1e-7
        assert y[problem.zero :].min() > -1e-7


def test_infeasible_cones_come_with_a_certificate():
    # ‖(x, 2)‖ ≤ 1.
    A, b = np.array([[0.0], [-1.0], [0.0]]), np.array([1.0, 0.0, 2.0])
    problem = ConicProgram(np.ones(1), csc_array(A), b, 0, 0, (3,))
    with pytest.raises(Infeasible) as verdict:
        solve(problem, solve_clarabel)
    assert problem.cone_violation(verdict.value.ray, dual=True) < 1e-7


def test_a_ray_slightly_outside_the_dual_cone_certifies_nothing():
    # x ≥ 0 and 0 x ≤ 1000: a violation of 0.001 times the slack of 1000 looks like a certificate.
    problem = ConicProgram(np.ones(1), csc_array([[-1.0], [0.0]]), np.array([0.0, 1000.0]), 0, 2)
    y, objection = verify_ray(problem, np.array([0.0, -1e-3]))
    assert "no certificate" in objection
    assert problem.cone_violation(y, dual=True) == 0


def test_false_certificates_of_infeasibility_are_refused(rng):
    problem, _, y = random_program(rng)
    with pytest.raises(Unsolved, match="without a certificate") as refusal:
        solve(problem, reporting("infeasible", None, None))
    assert not isinstance(refusal.value, Infeasible)
    against = -np.sign(problem.b @ y) * y
    for ray, why in ((-against, "no certificate"), (against, "leaves"), (y * np.nan, "no cert")):
        with pytest.raises(Unsolved, match=why) as refusal:
            solve(problem, reporting("infeasible", None, ray))
        assert not isinstance(refusal.value, Infeasible)


@pytest.mark.parametrize("kind", ["linear", "second-order", "semidefinite"])
def test_moving_into_the_dual_cone_leaves_its_points_in_place(rng, kind):
    problem, _, y = random_program(rng, kind)
    for point in rng.normal(size=(20, len(y))):
        moved = problem.move_into_dual_cone(point)
        assert problem.cone_violation(moved, dual=True) < 1e-14
        assert_allclose(problem.move_into_dual_cone(moved), moved, atol=1e-14)
        assert_array_equal(moved[:3], point[:3])


def test_clarabel_session_results_do_not_depend_on_order(rng):
    first, _, _ = random_program(rng, "second-order")
    session = ClarabelSession(first, 1e-8)
    asked = [replace(first, b=first.b + 0.1 * rng.random(len(first.b))) for _ in range(6)]
    forwards = [session.solve(problem.b).x for problem in asked]
    backwards = [session.solve(problem.b).x for problem in asked[::-1]][::-1]
    assert_array_equal(forwards, backwards)
    for problem, x in zip(asked, forwards, strict=True):
        assert_allclose(x, solve(problem, solve_clarabel).x, atol=1e-5)


@pytest.mark.parametrize("wrong", [{"nonnegative": -1}, {"soc_sizes": (0,)}, {"psd_orders": (0,)}])
def test_a_cone_without_rows_is_refused(wrong):
    with pytest.raises(ValueError, match=r"at least [01]"):
        ConicProgram(
            np.ones(1), csc_array((2, 1)), np.zeros(2), **({"zero": 2, "nonnegative": 0} | wrong)
        )


def test_rows_outside_every_cone_are_refused():
    with pytest.raises(ValueError, match="the cones have 3 rows"):
        ConicProgram(np.ones(2), csc_array(np.ones((2, 2))), np.ones(2), 1, 2)


@pytest.mark.parametrize("P", [np.diag([1.0, -0.25]), np.array([[1.0, 2.0], [0, 1.0]])])
def test_a_cost_that_is_not_convex_is_refused(P):
    least = np.linalg.eigvalsh(P, UPLO="U")[0]
    with pytest.raises(ValueError, match=f"positive semidefinite.*eigenvalue is {least:.3g}"):
        program(P=csc_array(P))


def test_a_cost_below_the_diagonal_or_not_finite_is_refused():
    with pytest.raises(ValueError, match=r"upper triangle, 2 × 2, got .* 1 entries below"):
        program(P=csc_array(np.ones((2, 2))))
    with pytest.raises(ValueError, match="P must be finite"):
        program(P=csc_array(np.diag([1.0, np.nan])))


def test_unsorted_and_repeated_entries_are_added_up_at_once():
    entries = np.array([1.0, 2.0, 3.0, 4.0]), np.array([1, 0, 1, 1]), np.array([0, 3, 4])
    A = csc_array(entries, shape=(2, 2))
    found = program(A=A, P=csc_array((entries[0], [0, 0, 1, 1], [0, 2, 4]), shape=(2, 2)))
    for matrix, expected in ((found.A, [[2, 0], [4, 4]]), (found.P, [[3, 0], [0, 7]])):
        assert matrix.has_canonical_format
        assert_array_equal(matrix.toarray(), expected)
    assert A.nnz == 4  # the caller's matrix is left as it was
    assert replace(found, b=np.zeros(2)).A is found.A


def program(**parts):
    """Make a program of two inequalities."""
    given = {"q": np.ones(2), "A": csc_array(np.ones((2, 2))), "b": np.ones(2)}
    return ConicProgram(**given | {"zero": 0, "nonnegative": 2} | parts)


@pytest.mark.parametrize("name", ["q", "A", "b"])
def test_data_that_is_not_finite_is_refused(name):
    parts = {"q": np.ones(2), "A": np.ones((2, 2)), "b": np.ones(2)}
    parts[name] = parts[name] * np.inf
    with pytest.raises(ValueError, match=f"^{name}: must be|{name} must be finite"):
        ConicProgram(parts["q"], csc_array(parts["A"]), parts["b"], 0, 2)
