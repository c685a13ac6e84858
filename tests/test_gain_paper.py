"""Formation gains by the paper's method: converged, and with its early stop."""

import pytest
from gain_examples import assert_satisfies_equations, problems_of, pyramid, ring

from problems import gain_sdp
from problems.desired_formation import DesiredFormation
from problems.gain_paper import solve
from problems.gain_problem import NoGainMatrix
from sato.shapes.formation_library import random_sparse_graph


def sparse(rng, n, share):
    points = rng.uniform(0, 5, (n, 3))
    return DesiredFormation(points, random_sparse_graph(points, share, rng))


@pytest.mark.parametrize(("n", "share"), [(5, 1.0), (7, 0.8), (10, 0.5)])
def test_equations_and_bound_hold_after_any_number_of_iterations(rng, n, share):
    for problem in problems_of(sparse(rng, n, share)):
        best = problem.convergence_rate(gain_sdp.solve(problem)[0])
        for iterations in (1, 3, 10):
            L, Y = solve(problem, max_iterations=iterations)
            assert_satisfies_equations(problem, L)
            assert problem.convergence_rate(L) <= best + 1e-7
            assert problem.rate_bound(Y) >= best - 1e-7


@pytest.mark.parametrize("case", [(6, 0.9), (8, 0.7), "pyramid"])
def test_the_converged_method_reaches_the_optimum(rng, case):
    # The vertical kernel of the pyramid contains its apex, so that equations are redundant.
    problems = problems_of(pyramid())[1:] if case == "pyramid" else problems_of(sparse(rng, *case))
    for problem in problems:
        best = problem.convergence_rate(gain_sdp.solve(problem)[0])
        L, Y = solve(problem, max_iterations=4000, trace_tolerance=0, change_tolerance=1e-6)
        assert problem.convergence_rate(L) == pytest.approx(best, abs=1e-3)
        assert case == "pyramid" or problem.rate_bound(Y) == pytest.approx(best, abs=1e-3)


def test_the_early_stop_gives_slow_gains_and_a_loose_bound(rng):
    for problem in problems_of(sparse(rng, 12, 0.5)):
        L, Y = solve(problem)
        best = problem.convergence_rate(gain_sdp.solve(problem)[0])
        assert problem.convergence_rate(L) < 0.8 * best
        assert problem.rate_bound(Y) > 1.2 * best


def test_the_early_stop_is_often_unstable_where_stable_gains_exist(rng):
    unstable = 0
    for _ in range(10):
        xy, _ = problems_of(sparse(rng, 10, 0.45))
        assert xy.convergence_rate(gain_sdp.solve(xy)[0]) > 0.01
        unstable += xy.convergence_rate(solve(xy)[0]) < -0.01
    assert unstable >= 3


def test_one_iteration_suffices_on_complete_graphs(rng):
    for problem in problems_of(DesiredFormation.with_complete_graph(rng.uniform(0, 5, (9, 3)))):
        for iterations in (1, 10):
            L, Y = solve(problem, max_iterations=iterations)
            assert problem.convergence_rate(L) == pytest.approx(1, abs=1e-9)
            assert problem.rate_bound(Y) == 1


def test_unstable_gains_are_returned_where_none_stabilize(rng):
    xy, z = problems_of(DesiredFormation(rng.uniform(0, 5, (6, 3)), ring(6)))
    with pytest.raises(NoGainMatrix):
        solve(xy)
    L, Y = solve(z)
    assert z.convergence_rate(L) < 0
    assert z.rate_bound(Y) >= z.convergence_rate(gain_sdp.solve(z)[0]) - 1e-7


def test_no_iterations_are_refused(rng):
    xy, _ = problems_of(DesiredFormation.with_complete_graph(rng.uniform(0, 5, (5, 3))))
    with pytest.raises(ValueError, match="at least 1, got 0"):
        solve(xy, max_iterations=0)
