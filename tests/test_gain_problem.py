"""What is asked of gains: projection, rate and bound, against their laws and least squares."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import null_space

from problems.desired_formation import DesiredFormation
from problems.gain_problem import GainProblem, NoGainMatrix
from problems.gain_sdp import solve

DRAWS = st.integers(0, 2**32 - 1)


def joined(n, pairs):
    graph = np.zeros((n, n), dtype=bool)
    for i, j in pairs:
        graph[i, j] = graph[j, i] = True
    return graph


def ring(n):
    return joined(n, [(i, (i + 1) % n) for i in range(n)])


def drawn(seed, which, share=0.7, n=8):
    """A question on a random graph that holds a ring."""
    rng = np.random.default_rng(seed)
    upper = np.triu(rng.random((n, n)) < share, 1)
    formation = DesiredFormation(rng.uniform(0, 9, (n, 3)), upper | upper.T | ring(n))
    return GainProblem.from_formation(formation, which), rng


def hermitian(question, rng):
    n = len(question.graph)
    W = rng.normal(size=(n, n)) + 1j * rng.normal(size=(n, n))
    W = W if np.iscomplexobj(question.kernel) else W.real
    return W + W.conj().T


def absent(question):
    return ~question.graph & ~np.eye(len(question.graph), dtype=bool)


def inner(A, B):
    return float((A.conj() * B).sum().real)


@pytest.mark.parametrize("which", ["xy", "z"])
@given(seed=DRAWS)
def test_what_is_projected_fits(which, seed):
    question, rng = drawn(seed, which)
    L = question.project(hermitian(question, rng))
    assert np.abs(L - L.conj().T).max() < 1e-12
    assert np.abs(L @ question.kernel).max() < 1e-11
    assert not L[absent(question)].any()
    assert L.trace().real == pytest.approx(question.m, abs=1e-9)


@pytest.mark.parametrize("which", ["xy", "z"])
@given(seed=DRAWS)
def test_what_fits_stays_and_nothing_that_fits_is_nearer(which, seed):
    question, rng = drawn(seed, which)
    W, other = hermitian(question, rng), question.project(hermitian(question, rng))
    L = question.project(W)
    assert np.abs(question.project(L) - L).max() < 1e-10 * (1 + np.abs(L).max())
    away = np.linalg.norm(W - L) * np.linalg.norm(other - L)
    assert abs(inner(W - L, other - L)) < 1e-9 * (1 + away)  # a right angle: Pythagoras


@pytest.mark.parametrize("which", ["xy", "z"])
def test_the_projection_is_that_of_least_squares(which):
    # All Hermitian matrices with zeros at the non-edges, from a basis; then the affine set.
    question, rng = drawn(7, which, n=6)
    n, planar = 6, np.iscomplexobj(question.kernel)
    basis = []
    for i in range(n):
        for j in range(i, n):
            for unit in (1, 1j) if planar and i != j else (1,):
                if i == j or question.graph[i, j]:
                    B = np.zeros((n, n), dtype=complex)
                    B[i, j] = unit
                    basis.append(B + B.conj().T)
    basis = np.array(basis)
    rules = np.stack([b @ question.kernel for b in basis], axis=-1).reshape(-1, len(basis))
    rules = np.vstack([rules.real, rules.imag, np.trace(basis, axis1=1, axis2=2).real])
    right = np.append(np.zeros(len(rules) - 1), question.m)
    start, free = np.linalg.lstsq(rules, right)[0], null_space(rules)
    assert free.shape[1] > 1
    W = hermitian(question, rng)

    def flat(M):
        return np.concatenate([M.real.ravel(), M.imag.ravel()])

    columns = np.stack([flat(b) for b in basis], axis=1)
    step = np.linalg.lstsq(columns @ free, flat(W) - columns @ start)[0]
    nearest = np.tensordot(start + free @ step, basis, axes=1)
    np.testing.assert_allclose(question.project(W), nearest, atol=1e-10)


@pytest.mark.parametrize("which", ["xy", "z"])
@settings(max_examples=15)
@given(seed=DRAWS, share=st.sampled_from([0.4, 0.6, 0.9]), size=st.floats(-12, 12))
def test_no_gains_are_faster_than_any_bound(which, seed, share, size):
    # The general solver's gains are the fastest to eight digits, and its prices the sharpest
    # bound: so near to them, a bound that were a little wrong would be below their rate.
    question, rng = drawn(seed, which, share)
    try:
        L, Y = solve(question)
    except NoGainMatrix:
        return
    best = question.convergence_rate(L)
    assert best - 1e-12 <= question.rate_bound(10**size * Y) <= best + 1e-5
    for near in (0, 1e-6, 1e-3, 1):
        other = hermitian(question, rng)  # entries at edges are to be ignored
        mixed = (1 - near) * Y / (1e-300 + np.linalg.norm(Y)) + near * other
        assert question.rate_bound(10**size * mixed) >= best - 1e-12


@pytest.mark.parametrize("which", ["xy", "z"])
@pytest.mark.parametrize("size", [1e-300, 1e-12, 1e-6, 1e6, 1e12, 1e300])
def test_a_bound_does_not_depend_on_the_size_of_its_matrix(which, size):
    question, _ = drawn(11, which, 0.5)
    Y = question.project_with_remainder(np.eye(8)).removed
    assert 0 < question.rate_bound(Y) < 1
    assert question.rate_bound(size * Y) == pytest.approx(question.rate_bound(Y), abs=1e-12)


def test_what_is_no_proof_bounds_the_rate_by_the_mean_alone():
    question, _ = drawn(11, "z", 0.5)
    for Y in (0.0, np.inf, np.nan):
        assert question.rate_bound(np.full((8, 8), Y)) == 1
    # Without edges, 1 1ᵀ less its diagonal is −I outside the kernel.
    free = GainProblem(question.kernel, np.zeros((8, 8), dtype=bool))
    everywhere = np.ones((8, 8)) - np.eye(8)
    assert free.rate_bound(everywhere) == 1 and free.rate_bound(-everywhere) < -1e9


@pytest.mark.parametrize("which", ["xy", "z"])
def test_the_bound_is_the_dual_value_that_the_docstring_states(which, rng):
    question, _ = drawn(3, which, 0.4)
    Y = np.where(absent(question), hermitian(question, rng), 0)
    Q = null_space(question.kernel.conj().T)
    λ = np.linalg.eigvalsh(Q.conj().T @ Y @ Q)
    assert question.rate_bound(Y) == pytest.approx(min(1, -λ[0] / (λ.mean() - λ[0])), abs=1e-10)
    assert question.rate_bound(0 * Y) == 1
    assert question.rate_bound(3.7 * Y) == pytest.approx(question.rate_bound(Y), abs=1e-10)


@pytest.mark.parametrize("which", ["xy", "z"])
def test_the_rate_is_the_least_eigenvalue_outside_the_kernel(which, rng):
    question, _ = drawn(5, which)
    L, Q = question.project(hermitian(question, rng)), null_space(question.kernel.conj().T)
    assert question.convergence_rate(L) == pytest.approx(
        np.linalg.eigvalsh(Q.conj().T @ L @ Q)[0], abs=1e-10
    )
    assert question.m == Q.shape[1]


@pytest.mark.parametrize("which", ["xy", "z"])
@pytest.mark.parametrize("n", [3, 10, 40])
def test_on_the_complete_graph_the_nearest_to_the_identity_has_the_rate_one(which, n, rng):
    question = GainProblem.from_formation(
        DesiredFormation.with_complete_graph(rng.normal(size=(n, 3))), which
    )
    L, Y = question.project_with_remainder(np.eye(n))
    assert question.is_complete and not Y.any()
    assert question.convergence_rate(L) == pytest.approx(1, abs=1e-12)


@pytest.mark.parametrize("n", [5, 6])
def test_where_nothing_has_a_trace_the_proof_is_a_matrix_on_the_non_edges(n, rng):
    question = GainProblem.from_formation(
        DesiredFormation(rng.uniform(0, 9, (n, 3)), ring(n)), "xy"
    )
    with pytest.raises(NoGainMatrix, match="no matrix with this graph") as verdict:
        question.project(np.eye(n))
    Y = verdict.value.dual
    Q = null_space(question.kernel.conj().T)
    assert not Y[~absent(question)].any()
    np.testing.assert_allclose(Q.conj().T @ Y @ Q, np.eye(n - 2), atol=1e-7)
    assert question.rate_bound(Y) < 0


def test_bad_conditions_do_not_show_in_the_residuals(rng):
    # A ring with one chord too few is nearly singular where its points are nearly in a row.
    points = np.stack([np.arange(8.0), 1e-3 * rng.random(8), rng.random(8)], axis=1)
    graph = ring(8) | joined(8, [(0, 2), (1, 3), (2, 4), (3, 5), (4, 6), (5, 7), (6, 0), (7, 1)])
    question = GainProblem.from_formation(DesiredFormation(points, graph), "xy")
    L = question.project(np.eye(8))
    assert np.abs(L @ question.kernel).max() < 1e-11 * max(1, np.abs(L).max())
