"""Gains by splitting: certified, and those of a general solver."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from problems import gain_sdp as sdp
from problems.desired_formation import DesiredFormation
from problems.gain_admm import _AndersonAcceleration, _prox_least_eigenvalue, solve
from problems.gain_problem import MIN_RATE, GainProblem, NoGainMatrix
from problems.rigidity import is_rigid

DRAWS = st.integers(0, 2**32 - 1)


def with_share(n, share, rng):
    while True:
        upper = np.triu(rng.random((n, n)) < share, 1)
        graph = upper | upper.T
        if is_rigid(graph, 2, rng):
            return DesiredFormation(rng.uniform(0, 1, (n, 3)) * [15, 15, 2], graph)


def bodies(*groups):
    """A graph of complete parts that share vertices."""
    n = max(map(max, groups)) + 1
    graph = np.zeros((n, n), dtype=bool)
    for group in groups:
        graph[np.ix_(group, group)] = True
    return graph & ~np.eye(n, dtype=bool)


@pytest.mark.parametrize("which", ["xy", "z"])
@settings(max_examples=25)
@given(seed=DRAWS, share=st.floats(0.5, 1))
def test_the_rate_is_within_the_tolerance_of_a_proven_bound(which, seed, share):
    rng = np.random.default_rng(seed)
    question = GainProblem.from_formation(with_share(int(rng.integers(4, 14)), share, rng), which)
    try:
        L, Y = solve(question, tolerance=1e-2)
    except NoGainMatrix:
        return
    rate, bound = question.convergence_rate(L), question.rate_bound(Y)
    assert np.abs(L @ question.kernel).max() < 1e-11
    assert rate <= bound + 1e-12
    assert bound <= MIN_RATE or bound - rate <= 1e-2 * bound


@pytest.mark.parametrize("which", ["xy", "z"])
@pytest.mark.parametrize(("n", "share"), [(5, 0.8), (7, 0.7), (9, 0.5), (11, 0.45), (13, 0.4)])
def test_rates_on_sparse_graphs_are_those_of_the_general_solver(which, n, share, rng):
    question = GainProblem.from_formation(with_share(n, share, rng), which)
    best = question.convergence_rate(sdp.solve(question)[0])
    L, Y = solve(question, tolerance=1e-4)
    assert question.convergence_rate(L) == pytest.approx(best, abs=1e-4)
    assert question.rate_bound(Y) == pytest.approx(best, abs=1e-4)


@pytest.mark.parametrize("which", ["xy", "z"])
@pytest.mark.parametrize("n", [50, 100])
def test_half_of_the_edges_reach_a_thousandth_of_the_bound_in_few_rounds(which, n, rng):
    upper = np.triu(rng.random((n, n)) < 0.5, 1)
    formation = DesiredFormation(rng.uniform(0, 1, (n, 3)) * [15, 15, 2], upper | upper.T)
    question = GainProblem.from_formation(formation, which)
    L, Y = solve(question, tolerance=1e-3, max_iterations=60)
    assert question.convergence_rate(L) >= (1 - 1e-3) * question.rate_bound(Y)


def test_longer_is_never_slower(rng):
    question = GainProblem.from_formation(with_share(14, 0.4, rng), "xy")
    answers = [solve(question, 0.0, rounds) for rounds in (0, 5, 20, 80, 160)]
    rates, bounds = zip(
        *((question.convergence_rate(L), question.rate_bound(Y)) for L, Y in answers), strict=True
    )
    assert list(rates) == sorted(rates) and list(bounds) == sorted(bounds, reverse=True)
    assert rates[0] < rates[-1] and bounds[-1] < bounds[0]


HINGED = bodies([0, 1, 2, 3, 4], [4, 5, 6, 7])
CHAIN = bodies([0, 1, 2], [2, 3, 4], [4, 5, 6])
RING = bodies([0, 1], [1, 2], [2, 3], [3, 0])
JOINED_BY_TWO = bodies([0, 1, 2, 3], [4, 5, 6, 7], [0, 4], [1, 5])


@pytest.mark.parametrize(
    ("graph", "which"),
    [
        (HINGED, "xy"),
        (HINGED, "z"),
        (CHAIN, "xy"),
        (CHAIN, "z"),
        (JOINED_BY_TWO, "xy"),
    ],
)
def test_where_parts_turn_or_stretch_by_themselves_there_is_a_proof(graph, which, rng):
    for _ in range(3):
        formation = DesiredFormation(rng.uniform(0, 9, (len(graph), 3)), graph)
        question = GainProblem.from_formation(formation, which)
        assert question.rate_bound(solve(question).Y) <= MIN_RATE


def test_a_ring_of_four_has_no_matrix_in_the_plane_unless_it_is_a_special_one(rng):
    question = GainProblem.from_formation(DesiredFormation(rng.uniform(0, 9, (4, 3)), RING), "xy")
    with pytest.raises(NoGainMatrix):
        solve(question)


@pytest.mark.parametrize("which", ["xy", "z"])
@given(seed=DRAWS, strength=st.floats(1e-3, 1e3))
def test_raising_the_smallest_eigenvalues_is_the_proximal_step(which, seed, strength):
    # X is it where (X − W)/ρ is a subgradient of λ_min at X: positive, of trace 1, and seen
    # by the least eigenvalue alone.
    rng = np.random.default_rng(seed)
    question = GainProblem.from_formation(
        DesiredFormation.with_complete_graph(rng.normal(size=(7, 3))), which
    )
    half = rng.normal(size=(7, 7)) + 1j * rng.normal(size=(7, 7))
    half = half if which == "xy" else half.real
    W = question.project(half + half.conj().T)
    X = _prox_least_eigenvalue(question, W, strength)
    S = (X - W) / strength
    assert np.abs(X @ question.kernel).max() < 1e-9 * (1 + strength)
    assert np.linalg.eigvalsh(S)[0] > -1e-9 * (1 + 1 / strength)
    assert S.trace().real == pytest.approx(1, abs=1e-9 * (1 + 1 / strength))
    least = float((S.conj() * X).sum().real)
    assert question.convergence_rate(X) == pytest.approx(
        least, abs=1e-8 * (1 + strength + 1 / strength)
    )


def test_a_linear_course_ends_after_as_many_steps_as_it_has_directions(rng):
    Q = np.linalg.qr(rng.normal(size=(16, 16)))[0]
    slow = (Q * np.repeat([0.5, 0.9, 0.99, 0.999], 4)) @ Q.T
    W = rng.normal(size=(4, 4))
    course = _AndersonAcceleration(W)
    for _ in range(12):
        W = course.next_iterate(W, (slow @ W.ravel()).reshape(4, 4) - W)
    assert np.abs(W).max() < 1e-3  # plainly, 0.999¹² of it were left


def test_a_step_that_leads_astray_is_taken_back(rng):
    W, mismatch = rng.normal(size=(2, 4, 4))
    course = _AndersonAcceleration(W)
    plain = course.next_iterate(W, mismatch)
    assert np.array_equal(course.next_iterate(plain + 5, 3 * mismatch), plain)
