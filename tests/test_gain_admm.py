"""Formation gains by splitting: proven bounds, the general solver, and acceleration."""

import numpy as np
import pytest
from gain_examples import assert_satisfies_equations, random_graph, rigid_graph
from hypothesis import given, settings
from hypothesis import strategies as st

from problems import gain_sdp
from problems.desired_formation import DesiredFormation
from problems.gain_admm import _AndersonAcceleration, _prox_least_eigenvalue, solve
from problems.gain_problem import MIN_RATE, GainProblem, NoGainMatrix

DRAWS = st.integers(0, 2**32 - 1)


def rigid_problem(rng, n, share, axes):
    graph = rigid_graph(rng, n, share)
    formation = DesiredFormation(rng.uniform(0, 1, (n, 3)) * [15, 15, 2], graph)
    return GainProblem.from_formation(formation, axes)


@pytest.mark.parametrize("axes", ["xy", "z"])
@settings(max_examples=25)
@given(seed=DRAWS, share=st.floats(0.5, 1))
def test_the_rate_is_within_the_tolerance_of_a_proven_bound(axes, seed, share):
    rng = np.random.default_rng(seed)
    problem = rigid_problem(rng, int(rng.integers(4, 14)), share, axes)
    try:
        L, Y = solve(problem, tolerance=1e-2)
    except NoGainMatrix:
        return
    rate, bound = problem.convergence_rate(L), problem.rate_bound(Y)
    assert_satisfies_equations(problem, L)
    assert rate <= bound + 1e-12
    assert bound <= MIN_RATE or bound - rate <= 1e-2 * bound


@pytest.mark.parametrize("axes", ["xy", "z"])
@pytest.mark.parametrize(("n", "share"), [(5, 0.8), (7, 0.7), (9, 0.5), (11, 0.45), (13, 0.4)])
def test_rates_on_sparse_graphs_equal_those_of_the_general_solver(axes, n, share, rng):
    problem = rigid_problem(rng, n, share, axes)
    best = problem.convergence_rate(gain_sdp.solve(problem)[0])
    L, Y = solve(problem, tolerance=1e-4)
    assert problem.convergence_rate(L) == pytest.approx(best, abs=1e-4)
    assert problem.rate_bound(Y) == pytest.approx(best, abs=1e-4)


@pytest.mark.parametrize("axes", ["xy", "z"])
@pytest.mark.parametrize("n", [50, 100])
def test_half_of_the_edges_suffice_for_a_gap_of_1e_3_in_60_iterations(axes, n, rng):
    graph = random_graph(rng, n, 0.5)
    formation = DesiredFormation(rng.uniform(0, 1, (n, 3)) * [15, 15, 2], graph)
    problem = GainProblem.from_formation(formation, axes)
    L, Y = solve(problem, tolerance=1e-3, max_iterations=60)
    assert problem.convergence_rate(L) >= (1 - 1e-3) * problem.rate_bound(Y)


def test_more_iterations_never_worsen_rate_or_bound(rng):
    problem = rigid_problem(rng, 14, 0.4, "xy")
    answers = [solve(problem, 0.0, iterations) for iterations in (0, 5, 20, 80, 160)]
    rates, bounds = zip(
        *((problem.convergence_rate(L), problem.rate_bound(Y)) for L, Y in answers), strict=True
    )
    assert list(rates) == sorted(rates) and list(bounds) == sorted(bounds, reverse=True)
    assert rates[0] < rates[-1] and bounds[-1] < bounds[0]


@pytest.mark.parametrize("axes", ["xy", "z"])
@given(seed=DRAWS, strength=st.floats(1e-3, 1e3))
def test_raising_the_smallest_eigenvalues_is_the_proximal_step(axes, seed, strength):
    # X is the proximal point where (X − W)/ρ is a subgradient of λ_min at X: positive
    # semidefinite, of trace 1, and supported by the least eigenvalue alone.
    rng = np.random.default_rng(seed)
    problem = GainProblem.from_formation(
        DesiredFormation.with_complete_graph(rng.normal(size=(7, 3))), axes
    )
    half = rng.normal(size=(7, 7)) + 1j * rng.normal(size=(7, 7))
    half = half if axes == "xy" else half.real
    W = problem.project(half + half.conj().T).L
    X = _prox_least_eigenvalue(problem, W, strength)
    S = (X - W) / strength
    assert np.abs(X @ problem.kernel).max() < 1e-9 * (1 + strength)
    assert np.linalg.eigvalsh(S)[0] > -1e-9 * (1 + 1 / strength)
    assert S.trace().real == pytest.approx(1, abs=1e-9 * (1 + 1 / strength))
    least = float((S.conj() * X).sum().real)
    assert problem.convergence_rate(X) == pytest.approx(
        least, abs=1e-8 * (1 + strength + 1 / strength)
    )


def test_acceleration_solves_a_linear_iteration_in_few_steps(rng):
    Q = np.linalg.qr(rng.normal(size=(16, 16)))[0]
    slow = (Q * np.repeat([0.5, 0.9, 0.99, 0.999], 4)) @ Q.T
    W = rng.normal(size=(4, 4))
    acceleration = _AndersonAcceleration(W)
    for _ in range(12):
        W = acceleration.next_iterate(W, (slow @ W.ravel()).reshape(4, 4) - W)
    assert np.abs(W).max() < 1e-3  # without acceleration, 0.999¹² of it would be left


def test_a_step_that_raises_the_residual_is_undone(rng):
    W, residual = rng.normal(size=(2, 4, 4))
    acceleration = _AndersonAcceleration(W)
    plain = acceleration.next_iterate(W, residual)
    assert np.array_equal(acceleration.next_iterate(plain + 5, 3 * residual), plain)
