"""Formations by name, at random and from files, and the command that designs their gains."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import pdist
from typer.testing import CliRunner, Result

from problems.gain_design import GainMatrix, design_gains
from sato import gains_command, shapes
from sato.cli import app
from sato.shapes.formation_files import (
    read_formation,
    read_graph,
    read_with_graph,
    write_graph,
    write_points,
)
from sato.shapes.formation_library import (
    formation_names,
    graph_from_edges,
    load_formation,
    make_formation,
)
from sato.shapes.random_points import (
    random_dense_graph,
    random_sparse_graph,
    sample_formation,
    sample_positions,
)

RESIDUAL = 1e-10  # what is promised of every gain matrix, however it was found

# What is known of each: vertices, edges, and the least distance as it is seen from above [m].
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
RISING = {"swarm6_3d", "mitacl100", "mitacl15/MIT"}


def degrees(graph):
    return graph.sum(axis=0)


def is_graph(graph):
    return np.array_equal(graph, graph.T) and not graph.diagonal().any()


# Names.


def test_the_library_is_what_it_is_said_to_be():
    assert formation_names() == tuple(LIBRARY)
    for name, (vertices, edges, spacing) in LIBRARY.items():
        shape = load_formation(name)
        assert shape.name == name
        assert (len(shape.points), shape.graph.sum() // 2) == (vertices, edges)
        assert pdist(shape.points[:, :2]).min() == pytest.approx(spacing, abs=1e-8)
        assert shape.is_flat == (not any(name.startswith(part) for part in RISING))
        assert np.array_equal(load_formation(name, "complete").points, shape.points)
        assert load_formation(name, "complete").graph.sum() == vertices * (vertices - 1)


def test_mit_acl_is_a_sheet_that_leans_back_with_24_percent_of_the_edges():
    shape = load_formation("mitacl100")
    assert np.ptp(shape.points, axis=0).tolist() == [63.0, 10.0, 10.0]
    assert np.array_equal(shape.points[:, 1], shape.points[:, 2])
    assert shape.graph.sum() / (100 * 99) == 0.24
    assert degrees(shape.graph).min() >= 4
    assert np.array_equal(shape.graph, load_formation("mitacl100").graph)


def test_mit_acl_is_of_six_letters_as_they_were_drawn():
    x = np.sort(load_formation("mitacl100").points[:, 0])
    letters = np.split(x, np.flatnonzero(np.diff(x) > 2) + 1)
    assert list(map(len, letters)) == [27, 12, 15, 18, 14, 14]
    assert [np.ptp(letter) for letter in letters] == [10, 2, 8, 12, 6, 6]


def test_part_of_a_name_will_do_where_it_is_the_only_one():
    for said, meant in {
        "star": "swarm6/Star",
        "SWARM6/star": "swarm6/Star",
        "mitacl100": "mitacl100/MIT ACL",
        "pentagonal pyramid": "swarm6_3d/Pentagonal Pyramid",
    }.items():
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
def test_a_name_that_is_not_in_the_library_is_refused_with_those_that_are_close(name, near):
    with pytest.raises(ValueError, match="no formation") as refused:
        load_formation(name)
    assert f'"{name}"' in str(refused.value) and near in str(refused.value)


def test_a_graph_of_another_kind_is_refused():
    with pytest.raises(ValueError, match='"own" graph or the "complete"'):
        load_formation("swarm6/Star", "sparse")


# Gains of every formation.


@pytest.mark.parametrize("name", LIBRARY)
def test_every_formation_has_gains_for_its_own_graph_and_for_the_complete_one(name):
    for graph in ("own", "complete"):
        gains = design_gains(load_formation(name, graph))
        assert gains.convergence_rate > 0
        residuals = gains.residual_kernel, gains.residual_structure, gains.residual_graph
        assert max(residuals) <= RESIDUAL
    assert gains.convergence_rate == pytest.approx(1, abs=1e-9)


# The general solver's answer, which no gains exceed by more than its last digit.
BEST = {
    "swarm6/Star": (0.6239, 0.8333),
    "swarm6_3d/Pentagonal Pyramid": (0.2957, 0.5528),
    "swarm6_3d/Triangular Prism": (0.7548, 0.8),
    "swarm6_3d/Slanted Plane": (0.7548, 0.8),
}


@pytest.mark.parametrize(("name", "best"), BEST.items())
def test_graphs_that_are_not_complete_have_the_rate_of_the_general_solver(name, best):
    gains = design_gains(load_formation(name))
    for rate, bound, reach in zip(
        (gains.rate_xy, gains.rate_z), (gains.bound_xy, gains.bound_z), best, strict=True
    ):
        assert rate == pytest.approx(reach, rel=0.01)
        assert rate <= bound + RESIDUAL <= 1.01 * rate


def test_the_apex_of_the_pyramid_rises_by_itself():
    # The base is of one height, and five who are level say nothing of a sixth who is not.
    gains = design_gains(load_formation("Pentagonal Pyramid"))
    assert np.abs(gains.z[0]).max() <= RESIDUAL


# At random.


@settings(max_examples=30)
@given(st.integers(1, 40), st.integers(0, 2**32 - 1))
def test_starts_are_apart_and_in_their_box(count, seed):
    places = sample_positions(count, (20.0, 20.0), 1.5, np.random.default_rng(seed))
    assert places.shape == (count, 2)
    assert places.min() >= 0 and places.max() <= 20
    assert count == 1 or pdist(places).min() >= 1.5


@settings(max_examples=30)
@given(st.integers(3, 30), st.integers(0, 2**32 - 1))
def test_random_formations_are_apart_when_seen_from_above(count, seed):
    points = sample_formation(count, (15.0, 15.0, 2.0), 2.0, np.random.default_rng(seed))
    assert points.shape == (count, 3)
    assert points.min() >= 0 and (points.max(axis=0) <= [15, 15, 2]).all()
    assert pdist(points[:, :2]).min() >= 2


def test_what_is_drawn_depends_on_the_generator_alone():
    first, again, other = (
        sample_formation(9, (15.0, 15.0, 2.0), 2.0, np.random.default_rng(seed))
        for seed in (1, 1, 2)
    )
    assert np.array_equal(first, again) and not np.array_equal(first, other)


@pytest.mark.parametrize(
    ("draw", "box", "full"),
    [
        (sample_positions, (4.0, 4.0), "4 × 4 m is full after"),
        (sample_positions, (4.0, 4.0, 4.0), "4 × 4 × 4 m is full after"),
        (sample_positions, (4.0, 4.0, 0.1), "4 × 4 × 0.1 m is full after"),
        (sample_formation, (4.0, 4.0, 9.0), "4 × 4 × 9 m is full after"),
    ],
)
def test_what_does_not_fit_is_refused_with_a_box_that_would_do(draw, box, full, rng):
    with pytest.raises(ValueError, match=full) as refused:
        draw(40, box, 2.0, rng)
    said = str(refused.value).split("; ")[1].split(" m would do")[0]
    larger = tuple(float(side) for side in said.split(" × "))
    assert len(draw(40, larger, 2.0, rng)) == 40


@pytest.mark.parametrize(
    ("count", "box", "separation", "words"),
    [
        (0, (1.0, 1.0, 1.0), 1.0, "at least one"),
        (3, (1.0, 1.0), 1.0, "three sides, got 2"),
        (3, (1.0, 0.0, 1.0), 1.0, "positive sides"),
        (3, (1.0, 1.0, 1.0), -1.0, "separation must not be negative"),
        (3, (1.0, 1.0, 1.0), np.nan, "separation must not be negative"),
    ],
)
def test_a_random_formation_of_nonsense_is_refused(count, box, separation, words, rng):
    with pytest.raises(ValueError, match=words):
        sample_formation(count, box, separation, rng)


@settings(max_examples=30)
@given(st.integers(4, 30), st.data())
def test_a_thinned_graph_lacks_at_most_the_pairs_that_were_removed(count, data):
    removals = data.draw(st.integers(0, count - 4))
    graph = random_dense_graph(count, removals, np.random.default_rng(removals))
    assert is_graph(graph)
    assert 0 <= count * (count - 1) - graph.sum() <= 2 * removals


@settings(max_examples=40)
@given(st.integers(4, 40), st.floats(0, 1), st.integers(0, 2**32 - 1))
def test_a_sparse_graph_has_its_share_and_holds_together(count, above, seed):
    rng = np.random.default_rng(seed)
    every = count * (count - 1) // 2
    least = min(2 * count, every)
    share = (least + above * (every - least)) / every
    graph = random_sparse_graph(rng.normal(size=(count, 3)), share, rng)
    assert is_graph(graph)
    assert graph.sum() // 2 == round(share * every)
    assert connected_components(graph)[0] == 1
    assert degrees(graph).min() >= 3


@pytest.mark.parametrize("levels", [3, 4, 1000])
def test_the_sparsest_graph_still_has_gains_also_where_heights_are_few(levels, rng):
    for _ in range(4):
        points = rng.normal(size=(12, 3))
        points[:, 2] = rng.permutation(12) % levels
        graph = random_sparse_graph(points, 4 / 11, rng)
        assert graph.sum() == 4 * 12
        assert design_gains(make_formation(points, graph)).convergence_rate > 1e-6


def test_a_share_that_cannot_be_is_refused_with_those_that_can(rng):
    points = rng.normal(size=(20, 3))
    for share in (0.1, 1.1, -1.0):
        with pytest.raises(ValueError, match=r"of the 190 edges .* 0.2106 to 1 would do"):
            random_sparse_graph(points, share, rng)
    assert random_sparse_graph(points, 0.2106, rng).sum() == 80
    with pytest.raises(ValueError, match="at least 4 points, got 3"):
        random_sparse_graph(points[:3], 1.0, rng)


# Any points, and files.


def test_any_shape_becomes_a_formation():
    flat = make_formation(shapes.text("A", 12, spacing=2.0), name="A")
    assert (flat.points.shape, flat.is_flat, flat.name) == ((12, 3), True, "A")
    assert not make_formation(shapes.lattice(13, dimension=3, spacing=2.0)).is_flat
    with pytest.raises(ValueError, match="two or three coordinates, got 1"):
        make_formation(np.zeros((4, 1)))


@settings(max_examples=30)
@given(
    hnp.arrays(
        np.float64,
        st.tuples(st.integers(4, 9), st.integers(2, 3)),
        elements=st.floats(-100, 100, allow_subnormal=False),
        unique=True,
    ),
    st.integers(0, 99),
)
def test_points_and_graph_come_back_from_their_files_to_the_last_bit(
    tmp_path_factory, points, seed
):
    folder = tmp_path_factory.mktemp("files")
    points = points + np.arange(len(points))[:, None]  # none too close to another
    graph = random_sparse_graph(points, 1.0, np.random.default_rng(seed))
    graph[0, 1] = graph[1, 0] = False
    write_points(folder / "mine.csv", points)
    write_graph(folder / "graph.csv", graph)
    shape = read_with_graph(read_formation(folder / "mine.csv"), folder / "graph.csv")
    assert np.array_equal(shape.points[:, : points.shape[1]], points)
    assert np.array_equal(shape.graph, graph)
    assert shape.name == "mine"


def test_titles_comments_and_repeated_pairs_change_nothing(tmp_path):
    plain, dressed = tmp_path / "plain.csv", tmp_path / "dressed.csv"
    plain.write_text("0,1\n1,2\n2,0\n")
    dressed.write_text("\ufefffrom, to\n# a triangle\n1,0\n\n0, 1\n2,1\n0,2\n", encoding="utf-8")
    triangle = graph_from_edges(3, [(0, 1), (1, 2), (0, 2)])
    assert np.array_equal(read_graph(plain, 3), triangle)
    assert np.array_equal(read_graph(dressed, 3), triangle)


# The command.

TRIANGLE = "x,y,z\n0,0,0\n3,0,1\n0,3,2\n"
SQUARE = "0,0\n3,0\n3,3\n0,3\n"
TWO_PARTS = "0,0\n3,0\n3,3\n9,9\n9,5\n5,9\n"


@pytest.fixture
def home(tmp_path, monkeypatch):
    for name, content in {"triangle": TRIANGLE, "square": SQUARE, "parts": TWO_PARTS}.items():
        (tmp_path / f"{name}.csv").write_text(content)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def call(*words: str) -> Result:
    return CliRunner().invoke(app, ["gains", *words])


def refusal(result: Result) -> str:
    said = result.stderr.strip()
    assert said.startswith("sato: ") and "\n" not in said
    return said


def written(home: Path) -> list[str]:
    return sorted(path.relative_to(home).as_posix() for path in home.rglob("*.npz"))


def test_gains_of_the_library_are_certified_and_written(home):
    result = call("pentagonal pyramid")
    assert result.exit_code == 0, result.output
    for words in ("6 vertices, 8 edges (53.3 %)", "0.29", "flexible", "A N"):
        assert words in result.stdout
    assert written(home) == ["gains/swarm6_3d-Pentagonal-Pyramid.npz"]
    kept = GainMatrix.load(home / written(home)[0])
    assert kept.matches_formation(load_formation("pentagonal pyramid"))
    assert kept.rate_xy == pytest.approx(0.2957, rel=0.01)


def test_a_gap_that_is_rounding_is_told_as_none(home, monkeypatch):
    # One who is faster than the bound by a rounding is not −0.0000 % short of it.
    exact = design_gains(load_formation("hex"))
    found = replace(exact, bound_xy=exact.rate_xy - 1e-15, bound_z=exact.rate_z - 1e-15)
    monkeypatch.setattr(gains_command, "design", lambda *_: found)
    said = call("hex").stdout
    assert "short of it by" in said and "-0.0" not in said


def test_gains_of_files_are_for_their_points_and_graph(home):
    (home / "ring.csv").write_text("0,1\n1,2\n2,3\n3,0\n0,2\n")
    result = call("square.csv", "--graph", "ring.csv", "--out", "here/mine.npz")
    assert result.exit_code == 0, result.output
    assert "4 vertices, 5 edges (83.3 %)" in result.stdout
    kept = GainMatrix.load(home / "here" / "mine.npz")
    assert kept.formation.graph.sum() == 10 and not kept.formation.graph[1, 3]
    assert [p.name for p in (home / "here").iterdir()] == ["mine.npz"]


def test_the_complete_graph_may_be_asked_for_instead_of_the_own(home):
    assert call("star", "--graph", "complete", "--out", "star.npz").exit_code == 0
    assert GainMatrix.load("star.npz").convergence_rate == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("method", ["sdp", "admm", "paper"])
def test_a_method_may_be_asked_for(home, method):
    result = call("star", "--method", method)
    assert result.exit_code == 0, result.output
    assert method in result.stdout


# What is in bad.csv, the words after "sato gains", and what the sentence must name.
REFUSED = {
    "no formation": ("", [], ["NAME or FILE.csv", "--list"]),
    "no such name": ("", ["swarm6/Sta"], ['"swarm6/Sta"', "did you mean swarm6/Star"]),
    "no such file": ("", ["absent.csv"], ["there is no file absent.csv"]),
    "two points": ("0,0\n1,1\n", ["bad.csv"], ["bad.csv", "at least 3 points, got 2"]),
    "coincident points": ("x,y\n0,0\n1,1\n0,0\n", ["bad.csv"], ["bad.csv", "lines 2 and 4"]),
    "a word for a number": ("0,0\n1,one\n", ["bad.csv"], ["bad.csv, line 2", "one"]),
    "an infinite coordinate": ("0,0\n1,inf\n", ["bad.csv"], ["bad.csv, line 2", "not finite"]),
    "a huge coordinate": ("0,0\n# far\n1,1e200\n", ["bad.csv"], ["bad.csv, line 3", "1e+09 m"]),
    "four columns": ("0,0,0,0\n", ["bad.csv"], ["bad.csv, line 1", "2 or 3 columns", "got 4"]),
    "no points": ("# nothing\n", ["bad.csv"], ["bad.csv lists no points"]),
    "no such graph": ("", ["star", "--graph", "compleet"], ["--graph", "complete", '"compleet"']),
    "no such method": ("", ["star", "--method", "sdpp"], ["--method", "sdp, paper", '"sdpp"']),
    "another ending": ("", ["star", "--out", "star.txt"], ["star.txt", ".npz"]),
    "nowhere to write": ("", ["star", "--out", "bad.csv/a.npz"], ["cannot be written to"]),
}
GRAPHS = {
    "two parts": ("parts", "0,1\n1,2\n2,0\n3,4\n4,5\n5,3\n", ["bad.csv", "vertices 0, 1, 2"]),
    "too sparse": ("square", "0,1\n1,2\n2,3\n", ["bad.csv", "too sparse at vertices 0, 3"]),
    "a vertex left out": ("square", "0,1\n1,2\n2,0\n", ["bad.csv", "vertex 3"]),
    "out of range": ("square", "0,1\n1,4\n", ["bad.csv, line 2", "no vertex 4", "0 to 3"]),
    "counted from 1": ("square", "1,2\n2,3\n3,4\n", ["bad.csv, line 3", "no vertex 4"]),
    "negative": ("square", "# pairs\n-1,2\n", ["bad.csv, line 2", "no vertex -1"]),
    "a loop": ("square", "i,j\n2,2\n", ["bad.csv, line 2", "vertex 2", "its own neighbour"]),
    "three columns": ("square", "0,1,2\n", ["bad.csv, line 1", "pair", "got 3"]),
    "a letter for a digit": ("square", "O1,2\n", ["bad.csv, line 1", "whole numbers", "O"]),
    "a broken number": ("square", "0,1.5\n", ["bad.csv, line 1", "whole numbers", "1.5"]),
    "no pairs": ("square", "i,j\n", ["bad.csv lists no pairs"]),
}


@pytest.mark.parametrize(("bad", "words", "said"), REFUSED.values(), ids=REFUSED.keys())
def test_bad_input_is_refused_in_a_sentence_and_nothing_is_written(home, bad, words, said):
    (home / "bad.csv").write_text(bad)
    result = call(*words)
    assert result.exit_code == 2
    for word in said:
        assert word in refusal(result)
    assert written(home) == [] and not (home / "gains").exists()


@pytest.mark.parametrize(("points", "pairs", "said"), GRAPHS.values(), ids=GRAPHS.keys())
def test_a_bad_graph_is_refused_by_file_and_line(home, points, pairs, said):
    (home / "bad.csv").write_text(pairs)
    result = call(f"{points}.csv", "--graph", "bad.csv")
    assert result.exit_code == 2
    for word in said:
        assert word in refusal(result)
    assert written(home) == [] and not (home / "gains").exists()


def test_where_no_gains_exist_it_is_said_and_nothing_is_written(home):
    (home / "ring.csv").write_text("0,1\n1,2\n2,3\n3,0\n")
    (home / "bent.csv").write_text("0,0,0\n3,0,1\n3,3,0\n0,3,1\n")
    result = call("bent.csv", "--graph", "ring.csv")
    assert result.exit_code == 1
    assert "gain" in refusal(result)
    assert written(home) == [] and not (home / "gains").exists()


def test_gains_that_are_there_survive_a_disk_that_fills_up(home, monkeypatch):
    assert call("star", "--out", "star.npz").exit_code == 0
    before = (home / "star.npz").read_bytes()

    def full(self: GainMatrix, path: str | Path) -> None:
        Path(path).write_bytes(before[:100])
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(GainMatrix, "save", full)
    result = call("hex", "--out", "star.npz")
    assert result.exit_code == 1
    assert "No space left on device" in refusal(result)
    assert (home / "star.npz").read_bytes() == before
    assert not list(home.glob(".saving-*"))


def test_the_library_is_listed_a_line_each(home):
    result = call("--list")
    assert result.exit_code == 0
    lines = result.stdout.strip().split("\n")
    assert [line.split("  ")[0] for line in lines] == list(LIBRARY)
    assert "100 vertices, 1188 edges (24 %)" in lines[-1]


def test_help_loads_nothing_that_takes_long():
    code = (
        "import sys; from typer.testing import CliRunner; from sato.cli import app;"
        "assert CliRunner().invoke(app, ['gains', '--help']).exit_code == 0;"
        "print(*sorted({'numpy', 'scipy', 'cvxpy', 'rich'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
