"""Interaction graph: gradients against differences and CasADi, and symmetries."""

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose

from problems.interaction_graph import (
    Camera,
    algebraic_connectivity,
    connectivity_eigenvalues,
    interaction_graph,
    lambda2_gradient,
    laplacian,
    spectral_slope,
)

SIGHT = Camera()


def draw_swarm(rng, count=6):
    return rng.uniform(0, 1, (count, 3)) * [8, 8, 3], rng.uniform(-np.pi, np.pi, count)


def lambda2(position, yaw):
    return algebraic_connectivity(interaction_graph(position, yaw, SIGHT).weights).lambda2


def test_the_gradient_agrees_with_central_differences():
    rng, h = np.random.default_rng(2023), 1e-6
    for _ in range(200):
        position, yaw = draw_swarm(rng)
        found = lambda2_gradient(position, yaw, SIGHT)
        steps = h * np.eye(18).reshape(18, 6, 3)
        along = lambda2(position + steps, np.tile(yaw, (18, 1)))
        against = lambda2(position - steps, np.tile(yaw, (18, 1)))
        slope = ((along - against) / (2 * h)).reshape(6, 3)
        assert found.position == pytest.approx(slope, abs=1e-6)
        turns = h * np.eye(6)
        same = np.tile(position, (6, 1, 1))
        slope = (lambda2(same, yaw + turns) - lambda2(same, yaw - turns)) / (2 * h)
        assert found.yaw == pytest.approx(slope, abs=1e-6)
        assert found.position.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)


def symbolic_weight():
    """A_ij as the paper prints it in world coordinates."""

    def rise(x, low, high):
        inside = (1 - casadi.cos(casadi.pi * (x - low) / (high - low))) / 2
        return casadi.if_else(x <= low, 0, casadi.if_else(x >= high, 1, inside))

    p, q = casadi.SX.sym("p", 3), casadi.SX.sym("q", 3)
    a, b = casadi.SX.sym("a"), casadi.SX.sym("b")
    d = casadi.norm_2(q - p)

    def view(way, yaw):
        axis = casadi.vertcat(
            casadi.cos(yaw) * SIGHT.optical_axis[0] - casadi.sin(yaw) * SIGHT.optical_axis[1],
            casadi.sin(yaw) * SIGHT.optical_axis[0] + casadi.cos(yaw) * SIGHT.optical_axis[1],
            SIGHT.optical_axis[2],
        )
        return rise(casadi.dot(axis, way) / d, SIGHT.a_min, SIGHT.a_max)

    f, g = view(q - p, a), view(p - q, b)
    far = 1 - rise(d, SIGHT.d_far, SIGHT.d_max)
    weight = rise(d, SIGHT.d_min, SIGHT.d_near) * far * (f + g - f * g)
    slope = casadi.gradient(weight, casadi.vertcat(p, a))
    return casadi.Function("weight", [p, a, q, b], [weight, slope])


def test_weights_and_gradient_agree_with_the_printed_formulas():
    rng, weigh = np.random.default_rng(7), symbolic_weight()
    for _ in range(40):
        position, yaw = draw_swarm(rng)
        found = interaction_graph(position, yaw, SIGHT).weights
        felt = algebraic_connectivity(found).weight_gradient
        for i in range(6):
            slope = np.zeros(4)
            for j in range(6):
                if j != i:
                    weight, by = weigh(position[i], yaw[i], position[j], yaw[j])
                    assert found[i, j] == pytest.approx(float(weight), abs=1e-12)
                    slope += felt[i, j] * np.asarray(by).ravel()
            whole = lambda2_gradient(position, yaw, SIGHT)
            assert [*whole.position[i], whole.yaw[i]] == pytest.approx(slope, abs=1e-10)


