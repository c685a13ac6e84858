"""Nothing is solved because a solver says so."""

import numpy as np
import pytest
from scipy.sparse import csc_array

from problems.conic import ConicProgram, ConicSolution, Infeasible, Unsolved, solve, verify_ray
from problems.solvers import solve_clarabel, solve_highs
from problems.solvers.clarabel import ClarabelSession

both = pytest.mark.parametrize("solver", [solve_clarabel, solve_highs])


def programme(rng, n=8, zero=3, nonnegative=20, cones=()):
    """A feasible programme with a known optimum: (x, y) satisfies every condition."""
    rows = zero + nonnegative + sum(cones)
    A, x = rng.normal(size=(rows, n)), rng.normal(size=n)
    s, y = np.zeros(rows), np.zeros(rows)
    y[:zero] = rng.normal(size=zero)
    tight = rng.random(nonnegative) < 0.4
    s[zero : zero + nonnegative] = np.where(tight, 0, rng.uniform(0.5, 2, nonnegative))
    y[zero : zero + nonnegative] = np.where(tight, rng.uniform(0.5, 2, nonnegative), 0)
    at = zero + nonnegative
    for size in cones:
        edge = rng.normal(size=size - 1)
        edge /= np.linalg.norm(edge)
        s[at : at + size], y[at : at + size] = [1.5, *(1.5 * edge)], [0.7, *(-0.7 * edge)]
        at += size
    return ConicProgram(-A.T @ y, csc_array(A), A @ x + s, zero, nonnegative, cones), x, y


def impossible(rng):
    """One side of a plane and the other, with room between, among other rows."""
    problem, x, _ = programme(rng)
    along = rng.normal(size=8)
    A = np.vstack([problem.A.toarray(), along, -along])
    b = np.concatenate([problem.b, [along @ x - 1.0, -(along @ x)]])
    return ConicProgram(problem.q, csc_array(A), b, problem.zero, problem.nonnegative + 2)


def says(answer):
    """A solver that answers the same whatever it is asked."""
    return lambda problem: answer


def test_the_truth_has_no_residuals(rng):
    problem, x, y = programme(rng, cones=(3, 4))
    answer = ConicSolution.evaluate(problem, x, y)
    assert answer.max_residual < 1e-13
    assert solve(problem, says(answer)) is answer


def test_residuals_and_gap_are_those_of_the_definition(rng):
    problem, x, y = programme(rng)
    x, y = x + rng.normal(size=8), y + rng.normal(size=23)
    answer = ConicSolution.evaluate(problem, x, y)
    s = problem.b - problem.A @ x
    broken = max(np.abs(s[:3]).max(), -s[3:].min())
    assert answer.primal_residual == pytest.approx(broken / (1 + np.abs(problem.b).max()))
    stray = max(np.abs(problem.q + problem.A.T @ y).max(), -y[3:].min())
    assert answer.dual_residual == pytest.approx(stray / (1 + np.abs(problem.q).max()))
    value = problem.q @ x
    assert answer.gap == pytest.approx(abs(value + problem.b @ y) / (1 + abs(value)))


@pytest.mark.parametrize("row", [0, 5, 24], ids=["equation", "inequality", "cone"])
def test_a_row_out_of_its_cone_is_seen(rng, row):
    problem, x, y = programme(rng, cones=(3,))
    b = problem.b.copy()
    b[row] -= 10.0
    broken = ConicProgram(
        problem.q, problem.A, b, problem.zero, problem.nonnegative, problem.soc_sizes
    )
    assert ConicSolution.evaluate(broken, x, y).primal_residual > 0.1


def test_a_wrong_point_called_solved_is_refused(rng):
    problem, x, y = programme(rng)
    with pytest.raises(Unsolved, match=r"said solved, but the primal residual is") as refusal:
        solve(problem, says(ConicSolution.evaluate(problem, x + 1e-3, y)))
    assert refusal.value.problem is problem


