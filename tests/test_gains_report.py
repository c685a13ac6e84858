"""`sato gains`: formations by name or from files, and the gains that are written."""

from dataclasses import replace
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from problems.gain_design import GainMatrix, design_gains
from sato import gains_report as command
from sato.cli import app
from sato.shapes.formation_library import formation_names, load_formation

TRIANGLE = "x,y,z\n0,0,0\n3,0,1\n0,3,2\n"
SQUARE = "0,0\n3,0\n3,3\n0,3\n"
TWO_PARTS = "0,0\n3,0\n3,3\n9,9\n9,5\n5,9\n"


@pytest.fixture
def home(tmp_path, monkeypatch):
    for name, content in {"triangle": TRIANGLE, "square": SQUARE, "parts": TWO_PARTS}.items():
        (tmp_path / f"{name}.csv").write_text(content)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def call(*args: str) -> Result:
    return CliRunner().invoke(app, ["gains", *args])


def check_refusal(home: Path, code: int, message: list[str], *args: str) -> None:
    """Check that the command refuses in one line, and writes nothing."""
    result = call(*args)
    assert result.exit_code == code
    said = result.stderr.strip()
    assert said.startswith("sato: ") and "\n" not in said
    for text in message:
        assert text in said
    assert not list(home.rglob("*.npz")) and not (home / "gains").exists()


def test_gains_of_the_library_are_verified_and_written(home):
    result = call("pentagonal pyramid")
    assert result.exit_code == 0, result.output
    for text in ("6 vertices, 8 edges (53.3 %)", "0.29", "flexible", "A N"):
        assert text in result.stdout
    kept = GainMatrix.load(home / "gains" / "swarm6_3d-Pentagonal-Pyramid.npz")
    assert kept.matches_formation(load_formation("pentagonal pyramid"))
    assert kept.rate_xy == pytest.approx(0.2957, rel=0.01)


def test_joint_gains_have_one_rate_and_one_bound(home):
    result = call("pentagonal pyramid", "--joint", "--out", "joint.npz")
    assert result.exit_code == 0, result.output
    assert result.stdout.count("0.3499") + result.stdout.count("0.3500") == 6
    assert "--joint" not in result.stdout and "--joint" in call("pentagonal pyramid").stdout
    kept = GainMatrix.load(home / "joint.npz")
    assert kept.rate_xy == pytest.approx(kept.rate_z, rel=1e-9)


def test_gap_below_rounding_is_printed_as_zero(home, monkeypatch):
    # A rate that exceeds its bound by a rounding is not −0.0000 % below it.
    exact = design_gains(load_formation("hex"))
    found = replace(exact, bound_xy=exact.rate_xy - 1e-15, bound_z=exact.rate_z - 1e-15)
    monkeypatch.setattr(command, "design_gains", lambda *_, **__: found)
    printed = call("hex").stdout
    assert "short of it by" in printed and "-0.0" not in printed


def test_gains_of_files_are_for_their_points_and_graph(home):
    (home / "ring.csv").write_text("0,1\n1,2\n2,3\n3,0\n0,2\n")
    result = call("square.csv", "--graph", "ring.csv", "--out", "here/mine.npz")
    assert result.exit_code == 0, result.output
    assert "4 vertices, 5 edges (83.3 %)" in result.stdout
    kept = GainMatrix.load(home / "here" / "mine.npz")
    assert kept.formation.graph.sum() == 10 and not kept.formation.graph[1, 3]
    assert [p.name for p in (home / "here").iterdir()] == ["mine.npz"]


def test_complete_graph_replaces_the_own_on_request(home):
    assert call("star", "--graph", "complete", "--out", "star.npz").exit_code == 0
    assert GainMatrix.load("star.npz").convergence_rate == pytest.approx(1, abs=1e-9)


@pytest.mark.parametrize("method", ["sdp", "admm", "paper"])
def test_every_method_writes_gains(home, method):
    result = call("star", "--method", method)
    assert result.exit_code == 0, result.output
    assert method in result.stdout


# Content of bad.csv, arguments of `sato gains`, and text that the message must contain.
REFUSED = {
    "no formation": ("", [], ["NAME or FILE.csv", "--list"]),
    "no such name": ("", ["swarm6/Sta"], ['"swarm6/Sta"', "did you mean swarm6/Star"]),
    "no such file": ("", ["absent.csv"], ["absent.csv cannot be read as a list", "No such file"]),
    "two points": ("0,0\n1,1\n", ["bad.csv"], ["bad.csv", "at least 3 points, got 2"]),
    "coincident points": ("x,y\n0,0\n1,1\n0,0\n", ["bad.csv"], ["bad.csv", "lines 2 and 4"]),
    "a huge coordinate": ("0,0\n# far\n1,1e200\n", ["bad.csv"], ["bad.csv, line 3", "1e+09 m"]),
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
    "a loop": ("square", "i,j\n2,2\n", ["bad.csv, line 2", "vertex 2", "its own neighbor"]),
    "three columns": ("square", "0,1,2\n", ["bad.csv, line 1", "pair", "got 3"]),
    "a letter for a digit": ("square", "O1,2\n", ["bad.csv, line 1", "whole numbers", "O"]),
    "a broken number": ("square", "0,1.5\n", ["bad.csv, line 1", "whole numbers", "1.5"]),
    "no pairs": ("square", "i,j\n", ["bad.csv lists no pairs"]),
}


@pytest.mark.parametrize(("bad", "args", "message"), REFUSED.values(), ids=REFUSED.keys())
def test_bad_input_is_refused_and_nothing_is_written(home, bad, args, message):
    (home / "bad.csv").write_text(bad)
    check_refusal(home, 2, message, *args)


@pytest.mark.parametrize(("points", "pairs", "message"), GRAPHS.values(), ids=GRAPHS.keys())
def test_bad_graph_is_refused_with_its_file_and_line(home, points, pairs, message):
    (home / "bad.csv").write_text(pairs)
    check_refusal(home, 2, message, f"{points}.csv", "--graph", "bad.csv")


def test_formation_without_gains_is_refused_and_nothing_is_written(home):
    (home / "ring.csv").write_text("0,1\n1,2\n2,3\n3,0\n")
    (home / "bent.csv").write_text("0,0,0\n3,0,1\n3,3,0\n0,3,1\n")
    check_refusal(home, 1, ["gain"], "bent.csv", "--graph", "ring.csv")


def test_existing_gains_survive_a_full_disk(home, monkeypatch):
    assert call("star", "--out", "star.npz").exit_code == 0
    before = (home / "star.npz").read_bytes()

    def full(self: GainMatrix, path: str | Path) -> None:
        Path(path).write_bytes(before[:100])
        raise OSError(28, "No space left on device", str(path))

    monkeypatch.setattr(GainMatrix, "save", full)
    result = call("hex", "--out", "star.npz")
    assert result.exit_code == 1
    assert "No space left on device" in result.stderr
    assert (home / "star.npz").read_bytes() == before
    assert not list(home.glob(".saving-*"))


def test_list_prints_each_formation_in_a_line(home):
    result = call("--list")
    assert result.exit_code == 0
    lines = result.stdout.strip().split("\n")
    assert [line.split("  ")[0] for line in lines] == list(formation_names())
    assert "100 vertices, 1188 edges (24 %)" in lines[-1]
