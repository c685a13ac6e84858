"""Formations by name, at random and from files."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import pdist

from problems.gain_design import design_gains
from sato.shapes import Lattice, Text
from sato.shapes.formation_library import (
    formation_names,
    graph_from_edges,
    load_formation,
    make_formation,
    random_dense_graph,
    random_sparse_graph,
    read_formation,
    read_graph,
)
from sato.shapes.random_points import sample_formation, sample_positions

RESIDUAL = 1e-10  # largest residual of a gain matrix, whatever the method

# Vertices, edges and least horizontal distance [m] of each formation.
LIBRARY = {
    "swarm4/Square": (4, 6, 2.5),
    "swarm4/Line": (4, 6, 1.5),
    "swarm4/Diamond": (4, 6, 2.5),
    "swarm5/Line": (5, 10, 2.0),
    "swarm5/Pentagon": (5, 10, 4 * np.sin(np.pi / 5)),
    "swarm5/Square+1": (5, 10, 2.0),
    "swarm6/Star": (6, 12, 2.0),
    "swarm6/Hex": (6, 15, 2.0),
    "swarm6/Double Line": (6, 15, 2.0),
    "swarm6_3d/Pentagonal Pyramid": (6, 8, 2.0),
    "swarm6_3d/Triangular Prism": (6, 9, 2.0),
    "swarm6_3d/Slanted Plane": (6, 9, 2.0),
    "mitacl15/MIT": (15, 105, 4.5),
    "mitacl15/ACL": (15, 105, 1.5),
    "mitacl100/MIT ACL": (100, 1188, 2.0),
}
NOT_FLAT = {"swarm6_3d", "mitacl100", "mitacl15/MIT"}


def is_graph(graph):
    return np.array_equal(graph, graph.T) and not graph.diagonal().any()


# Names.


def test_library_has_the_documented_sizes_and_distances():
    assert formation_names() == tuple(LIBRARY)
    for name, (vertices, edges, spacing) in LIBRARY.items():
        shape = load_formation(name)
        assert shape.name == name
        assert (len(shape.points), shape.graph.sum() // 2) == (vertices, edges)
        assert pdist(shape.points[:, :2]).min() == pytest.approx(spacing, abs=1e-8)
        assert shape.is_flat == (not any(name.startswith(part) for part in NOT_FLAT))
        assert np.array_equal(load_formation(name, "complete").points, shape.points)
        assert load_formation(name, "complete").graph.sum() == vertices * (vertices - 1)


def test_mit_acl_is_an_inclined_plane_of_six_letters():
    shape = load_formation("mitacl100")
    assert np.ptp(shape.points, axis=0).tolist() == [63.0, 10.0, 10.0]
    assert np.array_equal(shape.points[:, 1], shape.points[:, 2])
    assert shape.graph.sum() / (100 * 99) == 0.24
    assert shape.graph.sum(axis=0).min() >= 4
    assert np.array_equal(shape.graph, load_formation("mitacl100").graph)
    x = np.sort(shape.points[:, 0])
    letters = np.split(x, np.flatnonzero(np.diff(x) > 2) + 1)
    assert list(map(len, letters)) == [27, 12, 15, 18, 14, 14]
    assert [np.ptp(letter) for letter in letters] == [10, 2, 8, 12, 6, 6]


@pytest.mark.parametrize(
    ("said", "meant"),
    [("star", "swarm6/Star"), ("SWARM6/star", "swarm6/Star"), ("mitacl100", "mitacl100/MIT ACL")],
)
def test_unique_part_of_a_name_is_enough(said, meant):
    assert load_formation(said).name == meant


@pytest.mark.parametrize(
    ("name", "near"),
    [
        ("line", "swarm4/Line or swarm5/Line"),
        ("pentagn", "swarm5/Pentagon"),
        ("swarm6/Stra", "swarm6/Star"),
        ("swarm4", "swarm4/Square, swarm4/Line or swarm4/Diamond"),
        ("???", "swarm4/Square, "),
    ],
)
def test_unknown_name_is_refused_with_similar_names(name, near):
    with pytest.raises(ValueError, match="no formation") as refused:
        load_formation(name)
    assert f'"{name}"' in str(refused.value) and near in str(refused.value)


# Gains of every formation.


@pytest.mark.parametrize("name", LIBRARY)
def test_every_formation_has_gains_for_its_own_and_the_complete_graph(name):
    for graph in ("own", "complete"):
        gains = design_gains(load_formation(name, graph))
        assert gains.convergence_rate > 0
        residuals = gains.residual_kernel, gains.residual_structure, gains.residual_graph
        assert max(residuals) <= RESIDUAL
    assert gains.convergence_rate == pytest.approx(1, abs=1e-9)


# Rates that the general solver finds, which no gains exceed by more than the last digit.
BEST = {
    "swarm6/Star": (0.6239, 0.8333),
    "swarm6_3d/Pentagonal Pyramid": (0.2957, 0.5528),
    "swarm6_3d/Triangular Prism": (0.7548, 0.8),
    "swarm6_3d/Slanted Plane": (0.7548, 0.8),
}


@pytest.mark.parametrize(("name", "best"), BEST.items())
def test_incomplete_graphs_reach_the_rate_of_the_general_solver(name, best):
    gains = design_gains(load_formation(name))
    rates, bounds = (gains.rate_xy, gains.rate_z), (gains.bound_xy, gains.bound_z)
    assert rates == pytest.approx(best, rel=0.01)
    for rate, bound in zip(rates, bounds, strict=True):
        assert rate <= bound + RESIDUAL <= 1.01 * rate


def test_base_of_the_pyramid_has_no_influence_on_the_height_of_the_apex():
    # All points of the base have one height, which says nothing about that of the apex.
    gains = design_gains(load_formation("Pentagonal Pyramid"))
    assert np.abs(gains.z[0]).max() <= RESIDUAL


# At random.


@pytest.mark.parametrize(
    ("draw", "box", "least"),
    [(sample_positions, (20.0, 20.0), 1.5), (sample_formation, (15.0, 15.0, 2.0), 2.0)],
)
@settings(max_examples=30)
@given(count=st.integers(2, 30), seed=st.integers(0, 2**32 - 1))
def test_random_points_are_apart_in_the_plane_and_in_their_box(draw, box, least, count, seed):
    points = draw(count, box, least, np.random.default_rng(seed))
    assert points.shape == (count, len(box))
    assert points.min() >= 0 and (points.max(axis=0) <= box).all()
    assert pdist(points[:, :2]).min() >= least


@pytest.mark.parametrize(
    ("draw", "box", "full"),
    [
        (sample_positions, (4.0, 4.0), "4 × 4 m is full after"),
        (sample_positions, (4.0, 4.0, 4.0), "4 × 4 × 4 m is full after"),
        (sample_positions, (4.0, 4.0, 0.1), "4 × 4 × 0.1 m is full after"),
        (sample_formation, (4.0, 4.0, 9.0), "4 × 4 × 9 m is full after"),
    ],
)
def test_full_box_is_refused_with_a_size_that_would_do(draw, box, full, rng):
    with pytest.raises(ValueError, match=full) as refused:
        draw(40, box, 2.0, rng)
    cure = str(refused.value).split("; ")[1].split(" m would do")[0]
    larger = tuple(float(side) for side in cure.split(" × "))
    assert len(draw(40, larger, 2.0, rng)) == 40


@pytest.mark.parametrize(
    ("count", "box", "separation", "message"),
    [
        (0, (1.0, 1.0, 1.0), 1.0, "count: must be an integer above 0"),
        (3, (1.0, 1.0), 1.0, "three sides, got 2"),
        (3, (1.0, 0.0, 1.0), 1.0, "positive sides"),
        (3, (1.0, 1.0, 1.0), -1.0, "separation: must be a finite number at least 0"),
        (3, (1.0, 1.0, 1.0), np.nan, "separation: must be a finite number"),
    ],
)
def test_impossible_random_formation_is_refused(count, box, separation, message, rng):
    with pytest.raises(ValueError, match=message):
        sample_formation(count, box, separation, rng)


@settings(max_examples=30)
@given(st.integers(4, 30), st.data())
def test_dense_graph_lacks_at_most_the_removed_edges(count, data):
    removals = data.draw(st.integers(0, count - 4))
    graph = random_dense_graph(count, removals, np.random.default_rng(removals))
    assert is_graph(graph)
    assert 0 <= count * (count - 1) - graph.sum() <= 2 * removals


@settings(max_examples=40)
@given(st.integers(4, 40), st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_sparse_graph_has_its_share_of_edges_and_is_connected(count, above, seed):
    rng = np.random.default_rng(seed)
    complete = count * (count - 1) // 2
    least = min(2 * count, complete)
    share = (least + above * (complete - least)) / complete
    graph = random_sparse_graph(rng.normal(size=(count, 3)), share, rng)
    assert is_graph(graph)
    assert graph.sum() // 2 == round(share * complete)
    assert connected_components(graph)[0] == 1
    assert graph.sum(axis=0).min() >= 3


@pytest.mark.parametrize("levels", [3, 4, 1000])
def test_sparsest_graph_has_gains_even_where_points_share_heights(levels, rng):
    for _ in range(4):
        points = rng.normal(size=(12, 3))
        points[:, 2] = rng.permutation(12) % levels
        graph = random_sparse_graph(points, 4 / 11, rng)
        assert graph.sum() == 4 * 12
        assert design_gains(make_formation(points, graph)).convergence_rate > 1e-6


def test_impossible_share_of_edges_is_refused_with_the_possible_range(rng):
    points = rng.normal(size=(20, 3))
    for share in (0.1, 1.1, -1.0):
        with pytest.raises(ValueError, match=r"of the 190 edges .* 0.2106 to 1 would do"):
            random_sparse_graph(points, share, rng)
    assert random_sparse_graph(points, 0.2106, rng).sum() == 80
    with pytest.raises(ValueError, match="at least 4 points, got 3"):
        random_sparse_graph(points[:3], 1.0, rng)


# Any points, and files.


def test_any_shape_makes_a_formation():
    flat = make_formation(Text("A", spacing=2.0).place(12, 2), name="A")
    assert (flat.points.shape, flat.is_flat, flat.name) == ((12, 3), True, "A")
    assert not make_formation(Lattice(spacing=2.0).place(13, 3)).is_flat
    with pytest.raises(ValueError, match="two or three coordinates, got 1"):
        make_formation(np.zeros((4, 1)))


@settings(max_examples=30)
@given(
    hnp.arrays(
        np.float64,
        st.tuples(st.integers(4, 9), st.integers(2, 3)),
        elements=st.floats(-100, 100, allow_subnormal=False),
        unique=True,
    )
)
def test_points_are_read_to_the_last_bit(tmp_path_factory, points):
    path = tmp_path_factory.mktemp("files") / "mine.csv"
    points = points + np.arange(len(points))[:, None]  # none coincides with another
    np.savetxt(path, points, "%.17g", ",", header="x_m,y_m,z_m"[: 4 * points.shape[1] - 1])
    formation = read_formation(path)
    assert np.array_equal(formation.points[:, : points.shape[1]], points)
    assert formation.name == "mine"


def test_header_comments_and_repeated_edges_change_nothing(tmp_path):
    plain, commented = tmp_path / "plain.csv", tmp_path / "commented.csv"
    plain.write_text("0,1\n1,2\n2,0\n")
    commented.write_text("\ufefffrom, to\n# a triangle\n1,0\n\n0, 1\n2,1\n0,2\n", encoding="utf-8")
    triangle = graph_from_edges(3, [(0, 1), (1, 2), (0, 2)])
    assert np.array_equal(read_graph(plain, 3), triangle)
    assert np.array_equal(read_graph(commented, 3), triangle)
