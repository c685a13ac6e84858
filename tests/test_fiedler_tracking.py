"""Tracking of λ₂ against full eigendecompositions."""

import numba
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from problems import fiedler_tracking as module
from problems.fiedler_tracking import DENSE_MAX_AGENTS, fiedler_vectors
from problems.interaction_graph import Camera, interaction_graph, laplacian


@numba.njit
def both(L, basis):
    return fiedler_vectors(L, basis)


def drifting(agents, seed, steps=30, speed=0.3, density=0.05):
    """Laplacians of a drifting swarm every 20 ms."""
    rng = np.random.default_rng(seed)
    side = (agents / density) ** (1 / 3)
    position, yaw = rng.uniform(0, side, (agents, 3)), rng.uniform(-np.pi, np.pi, agents)
    velocity, rate = speed * rng.standard_normal((agents, 3)), rng.standard_normal(agents)
    times = 0.02 * np.arange(steps)[:, None, None]
    return laplacian(
        interaction_graph(position + times * velocity, yaw + times[..., 0] * rate, Camera()).weights
    )


def agrees(L, lambda2, vectors):
    value = np.linalg.eigvalsh(L)
    assert lambda2 == pytest.approx(value[1], abs=1e-11)
    assert_allclose(vectors @ vectors.T, np.eye(len(vectors)), atol=1e-12)
    assert_allclose(vectors.sum(axis=1), 0, atol=1e-10)
    assert np.linalg.norm(L @ vectors.T - lambda2 * vectors.T, axis=0).max() < 2e-7


@given(st.sampled_from([3, 6, DENSE_MAX_AGENTS, DENSE_MAX_AGENTS + 1, 40]), st.integers(0, 10_000))
def test_tracking_a_drifting_swarm_agrees_with_the_full_decomposition(agents, seed):
    basis = np.random.default_rng(seed).standard_normal((3, agents))
    for L in drifting(agents, seed, steps=8):
        value = np.linalg.eigvalsh(L)
        lambda2, vectors = both(L, basis)
        if value[1] > 1e-3:  # otherwise 0 is a multiple eigenvalue but for rounding
            agrees(L, lambda2, vectors)
        assert lambda2 == pytest.approx(value[1], abs=1e-11)


@given(st.integers(0, 10_000))
def test_an_unrelated_new_graph_is_solved_correctly(seed):
    one, other = drifting(30, seed, steps=1)[0], drifting(30, seed + 1, steps=1)[0]
    basis = np.random.default_rng(seed).standard_normal((3, 30))
    both(one, basis)
    assert both(other, basis)[0] == pytest.approx(np.linalg.eigvalsh(other)[1], abs=1e-11)


def test_eigenvectors_of_other_eigenvalues_are_rejected():
    # Exact eigenvectors of larger eigenvalues are fixed points of the iteration.
    L = drifting(40, 3, steps=1)[0]
    value, vector = np.linalg.eigh(L)
    assert value[5] > 1.1 * value[1] > 0
    basis = np.ascontiguousarray(vector[:, 5:8].T)
    agrees(L, *both(L, basis))


@pytest.mark.parametrize("agents", [5, DENSE_MAX_AGENTS + 10])
def test_all_eigenvectors_of_a_repeated_eigenvalue_are_returned(agents):
    L = agents * np.eye(agents) - np.ones((agents, agents))
    basis = np.random.default_rng(0).standard_normal((3, agents))
    for _ in range(3):
        lambda2, vectors = both(L, basis)
        assert lambda2 == pytest.approx(agents, rel=1e-12)
        assert len(vectors) == agents - 1


def test_a_double_eigenvalue_returns_two_vectors():
    ring = np.roll(np.eye(30), 1, axis=0)
    L = 2 * np.eye(30) - ring - ring.T
    basis = np.random.default_rng(0).standard_normal((3, 30))
    for _ in range(3):
        lambda2, vectors = both(L, basis)
        assert len(vectors) == 2
        agrees(L, lambda2, vectors)


def test_inverse_iteration_nearly_always_suffices_on_a_drifting_swarm():
    @numba.njit
    def follow(L, basis, value):
        return module._inverse_iteration(L, basis, value)

    swarm, value = drifting(60, 1, steps=100), np.zeros(3)
    basis = np.ascontiguousarray(np.linalg.eigh(swarm[0])[1][:, 1:4].T)
    assert sum(follow(L, basis, value) for L in swarm) >= 98