def test_wrong_duals_called_solved_are_refused(rng):
    problem, x, y = programme(rng)
    answer = ConicSolution.evaluate(problem, x, y + 1e-3)
    assert answer.primal_residual < 1e-12
    assert answer.dual_residual > 1e-4
    with pytest.raises(Unsolved, match=r"the dual residual \d\.\de-0[34]"):
        solve(problem, says(answer))


def test_a_feasible_pair_with_a_gap_is_refused():
    # min x, x ≥ 0: x = 1 and y = 1 break nothing, and are not optimal together.
    problem = ConicProgram(np.ones(1), csc_array([[-1.0]]), np.zeros(1), 0, 1)
    answer = ConicSolution.evaluate(problem, np.ones(1), np.ones(1))
    assert answer.primal_residual == answer.dual_residual == 0
    with pytest.raises(Unsolved, match=r"gap 5\.0e-01"):
        solve(problem, says(answer))


@pytest.mark.parametrize("where", ["x", "y"])
@pytest.mark.parametrize("zero", [0, 3])
def test_an_answer_that_is_no_number_is_refused(rng, where, zero):
    problem, x, y = programme(rng, zero=zero, cones=(3,))
    (x if where == "x" else y)[-1] = np.nan
    answer = ConicSolution.evaluate(problem, x, y)
    assert np.isnan(answer.max_residual)
    with pytest.raises(Unsolved, match="nan"):
        solve(problem, says(answer))


@both
def test_solvers_find_the_optimum_that_was_built_in(rng, solver):
    for _ in range(20):
        problem, x, _ = programme(rng)
        answer = solve(problem, solver)
        assert answer.max_residual < 1e-7
        assert problem.q @ answer.x == pytest.approx(problem.q @ x, abs=1e-6)


def test_clarabel_finds_it_among_cones_too(rng):
    for _ in range(20):
        problem, x, _ = programme(rng, cones=(3, 3, 4))
        assert problem.q @ solve(problem, solve_clarabel).x == pytest.approx(
            problem.q @ x, abs=1e-6
        )


@both
def test_what_is_impossible_comes_with_its_proof(rng, solver):
    for _ in range(10):
        problem = impossible(rng)
        with pytest.raises(Infeasible) as verdict:
            solve(problem, solver)
        y = verdict.value.ray
        assert verdict.value.problem is problem
        assert problem.b @ y == pytest.approx(-1)
        assert np.abs(problem.A.T @ y).max() < 1e-7
        assert y[problem.zero :].min() > -1e-7


def test_impossible_among_cones_comes_with_its_proof():
    # ‖(x, 2)‖ ≤ 1.
    A, b = np.array([[0.0], [-1.0], [0.0]]), np.array([1.0, 0.0, 2.0])
    problem = ConicProgram(np.ones(1), csc_array(A), b, 0, 0, (3,))
    with pytest.raises(Infeasible) as verdict:
        solve(problem, solve_clarabel)
    assert problem.cone_violation(verdict.value.ray, dual=True) < 1e-7


def test_a_ray_that_leaves_the_dual_cone_a_little_proves_nothing():
    # x ≥ 0 and 0 x ≤ 1000: a thousandth outside, times the room of 1000, would be a proof.
    problem = ConicProgram(np.ones(1), csc_array([[-1.0], [0.0]]), np.array([0.0, 1000.0]), 0, 2)
    y, doubt = verify_ray(problem, np.array([0.0, -1e-3]))
    assert "nothing" in doubt
    assert problem.cone_violation(y, dual=True) == 0


