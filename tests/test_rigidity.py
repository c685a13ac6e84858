"""Rigidity: against counting, connectivity and named graphs."""

from itertools import combinations

import numpy as np
import pytest
from gain_examples import complete, graph_of, joined_parts, random_graph, ring
from numpy.testing import assert_allclose
from scipy.sparse.csgraph import connected_components

from problems.rigidity import is_globally_rigid, is_redundantly_rigid, is_rigid, rigidity_matrix


def without(graph, i, j):
    return graph & ~graph_of(len(graph), [(i, j)])


def bipartite(a, b):
    return graph_of(a + b, [(i, a + j) for i in range(a) for j in range(b)])


def test_the_rigidity_matrix_is_the_derivative_of_squared_lengths(rng):
    points, graph, v = rng.normal(size=(6, 3)), random_graph(rng, 6, 0.6), rng.normal(size=(6, 3))
    i, j = np.nonzero(np.triu(graph, 1))

    def halves(t):
        moved = points + t * v
        return np.sum((moved[i] - moved[j]) ** 2, axis=1) / 2

    slope = (halves(1e-6) - halves(-1e-6)) / 2e-6
    assert_allclose(rigidity_matrix(points, graph) @ v.ravel(), slope, atol=1e-8)


def laman(graph):
    """Rigid in the plane, by counting: 2n − 3 edges, at most 2k − 3 of them among any k."""
    n = len(graph)
    pairs = list(zip(*np.nonzero(np.triu(graph, 1)), strict=True))
    crowds = [set(c) for k in range(2, n + 1) for c in combinations(range(n), k)]
    return any(
        all(sum(i in c and j in c for i, j in some) <= 2 * len(c) - 3 for c in crowds)
        for some in combinations(pairs, 2 * n - 3)
    )


def test_rigidity_in_the_plane_agrees_with_the_count_of_laman(rng):
    verdicts = set()
    for _ in range(25):
        graph = random_graph(rng, 5, 0.75)
        verdicts.add(is_rigid(graph, 2, rng))
        assert is_rigid(graph, 2, rng) == laman(graph)
    assert verdicts == {True, False}


@pytest.mark.parametrize("dimension", [2, 3])
def test_redundantly_rigid_graphs_are_rigid_without_any_one_edge(rng, dimension):
    verdicts = set()
    for _ in range(40):
        graph = random_graph(rng, 7, rng.uniform(0.6, 1))
        pairs = zip(*np.nonzero(np.triu(graph, 1)), strict=True)
        one_by_one = all(is_rigid(without(graph, i, j), dimension, rng) for i, j in pairs)
        verdicts.add(one_by_one)
        assert is_redundantly_rigid(graph, dimension, rng) == one_by_one
    assert verdicts == {True, False}


def three_connected(graph):
    n = len(graph)
    rests = (np.setdiff1d(range(n), pair) for pair in combinations(range(n), 2))
    return all(connected_components(graph[np.ix_(r, r)])[0] == 1 for r in rests)


def test_globally_rigid_is_redundantly_rigid_and_three_connected(rng):
    # [Jackson2005]
    verdicts = set()
    for _ in range(60):
        graph = random_graph(rng, 8, rng.uniform(0.35, 0.7))
        expected = is_redundantly_rigid(graph, 2, rng) and three_connected(graph)
        verdicts.add(expected)
        assert is_globally_rigid(graph, 2, rng) == expected
    assert verdicts == {True, False}


@pytest.mark.parametrize(
    ("name", "graph", "dimension", "rigid", "redundant", "unique"),
    [
        ("triangle", complete(3), 2, True, False, True),
        ("square", ring(4), 2, False, False, False),
        ("square, one diagonal", without(complete(4), 0, 1), 2, True, False, False),
        ("K4", complete(4), 2, True, True, True),
        ("K3,3", bipartite(3, 3), 2, True, False, False),
        ("K3,4", bipartite(3, 4), 2, True, True, True),
        ("tetrahedron", complete(4), 3, True, False, True),
        ("octahedron", complete(6) & ~np.eye(6, k=3, dtype=bool) & ~np.eye(6, k=-3, dtype=bool),
         3, True, False, False),
        ("K5", complete(5), 3, True, True, True),
        ("K4,6", bipartite(4, 6), 3, True, False, False),
        ("K5,5", bipartite(5, 5), 3, True, True, False),  # [Connelly1991]
    ],
)  # fmt: skip
def test_named_graphs_are_as_in_the_literature(
    rng, name, graph, dimension, rigid, redundant, unique
):
    assert is_rigid(graph, dimension, rng) == rigid
    assert is_redundantly_rigid(graph, dimension, rng) == redundant
    assert is_globally_rigid(graph, dimension, rng) == unique


def test_the_double_banana_has_enough_edges_and_is_flexible(rng):
    graph = without(joined_parts([0, 1, 2, 3, 4], [0, 1, 5, 6, 7]), 0, 1)
    assert graph.sum() == 2 * (3 * 8 - 6)
    assert np.linalg.matrix_rank(rigidity_matrix(rng.normal(size=(8, 3)), graph)) == 3 * 8 - 6 - 1
    assert not is_rigid(graph, 3, rng)


def test_points_on_a_conic_are_flexible_where_generic_points_are_not(rng):
    # K3,3 moves exactly if its points lie on a conic.
    angle = rng.uniform(0, 2 * np.pi, 6)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    assert is_rigid(bipartite(3, 3), 2, rng)
    assert np.linalg.matrix_rank(rigidity_matrix(circle, bipartite(3, 3))) == 2 * 6 - 3 - 1


def test_few_points_are_rigid_on_the_complete_graph_alone(rng):
    assert is_rigid(complete(2), 2, rng) and is_rigid(complete(3), 3, rng)
    assert is_globally_rigid(complete(2), 3, rng)
    assert not is_rigid(graph_of(3, [(0, 1), (1, 2)]), 3, rng)
    assert not is_globally_rigid(without(complete(4), 0, 1), 3, rng)
