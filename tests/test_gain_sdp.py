"""Gains by semidefinite programme, against what must hold of them and against other gains."""

import numpy as np
import pytest

from problems.desired_formation import DesiredFormation
from problems.gain_design import NoStabilizingGain, design_gains
from problems.gain_problem import GainProblem, NoGainMatrix
from problems.gain_sdp import solve
from problems.rigidity import is_rigid

PYRAMID = [(0, 2), (0, 3), (0, 5), (1, 2), (1, 5), (2, 3), (3, 4), (4, 5)]


def graph_of(n, pairs):
    graph = np.zeros((n, n), dtype=bool)
    for i, j in pairs:
        graph[i, j] = graph[j, i] = True
    return graph


def rigid_graph(rng, n, share):
    while True:
        upper = np.triu(rng.random((n, n)) < share, 1)
        graph = upper | upper.T
        if graph.sum(axis=1).min() >= 2 and is_rigid(graph, 2, rng):
            return graph


def questions(formation):
    yield GainProblem(formation.kernel_xy, formation.graph)
    yield GainProblem(formation.kernel_z, formation.graph)


def fits(question, L):
    assert np.abs(L - L.conj().T).max() <= 1e-12
    assert np.abs(L @ question.kernel).max() <= 1e-10
    assert np.abs(L[~question.graph & ~np.eye(len(L), dtype=bool)]).max(initial=0) <= 1e-12
    assert np.trace(L).real == pytest.approx(question.m, abs=1e-9)


@pytest.mark.parametrize(("n", "share"), [(5, 0.8), (8, 0.6), (10, 0.5)])
def test_the_rate_is_the_bound_that_the_prices_prove(rng, n, share):
    formation = DesiredFormation(rng.uniform(0, 5, (n, 3)), rigid_graph(rng, n, share))
    for question in questions(formation):
        L, Y = solve(question)
        fits(question, L)
        assert question.convergence_rate(L) == pytest.approx(question.rate_bound(Y), abs=1e-6)
        assert np.array_equal(Y, Y.conj().T)
        assert not Y[question.graph | np.eye(n, dtype=bool)].any()


def test_no_other_gains_are_faster(rng):
    formation = DesiredFormation(rng.uniform(0, 5, (8, 3)), rigid_graph(rng, 8, 0.7))
    for question in questions(formation):
        L, _ = solve(question)
        best = question.convergence_rate(L)
        for size in [1e-4, 1e-2, 1.0]:
            for _ in range(20):
                W = rng.normal(size=(8, 8)) + 1j * rng.normal(size=(8, 8))
                W = W if np.iscomplexobj(L) else W.real
                assert (
                    question.convergence_rate(question.project(L + size * (W + W.conj().T)))
                    < best + 1e-7
                )


def test_how_points_are_numbered_turned_and_scaled_does_not_matter(rng):
    graph = rigid_graph(rng, 7, 0.6)
    points, order = rng.uniform(0, 5, (7, 3)), rng.permutation(7)
    turn = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, -2]])
    there = DesiredFormation((3 * points @ turn.T + [7, -9, 1])[order], graph[np.ix_(order, order)])
    for one, other in zip(
        questions(DesiredFormation(points, graph)), questions(there), strict=True
    ):
        assert one.convergence_rate(solve(one)[0]) == pytest.approx(
            other.convergence_rate(solve(other)[0]), abs=1e-6
        )


def test_on_the_complete_graph_every_rate_is_one(rng):
    for question in questions(DesiredFormation.with_complete_graph(rng.uniform(0, 5, (12, 3)))):
        L, Y = solve(question)
        fits(question, L)
        assert question.convergence_rate(L) == pytest.approx(1, abs=1e-7)
        assert question.rate_bound(Y) == 1


def test_heights_on_a_path_with_a_known_answer_are_answered():
    # Upwards, a flat square without diagonals leaves two weights, and equal ones are best:
    # the eigenvalues 0, 2w, 2w, 4w with sum 3.
    square = np.array([[0.0, 0, 1], [1, 0, 1], [1, 1, 1], [0, 1, 1]])
    formation = DesiredFormation(square, graph_of(4, [(0, 1), (1, 2), (2, 3), (3, 0)]))
    question = GainProblem(formation.kernel_z, formation.graph)
    assert question.convergence_rate(solve(question)[0]) == pytest.approx(3 / 4, abs=1e-7)


def test_a_pyramid_that_is_not_rigid_from_above_has_gains(rng):
    angle = 2 * np.pi * np.arange(5) / 5
    base = np.c_[2 * np.cos(angle), 2 * np.sin(angle), np.zeros(5)]
    formation = DesiredFormation(np.vstack([[0, 0, 1.7], base]), graph_of(6, PYRAMID))
    assert not is_rigid(formation.graph, 2, rng)
    xy, z = questions(formation)
    L, Y = solve(xy)
    assert xy.convergence_rate(L) == pytest.approx(xy.rate_bound(Y), abs=1e-6)
    assert xy.convergence_rate(L) > 0.265  # what the code of [Lusk2020] finds
    fits(z, solve(z)[0])  # the apex has a height of its own, that nothing below can measure


@pytest.mark.parametrize("n", [4, 5, 6, 7])
def test_a_ring_has_no_stabilising_gains_and_the_prices_prove_it(rng, n):
    ring = graph_of(n, [(i, (i + 1) % n) for i in range(n)])
    xy, z = questions(DesiredFormation(rng.uniform(0, 5, (n, 3)), ring))
    with pytest.raises(NoGainMatrix) as none:
        solve(xy)
    assert xy.rate_bound(none.value.dual) < 0
    L, Y = solve(z)
    fits(z, L)
    assert z.convergence_rate(L) == pytest.approx(z.rate_bound(Y), abs=1e-6)
    assert z.rate_bound(Y) < 0


def test_two_storeys_that_see_only_each_other_are_rigid_and_have_no_gains(rng):
    # On a line, K3,3 has lengths that fix it in all dimensions only if its sides mix.
    storeys = graph_of(6, [(i, j) for i in range(3) for j in range(3, 6)])
    points = rng.uniform(0, 1, (6, 3)) + np.outer([0, 0, 0, 1, 1, 1], [0, 0, 2])
    formation = DesiredFormation(points, storeys)
    assert is_rigid(storeys, 2, rng)
    _, z = questions(formation)
    L, Y = solve(z)
    assert z.convergence_rate(L) < 0
    assert z.rate_bound(Y) < 0
    with pytest.raises(NoStabilizingGain, match="by proof"):
        design_gains(formation)


def test_gains_of_every_other_method_are_as_fast_or_slower_and_their_bounds_hold(rng):
    found = 0
    for _ in range(6):
        n = int(rng.integers(5, 11))
        formation = DesiredFormation(rng.uniform(0, 5, (n, 3)), rigid_graph(rng, n, 0.55))
        xy, z = (question.convergence_rate(solve(question)[0]) for question in questions(formation))
        try:
            gains = design_gains(formation)
        except NoStabilizingGain as verdict:
            assert {"xy": xy, "z": z}[verdict.axes] <= 1e-6
            continue
        found += 1
        assert gains.rate_xy == pytest.approx(xy, abs=5e-4)
        assert gains.rate_z == pytest.approx(z, abs=5e-4)
        assert gains.bound_xy >= xy - 1e-7
        assert gains.bound_z >= z - 1e-7
        exact = design_gains(formation, method="sdp")
        assert exact.convergence_rate == pytest.approx(min(xy, z), abs=1e-9)
        assert max(exact.gap_xy, exact.gap_z) < 1e-4
    assert found >= 3
