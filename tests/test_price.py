"""The price of decentralisation: what is refused, what is counted, and how it ends."""

import csv
import runpy
import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
import typer
from typer.testing import CliRunner

from dynamics.trajectory_geometry import separations

SCRIPTS = Path(__file__).parents[1] / "scripts"


@pytest.fixture(scope="module")
def price():
    sys.path.insert(0, str(SCRIPTS))
    yield runpy.run_path(str(SCRIPTS / "price_of_decentralisation.py"))
    sys.path.remove(str(SCRIPTS))


def row(price, central, sato=1.0, agents=3, number=0):
    case = price["Case"](price["Model"].plane, agents, number, 0, 0, 12, 8)
    return price["Row"](case, 2, 0.9, central, "SATO", 1e-5, 1.1, sato, "", 0.1, 1.0)


def asked(*words, script="price_of_decentralisation.py"):
    told = subprocess.run(
        [sys.executable, str(SCRIPTS / script), *words],
        capture_output=True, text=True, timeout=300, env={"COLUMNS": "200", "PATH": ""},
    )  # fmt: skip
    return told.returncode, told.stdout + told.stderr


def lines(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_medians_are_over_those_that_have_an_optimum(price):
    rows = [row(price, 1.0, 1.02), row(price, np.nan, 9.0), row(price, 1.0, 1.04)]
    table, medians = price["summary"](rows)
    assert medians == [pytest.approx(1.03)]
    assert list(table.columns[-1].cells) == ["1 of 3"]
    assert list(table.columns[-2].cells) == ["1e-05"]


def test_a_size_without_any_optimum_has_no_median_and_is_not_as_wanted(price):
    _, medians = price["summary"]([row(price, 1.0), row(price, np.nan, agents=4)])
    assert medians[0] == 1.0 and not medians[1] <= price["WANTED"]


def refused(price, *words):
    app = typer.Typer()
    app.command()(price["main"])
    told = CliRunner().invoke(app, words)
    assert told.exit_code == 2
    return told.output


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("--agents 1", "2 or more"),
        ("--agents 5-3", "larger number is last"),
        ("--agents ten", "a number or two"),
        ("--instances 0", "--instances"),
        ("--orders 1", "bargains follow upon orders"),
    ],
)
def test_what_cannot_be_asked_is_refused_in_a_sentence(price, words, why):
    assert why in refused(price, *words.split())


def test_a_scenario_that_is_not_studied_is_refused_in_a_sentence():
    code, said = asked("nowhere", script="study_onboard.py")
    assert code == 2 and "no scenario 'nowhere'" in said and "Traceback" not in said


def test_ends_that_have_no_room_are_not_drawn_for_ever(price, rng):
    with pytest.raises(typer.BadParameter, match="40 vehicles found no room"):
        sys.modules["price_instances"].cross_track_motion(40, 2, 0.2, rng)


def test_at_least_half_as_many_pairs_as_vehicles_would_meet_if_all_flew_alone(price):
    for number in range(4):
        case = price["Case"](price["Model"].j2, 5, number, 0, 0)
        mission, _, (x, _), meetings = price["instance"](case)
        alive = np.ones(x.shape[1::-1], dtype=bool)
        flown = [
            separations(two[..., :3], two[..., 3:], alive[:, :2], mission.step).minimum.distance
            for two in (x[list(pair)].swapaxes(0, 1) for pair in combinations(range(5), 2))
        ]
        assert meetings == np.sum(np.array(flown) < mission.collision_radius) >= 3


def test_every_instance_is_a_line_of_the_file(price, tmp_path):
    price["write"](tmp_path / "all.csv", [row(price, 1.0), row(price, np.nan)])
    assert [file.name for file in tmp_path.iterdir()] == ["all.csv"]
    first, second = lines(tmp_path / "all.csv")
    assert first["model"] == "plane" and first["agents"] == "3" and float(first["central"]) == 1
    assert np.isnan(float(second["central"])) and float(second["padding"]) == 1e-5


def test_the_tables_of_the_docs_are_made_of_the_files(price, tmp_path):
    found = [(1.0, 1.02), (1.0, np.inf), (np.nan, 1.0), (1.0, 1.0)]
    rows = [row(price, *fuel, number=number) for number, fuel in enumerate(found)]
    price["write"](tmp_path / "all.csv", rows)
    code, said = asked(str(tmp_path / "all.csv"), script="tabulate_price.py")
    assert code == 0
    cells = "1.111 | 3 | 1.1000 | 0 of 4 | **1.0200** | gave up | 1 of 4 | 1e-05 | 1 of 4"
    assert f"| plane 3 | {cells} |" in said
    assert said.splitlines()[-2].split()[2:] == ["1.020", "gave", "up", "none", "1.000"]


def test_the_better_optimum_of_another_study_of_the_same_instance_counts(price, tmp_path):
    rows = [row(price, fuel, 1.1, number=number) for number, fuel in enumerate([1.0, np.nan, 1.0])]
    better = [row(price, 0.9), row(price, 1.1, number=1)]
    other = row(price, 0.5, number=2)._replace(alone=0.8)  # of another programme
    price["write"](tmp_path / "all.csv", rows)
    price["write"](tmp_path / "more.csv", [*better, other])
    words = str(tmp_path / "all.csv"), "--best", str(tmp_path / "more.csv")
    code, said = asked(*words, script="tabulate_price.py")
    assert code == 0
    assert said.splitlines()[-2].split()[2:] == ["1.222", "1.000", "1.100"]


def test_a_file_that_is_not_there_is_refused_in_a_sentence():
    code, said = asked("nowhere.csv", script="tabulate_price.py")
    assert code == 2 and "nowhere.csv cannot be read" in said and "Traceback" not in said


def test_what_a_file_holds_is_not_done_again(price, tmp_path):
    path, rows = tmp_path / "all.csv", [row(price, 1.0, np.inf), row(price, 2.0, agents=4)]
    price["write"](path, rows)
    assert price["read"](path) == rows
    again = price["computed"]([r.case for r in rows[::-1]], 1, path)
    assert again == rows


def test_a_file_of_something_else_is_refused(price, tmp_path):
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(typer.BadParameter, match=r"other\.csv holds no instances"):
        price["read"](tmp_path / "other.csv")


def test_one_instance_is_asked_and_answered(tmp_path):
    words = "--agents 2 --instances 1 --model plane --workers 1 --guesses 0 --orders 2 --bargains 1"
    code, said = asked(*words.split(), "--csv", str(tmp_path / "one.csv"))
    (only,) = lines(tmp_path / "one.csv")
    ratio = float(only["sato"]) / float(only["central"])
    assert code == int(not ratio <= 1.05) and f"{ratio:.4f}" in said
    assert 1 <= ratio < np.inf and float(only["padding"]) <= 1e-3
    # Asked for one more, it does that alone: the first is as the file has it.
    told = (tmp_path / "one.csv").read_text().replace(only["sato"], repr(2 * float(only["sato"])))
    (tmp_path / "one.csv").write_text(told)
    code, said = asked(
        *words.replace("--instances 1", "--instances 2").split(), "--csv", str(tmp_path / "one.csv")
    )
    assert code == 1 and f"{2 * ratio:.4f}" in said
    assert [line["number"] for line in lines(tmp_path / "one.csv")] == ["0", "1"]