@pytest.mark.parametrize("kind", ["linear", "second-order", "semidefinite"])
def test_what_is_moved_into_the_dual_cone_is_in_it_and_what_is_there_stays(rng, kind):
    sizes = {
        "linear": {},
        "second-order": {"soc_sizes": (3, 4)},
        "semidefinite": {"psd_orders": (3,)},
    }
    rows = {"linear": 5, "second-order": 12, "semidefinite": 11}[kind]
    problem = ConicProgram(np.ones(2), csc_array((rows, 2)), np.zeros(rows), 2, 3, **sizes[kind])
    for y in rng.normal(size=(20, rows)):
        moved = problem.move_into_dual_cone(y)
        assert problem.cone_violation(moved, dual=True) < 1e-14
        np.testing.assert_allclose(problem.move_into_dual_cone(moved), moved, atol=1e-14)
        np.testing.assert_array_equal(moved[:2], y[:2])


@pytest.mark.parametrize("wrong", [{"nonnegative": -1}, {"soc_sizes": (0,)}, {"psd_orders": (0,)}])
def test_a_cone_without_rows_is_refused(wrong):
    with pytest.raises(ValueError, match="at least one"):
        ConicProgram(
            np.ones(1), csc_array((2, 1)), np.zeros(2), **({"zero": 2, "nonnegative": 0} | wrong)
        )


def test_a_solver_that_cries_infeasible_without_proof_is_not_believed(rng):
    problem, _, y = programme(rng)

    def cries(ray):
        def solver(problem):
            raise Infeasible(problem, "Wolf", ray)

        return solver

    with pytest.raises(Unsolved, match="Wolf, but no proof") as refusal:
        solve(problem, cries(None))
    assert not isinstance(refusal.value, Infeasible)
    against = -np.sign(problem.b @ y) * y
    for ray, why in ((-against, "proves nothing"), (against, "leaves"), (y * np.nan, "nothing")):
        with pytest.raises(Unsolved, match=why) as refusal:
            solve(problem, cries(ray))
        assert not isinstance(refusal.value, Infeasible)


@both
def test_no_bottom_is_no_answer(solver):
    problem = ConicProgram(np.ones(1), csc_array([[1.0]]), np.zeros(1), 0, 1)  # min x, x ≤ 0
    with pytest.raises(Unsolved, match="stopped") as refusal:
        solve(problem, solver)
    assert not isinstance(refusal.value, Infeasible)


def test_again_answers_as_if_each_question_were_the_first(rng):
    first, _, _ = programme(rng, cones=(3, 4))
    again, sides = (
        ClarabelSession(first),
        [first.b + 0.1 * rng.random(len(first.b)) for _ in range(6)],
    )
    asked = [
        ConicProgram(first.q, first.A, b, first.zero, first.nonnegative, first.soc_sizes)
        for b in sides
    ]
    forwards = [solve(problem, again).x for problem in asked]
    backwards = [solve(problem, again).x for problem in asked[::-1]][::-1]
    np.testing.assert_array_equal(forwards, backwards)
    for problem, x in zip(asked, forwards, strict=True):
        np.testing.assert_allclose(x, solve(problem, solve_clarabel).x, atol=1e-5)


def test_again_refuses_another_matrix(rng):
    first, other = programme(rng)[0], programme(rng)[0]
    with pytest.raises(ValueError, match="only b may differ"):
        solve(other, ClarabelSession(first))


def test_highs_refuses_cones(rng):
    with pytest.raises(ValueError, match="second-order cones"):
        solve(programme(rng, cones=(3,))[0], solve_highs)


def test_rows_must_belong_to_a_cone():
    with pytest.raises(ValueError, match="the cones have 3 rows"):
        ConicProgram(np.ones(2), csc_array(np.ones((2, 2))), np.ones(2), 1, 2)


@pytest.mark.parametrize("name", ["q", "A", "b"])
def test_numbers_must_be_numbers(name):
    parts = {"q": np.ones(2), "A": np.ones((2, 2)), "b": np.ones(2)}
    parts[name] = parts[name] * np.inf
    with pytest.raises(ValueError, match=f"{name} must be finite"):
        ConicProgram(parts["q"], csc_array(parts["A"]), parts["b"], 0, 2)
