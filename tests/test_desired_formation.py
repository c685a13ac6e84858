"""Desired formation: kernels of its gains, and validation."""

import numpy as np
import pytest
from gain_examples import complete, ring
from hypothesis import given
from hypothesis import strategies as st

from dynamics.inputs import InputError
from problems.desired_formation import DesiredFormation, _validate_graph


def spans(kernel, column):
    return np.abs(column - kernel @ (kernel.conj().T @ column)).max()


@given(st.integers(3, 12), st.integers(0, 2**32 - 1), st.floats(0, 1e5))
def test_kernels_are_orthonormal_and_span_the_shape_at_any_offset(n, seed, away):
    rng = np.random.default_rng(seed)
    formation = DesiredFormation.with_complete_graph(rng.normal(size=(n, 3)) * [9, 9, 2] + away)
    for kernel, column in (
        (formation.kernel_xy, formation.planar_points),
        (formation.kernel_z, formation.points[:, 2]),
    ):
        assert kernel.shape == (n, 2)
        assert np.abs(kernel.conj().T @ kernel - np.eye(2)).max() < 1e-12
        assert spans(kernel, np.ones(n)) < 1e-12
        assert spans(kernel, column) < 1e-14 * n * (away + 100)


@pytest.mark.parametrize(("spread", "flat"), [(0.0, True), (0.009, True), (0.011, False)])
def test_heights_within_one_centimeter_of_their_middle_count_as_equal(spread, flat):
    square = np.array([[0.0, 0, 1], [9, 0, 1], [9, 9, 1], [0, 9, 1]])
    square[:, 2] += spread * np.array([1, -1, 1, -1])
    formation = DesiredFormation.with_complete_graph(square)
    assert formation.is_flat == flat
    assert formation.kernel_z.shape == (4, 1 if flat else 2)


def test_a_vertical_stack_has_one_horizontal_and_two_vertical_columns():
    stack = DesiredFormation.with_complete_graph(np.array([[5.3, -2.1, z] for z in (0.0, 2, 3, 7)]))
    assert stack.kernel_xy.shape == (4, 1) and stack.kernel_z.shape == (4, 2)


def test_collinear_points_have_two_horizontal_columns():
    row = DesiredFormation.with_complete_graph(np.array([[2.0 * k, -k, 1] for k in range(5)]))
    assert row.kernel_xy.shape == (5, 2) and row.is_flat


def changed(graph, pairs, value):
    graph = graph.copy()
    for i, j in pairs:
        graph[i, j] = value
    return graph


POINTS = np.random.default_rng(0).normal(size=(6, 3))
FULL = complete(6)
PARTS = np.kron(np.eye(2, dtype=bool), ~np.eye(3, dtype=bool))
LEAF = changed(FULL, [(5, k) for k in range(1, 6)] + [(k, 5) for k in range(1, 6)], False)


@pytest.mark.parametrize(
    ("points", "graph", "words"),
    [
        (POINTS[:2], FULL[:2, :2], "at least 3 points, got 2"),
        (POINTS[[0, 1, 2, 3, 1, 5]], FULL, "points 1 and 4 coincide"),
        (POINTS * [1, 1, np.nan], FULL, "points: must be an array of finite numbers"),
        (changed(POINTS, [(4, 2)], 1e20), FULL, r"point 4 is .* at most 1e\+09 m"),
        (POINTS, changed(FULL, [(3, 3)], True), "vertex 3 is its own neighbor"),
        (POINTS, changed(FULL, [(4, 2)], False), "edge 2–4 is missing .*: set 4–2"),
        (POINTS, PARTS, "no edge joins vertices 0, 1, 2 to the rest"),
        (POINTS, LEAF, "too sparse at vertex 5"),
    ],
)
def test_invalid_formations_are_refused_with_the_reason(points, graph, words):
    with pytest.raises(ValueError, match=words):
        DesiredFormation(points, graph)


def test_a_graph_of_another_size_is_refused():
    # In tests, the annotated shape would be refused before the validation runs.
    with pytest.raises(ValueError, match=r"5 points need a graph of 5 × 5, got \(6, 6\)"):
        _validate_graph(FULL, 5)


def test_a_disconnected_part_is_named_and_long_lists_are_cut(rng):
    n = 30
    graph = np.zeros((n, n), dtype=bool)
    graph[:12, :12], graph[12:, 12:] = ring(12), ring(18)
    with pytest.raises(ValueError, match="joins vertices 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, … to"):
        DesiredFormation(rng.normal(size=(n, 3)), graph)


def test_lists_and_integers_are_the_formation_of_the_same_numbers():
    points = np.round(5 * POINTS)
    formation = DesiredFormation(points.astype(int).tolist(), FULL.astype(int).tolist())
    assert np.array_equal(DesiredFormation(points, FULL.astype(float)).graph, FULL)
    assert np.array_equal(formation.points, points) and formation.points.dtype == float
    assert np.array_equal(formation.graph, FULL) and formation.graph.dtype == bool


@pytest.mark.parametrize(
    ("points", "graph", "told"),
    [
        (POINTS[:, :2], FULL, r"points: must be .* shape \(n, 3\), got .* shape \(6, 2\)"),
        (POINTS + 1j, FULL, "points: .*complex128"),
        (np.ma.masked_array(POINTS), FULL, "points: must not be a masked array"),
        ([[0, 0, 0], [1, 1]], FULL, "points: must have rows of one length"),
        (POINTS, FULL * 0.5, "graph: must be an array of True and False"),
        (POINTS, FULL * 2, "graph: must be an array of True and False"),
        (POINTS, None, "graph: must be an array of True and False"),
    ],
)
def test_what_is_no_matrix_of_points_or_edges_is_refused(points, graph, told):
    with pytest.raises(InputError, match=told):
        DesiredFormation(points, graph)
