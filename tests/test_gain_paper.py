"""The paper's own way to gains: right when it is let run, and what it returns when it is not."""

import numpy as np
import pytest

from problems import gain_sdp as sdp
from problems.desired_formation import DesiredFormation
from problems.gain_paper import solve
from problems.gain_problem import GainProblem, NoGainMatrix
from sato.shapes.graphs import random_sparse_graph


def sparse(rng, n, share):
    points = rng.uniform(0, 5, (n, 3))
    return DesiredFormation(points, random_sparse_graph(points, share, rng))


def questions(formation):
    yield GainProblem(formation.kernel_xy, formation.graph)
    yield GainProblem(formation.kernel_z, formation.graph)


@pytest.mark.parametrize(("n", "share"), [(5, 1.0), (7, 0.8), (10, 0.5)])
def test_gains_fit_and_the_bound_holds_however_early_it_stops(rng, n, share):
    for question in questions(sparse(rng, n, share)):
        best = question.convergence_rate(sdp.solve(question)[0])
        for rounds in (1, 3, 10):
            L, Y = solve(question, max_iterations=rounds)
            assert np.abs(L - L.conj().T).max() <= 1e-12
            assert np.abs(L @ question.kernel).max() <= 1e-10
            assert np.abs(L[~question.graph & ~np.eye(n, dtype=bool)]).max(initial=0) <= 1e-12
            assert np.trace(L).real == pytest.approx(question.m, abs=1e-9)
            assert question.convergence_rate(L) <= best + 1e-7
            assert question.rate_bound(Y) >= best - 1e-7


@pytest.mark.parametrize(("n", "share"), [(6, 0.9), (8, 0.7)])
def test_let_run_it_reaches_the_optimum_of_the_general_solver(rng, n, share):
    for question in questions(sparse(rng, n, share)):
        best = question.convergence_rate(sdp.solve(question)[0])
        L, Y = solve(question, max_iterations=4000, trace_tolerance=0, change_tolerance=1e-6)
        assert question.convergence_rate(L) == pytest.approx(best, abs=1e-3)
        assert question.rate_bound(Y) == pytest.approx(best, abs=1e-3)


def test_stopped_as_in_its_code_it_is_slower_than_need_be(rng):
    for question in questions(sparse(rng, 12, 0.5)):
        L, Y = solve(question)
        best = question.convergence_rate(sdp.solve(question)[0])
        assert question.convergence_rate(L) < 0.8 * best
        assert question.rate_bound(Y) > 1.2 * best


def test_stopped_as_in_its_code_it_is_often_unstable_where_stable_gains_exist(rng):
    unstable = 0
    for _ in range(10):
        xy, _ = questions(sparse(rng, 10, 0.45))
        assert xy.convergence_rate(sdp.solve(xy)[0]) > 0.01
        unstable += xy.convergence_rate(solve(xy)[0]) < -0.01
    assert unstable >= 3


def test_on_the_complete_graph_it_is_right_at_once(rng):
    for question in questions(DesiredFormation.with_complete_graph(rng.uniform(0, 5, (9, 3)))):
        for rounds in (1, 10):
            L, Y = solve(question, max_iterations=rounds)
            assert question.convergence_rate(L) == pytest.approx(1, abs=1e-9)
            assert question.rate_bound(Y) == 1


def test_it_returns_gains_also_where_none_stabilise(rng):
    ring = np.roll(np.eye(6, dtype=bool), 1, axis=0)
    xy, z = questions(DesiredFormation(rng.uniform(0, 5, (6, 3)), ring | ring.T))
    with pytest.raises(NoGainMatrix):
        solve(xy)
    L, Y = solve(z)
    assert z.convergence_rate(L) < 0
    assert z.rate_bound(Y) >= z.convergence_rate(sdp.solve(z)[0]) - 1e-7


def test_equations_that_say_nothing_do_no_harm():
    # Seen upwards, the apex of a pyramid is in the kernel: its non-edges are zero anyway.
    angle = 2 * np.pi * np.arange(5) / 5
    base = np.c_[2 * np.cos(angle), 2 * np.sin(angle), np.zeros(5)]
    graph = np.zeros((6, 6), dtype=bool)
    for i, j in [(0, 2), (0, 3), (0, 5), (1, 2), (1, 5), (2, 3), (3, 4), (4, 5)]:
        graph[i, j] = graph[j, i] = True
    _, z = questions(DesiredFormation(np.vstack([[0, 0, 1.7], base]), graph))
    L, _ = solve(z, max_iterations=4000, trace_tolerance=0, change_tolerance=1e-6)
    assert z.convergence_rate(L) == pytest.approx(z.convergence_rate(sdp.solve(z)[0]), abs=1e-3)


def test_without_a_round_there_are_no_gains(rng):
    xy, _ = questions(DesiredFormation.with_complete_graph(rng.uniform(0, 5, (5, 3))))
    with pytest.raises(ValueError, match="at least one round, got 0"):
        solve(xy, max_iterations=0)
