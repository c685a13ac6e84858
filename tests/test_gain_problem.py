"""Problem of formation gains: projection, rate and bound, against least squares."""

import numpy as np
import pytest
from gain_examples import assert_satisfies_equations, complete, graph_of, random_graph, ring
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.linalg import eigvalsh, null_space

from problems.desired_formation import DesiredFormation
from problems.gain_problem import GainProblem, NoGainMatrix, _least_eigenvalue
from problems.gain_sdp import solve

DRAWS = st.integers(0, 2**32 - 1)


def random_problem(seed, axes, share=0.7, n=8):
    """Draw a problem on a random graph that contains a ring."""
    rng = np.random.default_rng(seed)
    graph = random_graph(rng, n, share) | ring(n)
    formation = DesiredFormation(rng.uniform(0, 9, (n, 3)), graph)
    return GainProblem.from_formation(formation, axes), rng


def hermitian(problem, rng):
    n = len(problem.graph)
    W = rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))
    W = W if np.iscomplexobj(problem.kernel) else W.real
    return W + W.conj().T


def absent(problem):
    return ~problem.graph & complete(len(problem.graph))


def inner(A, B):
    return float((A.conj() * B).sum().real)


@pytest.mark.parametrize("axes", ["xy", "z"])
@given(seed=DRAWS)
def test_the_projection_is_feasible_idempotent_and_orthogonal(axes, seed):
    problem, rng = random_problem(seed, axes)
    W, other = hermitian(problem, rng), problem.project(hermitian(problem, rng)).L
    L = problem.project(W).L
    assert_satisfies_equations(problem, L)
    assert np.abs(problem.project(L).L - L).max() < 1e-10 * (1 + np.abs(L).max())
    away = np.linalg.norm(W - L) * np.linalg.norm(other - L)
    assert abs(inner(W - L, other - L)) < 1e-9 * (1 + away)  # orthogonal


@pytest.mark.parametrize("axes", ["xy", "z"])
@settings(max_examples=15)
@given(seed=DRAWS, share=st.sampled_from([0.4, 0.6, 0.9]), size=st.floats(-12, 12))
def test_no_gains_are_faster_than_any_bound(axes, seed, share, size):
    # The general solver gives the fastest gains to eight digits and the tightest bound. Near
    # its dual, a bound with a small error would be below their rate.
    problem, rng = random_problem(seed, axes, share)
    try:
        L, Y = solve(problem)
    except NoGainMatrix:
        return
    best = problem.convergence_rate(L)
    assert best - 1e-12 <= problem.rate_bound(10**size * Y) <= best + 1e-5
    for near in (0, 1e-6, 1e-3, 1):
        other = hermitian(problem, rng)  # entries at edges must be ignored
        mixed = (1 - near) * Y / (1e-300 + np.linalg.norm(Y)) + near * other
        assert problem.rate_bound(10**size * mixed) >= best - 1e-12


def test_a_matrix_without_information_gives_the_trivial_bound():
    problem, _ = random_problem(11, "z", 0.5)
    for Y in (0.0, np.inf, np.nan):
        assert problem.rate_bound(np.full((8, 8), Y)) == 1
    # Without edges, 1 1ᵀ less its diagonal is −I outside the kernel.
    free = GainProblem(problem.kernel, np.zeros((8, 8), dtype=bool))
    everywhere = np.ones((8, 8)) - np.eye(8)
    assert free.rate_bound(everywhere) == 1 and free.rate_bound(-everywhere) < -1e9


@pytest.mark.parametrize("axes", ["xy", "z"])
def test_the_bound_is_the_objective_of_the_dual_problem(axes, rng):
    problem, _ = random_problem(3, axes, 0.4)
    Y = np.where(absent(problem), hermitian(problem, rng), 0)
    Q = null_space(problem.kernel.conj().T)
    λ = np.linalg.eigvalsh(Q.conj().T @ Y @ Q)
    assert problem.rate_bound(Y) == pytest.approx(min(1, -λ[0] / (λ.mean() - λ[0])), abs=1e-10)
    assert problem.rate_bound(0 * Y) == 1


@pytest.mark.parametrize("axes", ["xy", "z"])
def test_the_rate_is_the_least_eigenvalue_outside_the_kernel(axes, rng):
    problem, _ = random_problem(5, axes)
    L, Q = problem.project(hermitian(problem, rng)).L, null_space(problem.kernel.conj().T)
    assert problem.convergence_rate(L) == pytest.approx(
        np.linalg.eigvalsh(Q.conj().T @ L @ Q)[0], abs=1e-10
    )
    assert problem.m == Q.shape[1]


@pytest.mark.parametrize("n", [5, 6])
def test_without_positive_trace_a_dual_matrix_is_the_proof(n, rng):
    problem = GainProblem.from_formation(DesiredFormation(rng.uniform(0, 9, (n, 3)), ring(n)), "xy")
    with pytest.raises(NoGainMatrix, match="no matrix with this graph") as verdict:
        problem.project(np.eye(n))
    Y = verdict.value.dual
    Q = null_space(problem.kernel.conj().T)
    assert not Y[~absent(problem)].any()
    assert_allclose(Q.conj().T @ Y @ Q, np.eye(n - 2), atol=1e-7)
    assert problem.rate_bound(Y) < 0


def test_nearly_singular_equations_leave_small_residuals(rng):
    # Points that are nearly collinear make the equations nearly singular.
    points = np.stack([np.arange(8.0), 1e-3 * rng.random(8), rng.random(8)], axis=1)
    graph = ring(8) | graph_of(8, [(0, 2), (1, 3), (2, 4), (3, 5), (4, 6), (5, 7), (6, 0), (7, 1)])
    problem = GainProblem.from_formation(DesiredFormation(points, graph), "xy")
    L = problem.project(np.eye(8)).L
    assert np.abs(L @ problem.kernel).max() < 1e-11 * max(1, np.abs(L).max())


@pytest.mark.parametrize("axes", ["xy", "z"])
def test_rate_is_that_of_scipy_bit_for_bit(axes):
    for seed in range(3):
        problem, rng = random_problem(seed, axes, n=6 + 20 * seed)
        L = hermitian(problem, rng)
        least = eigvalsh(problem.shift_kernel(L), subset_by_index=[0, 0])[0]
        assert problem.convergence_rate(L) == least


def test_matrix_without_eigenvalues_raises_an_error():
    with pytest.raises(np.linalg.LinAlgError, match=r"stopped with \d .* \(3, 3\)"):
        _least_eigenvalue(np.full((3, 3), np.nan))