@pytest.mark.parametrize("meeting", [False, True])
def test_slope_over_the_spectrum_is_that_of_the_summed_potential(rng, meeting):
    # On a complete graph of equal weights all eigenvalues are one, and the sum has a gradient.
    weight = np.full((6, 6), 0.4) if meeting else np.triu(rng.uniform(0.1, 1, (6, 6)), 1)
    weight = (weight + weight.T) / 2 if meeting else weight + weight.T
    np.fill_diagonal(weight, 0.0)
    everyone = np.ones(6, dtype=bool)

    def potential(w):
        return float((1 / np.linalg.eigvalsh(laplacian(w))[1:]).sum())

    lambda2, found = spectral_slope(weight, lambda x: -1 / x**2, everyone)
    assert lambda2 == pytest.approx(np.linalg.eigvalsh(laplacian(weight))[1])
    for _ in range(10):
        change = np.triu(rng.normal(size=(6, 6)), 1)
        change += change.T
        slope = (potential(weight + 1e-5 * change) - potential(weight - 1e-5 * change)) / 2e-5
        assert (np.triu(found, 1) * change).sum() == pytest.approx(slope, rel=1e-6, abs=1e-7)


def test_eigenvalues_of_members_are_those_of_the_graph_without_others(rng):
    weight = np.triu(rng.uniform(size=(7, 7)), 1)
    weight, members = weight + weight.T, np.array([True, False, True, True, False, True, True])
    alone = np.linalg.eigvalsh(laplacian(weight[np.ix_(members, members)]))
    found = algebraic_connectivity(weight, members)
    for values in (connectivity_eigenvalues(weight, members), found[:2]):
        assert np.array(values) == pytest.approx(alone[1:3])
    assert np.isinf(connectivity_eigenvalues(weight, members & (np.arange(7) < 2))).all()
    assert algebraic_connectivity(10 * weight, members)[:2] == pytest.approx(10 * alone[1:3])


def test_coinciding_agents_have_zero_weights_and_gradient():
    position, yaw = np.zeros((3, 3)), np.zeros(3)
    assert not interaction_graph(position, yaw, SIGHT).weights.any()
    assert not lambda2_gradient(position, yaw, SIGHT).position.any()


def test_the_gradient_of_a_multiple_eigenvalue_is_independent_of_the_basis(rng):
    # With equal weights λ₂ … λ_n coincide, and all edges have the same derivative.
    weight = np.ones((5, 5)) - np.eye(5)
    found = algebraic_connectivity(weight)
    assert found.lambda2 == pytest.approx(5) and found.lambda3 == pytest.approx(5)
    off = ~np.eye(5, dtype=bool)
    assert found.weight_gradient[off] == pytest.approx(
        np.full(20, found.weight_gradient[0, 1]), abs=1e-12
    )
    # An edge adds 2 to the trace, the sum of the four eigenvalues.
    assert found.weight_gradient[0, 1] == pytest.approx(2 / 4)
    h, more = 1e-6, weight.copy()
    more[0, 1] = more[1, 0] = 1 + h
    value = np.linalg.eigvalsh(laplacian(more))[1:]
    assert (value.mean() - 5) / h == pytest.approx(found.weight_gradient[0, 1], abs=1e-6)


def test_edges_weigh_one_and_one_agent_is_connected():
    graph = ~np.eye(4, dtype=bool)
    same = algebraic_connectivity(graph), algebraic_connectivity(graph.astype(float))
    for found, expected in zip(*same, strict=True):
        assert_allclose(found, expected)
    assert algebraic_connectivity(np.zeros((2, 1, 1))).lambda2.tolist() == [np.inf, np.inf]


def test_a_laplacian_in_place_of_weights_is_refused():
    path = np.eye(3, k=1) + np.eye(3, k=-1)
    assert_allclose(algebraic_connectivity(path).lambda2, 1.0, atol=1e-12)
    with pytest.raises(ValueError, match="weight: must not be negative; the weights are no Lap"):
        algebraic_connectivity(np.diag(path.sum(axis=1)) - path)
