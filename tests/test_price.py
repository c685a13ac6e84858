"""Price of decentralization: instances, tables and refusals."""

import csv
import os
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
    yield runpy.run_path(str(SCRIPTS / "price_of_decentralization.py"))
    sys.path.remove(str(SCRIPTS))


def row(price, central, sato=1.0, agents=3, number=0):
    case = price["PriceCase"](price["MotionModel"].plane, agents, number, 0, 0, 12, 8)
    return price["PriceResult"](case, 2, 0.9, central, "SATO", 1e-5, 1.1, sato, "", 0.1, 1.0)


def run_script(*args, script="price_of_decentralization.py"):
    done = subprocess.run(
        [sys.executable, str(SCRIPTS / script), *args],
        capture_output=True, text=True, timeout=300, env=os.environ | {"COLUMNS": "200"},
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


def lines(path):
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_medians_are_over_instances_with_an_optimum(price):
    rows = [row(price, 1.0, 1.02), row(price, np.nan, 9.0), row(price, 1.0, 1.04)]
    table, medians = price["summary_table"](rows)
    assert medians == [pytest.approx(1.03)]
    assert list(table.columns[-1].cells) == ["1 of 3"]
    assert list(table.columns[-2].cells) == ["1e-05"]


def test_size_without_any_optimum_fails(price):
    _, medians = price["summary_table"]([row(price, 1.0), row(price, np.nan, agents=4)])
    assert medians[0] == 1.0 and not medians[1] <= price["MAX_MEDIAN_RATIO"]


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ("--agents 1", "2 or more"),
        ("--agents 5-3", "larger number is last"),
        ("--agents ten", "a number or two"),
        ("--instances 0", "--instances"),
        ("--orders 1", "bargains need --orders"),
    ],
)
def test_impossible_study_is_refused(price, args, message):
    app = typer.Typer()
    app.command()(price["main"])
    result = CliRunner().invoke(app, args.split())
    assert result.exit_code == 2 and message in result.output


def test_unknown_scenario_of_the_onboard_study_is_refused():
    code, printed = run_script("nowhere", script="study_onboard.py")
    assert code == 2 and "no scenario 'nowhere'" in printed and "Traceback" not in printed


def test_drawing_ends_where_there_is_no_room(price, rng):
    with pytest.raises(typer.BadParameter, match="40 vehicles found no room"):
        sys.modules["price_instances"].draw_opposite_points(40, 2, 0.2, rng)


def test_half_as_many_pairs_as_vehicles_conflict_if_all_fly_alone(price):
    for number in range(4):
        case = price["PriceCase"](price["MotionModel"].j2, 5, number, 0, 0)
        mission, _, (x, _), meetings = price["make_instance"](case)
        alive = np.ones(x.shape[1::-1], dtype=bool)
        flown = [
            separations(two[..., :3], two[..., 3:], alive[:, :2], mission.step).minimum.distance
            for two in (x[list(pair)].swapaxes(0, 1) for pair in combinations(range(5), 2))
        ]
        assert meetings == np.sum(np.array(flown) < mission.collision_radius) >= 3


def test_table_of_the_docs_is_made_from_the_file(price, tmp_path):
    found = [(1.0, 1.02), (1.0, np.inf), (np.nan, 1.0), (1.0, 1.0)]
    rows = [row(price, *fuel, number=number) for number, fuel in enumerate(found)]
    price["write_csv"](tmp_path / "all.csv", rows)
    code, printed = run_script(str(tmp_path / "all.csv"), script="tabulate_price.py")
    assert code == 0
    cells = "1.111 | 3 | 1.1000 | 0 of 4 | 1.0200 | gave up | 1 of 4 | 1e-05 | 1 of 4"
    assert f"| plane 3 | {cells} |" in printed
    assert printed.splitlines()[-2].split()[2:] == ["1.020", "gave", "up", "none", "1.000"]


def test_better_optimum_of_another_run_counts(price, tmp_path):
    rows = [row(price, fuel, 1.1, number=number) for number, fuel in enumerate([1.0, np.nan, 1.0])]
    better = [row(price, 0.9), row(price, 1.1, number=1)]
    other = row(price, 0.5, number=2)._replace(alone=0.8)  # of another program
    price["write_csv"](tmp_path / "all.csv", rows)
    price["write_csv"](tmp_path / "more.csv", [*better, other])
    args = str(tmp_path / "all.csv"), "--best", str(tmp_path / "more.csv")
    code, printed = run_script(*args, script="tabulate_price.py")
    assert code == 0
    assert printed.splitlines()[-2].split()[2:] == ["1.222", "1.000", "1.100"]


def test_missing_file_is_refused():
    code, printed = run_script("nowhere.csv", script="tabulate_price.py")
    assert code == 2 and "nowhere.csv is not a table" in printed and "Traceback" not in printed


def test_instances_of_the_file_are_not_solved_again(price, tmp_path):
    path, rows = tmp_path / "all.csv", [row(price, 1.0, np.inf), row(price, 2.0, agents=4)]
    price["write_csv"](path, rows)
    assert price["read_csv"](path) == rows
    again = price["compute_results"]([r.case for r in rows[::-1]], 1, path)
    assert again == rows


def test_file_of_another_kind_is_refused(price, tmp_path):
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    with pytest.raises(typer.BadParameter, match=r"other\.csv is not a table of instances"):
        price["read_csv"](tmp_path / "other.csv")


def test_study_solves_an_instance_and_resumes_from_its_file(tmp_path):
    args = "--agents 2 --instances 1 --model plane --workers 1 --guesses 0 --orders 2 --bargains 1"
    code, printed = run_script(*args.split(), "--csv", str(tmp_path / "one.csv"))
    (only,) = lines(tmp_path / "one.csv")
    ratio = float(only["sato"]) / float(only["central"])
    assert code == int(not ratio <= 1.05) and f"{ratio:.4f}" in printed
    assert 1 <= ratio < np.inf and float(only["padding"]) <= 1e-3
    # A second instance is solved alone: the first stays as the file has it.
    altered = (
        (tmp_path / "one.csv").read_text().replace(only["sato"], repr(2 * float(only["sato"])))
    )
    (tmp_path / "one.csv").write_text(altered)
    code, printed = run_script(
        *args.replace("--instances 1", "--instances 2").split(), "--csv", str(tmp_path / "one.csv")
    )
    assert code == 1 and f"{2 * ratio:.4f}" in printed
    assert [line["number"] for line in lines(tmp_path / "one.csv")] == ["0", "1"]
