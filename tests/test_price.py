"""Price of decentralization: instances, tables and refusals."""

import os
import runpy
import subprocess
import sys
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest

from dynamics.trajectory_geometry import separations

ROOT = Path(__file__).parents[1]
COLUMNS = "model agents number seed alone central from_guess padding printed sato".split()


@pytest.fixture(scope="module")
def price():
    return runpy.run_path(str(ROOT / "campaigns" / "price.py"))


def row(central, sato=1.0, number=0, alone=0.9):
    return ["plane", 3, number, 0, alone, central, "SATO", 1e-5, 1.1, sato]


def write(path, rows):
    lines = [",".join(map(str, cells)) for cells in [COLUMNS, *rows]]
    path.write_text("\n".join(lines))
    return str(path)


def run_script(*args, script="tabulate_price.py"):
    done = subprocess.run(
        [sys.executable, str(ROOT / "scripts" / script), *args],
        capture_output=True, text=True, timeout=300, env=os.environ | {"COLUMNS": "200"},
    )  # fmt: skip
    return done.returncode, done.stdout + done.stderr


def test_unknown_scenario_of_the_onboard_study_is_refused():
    code, printed = run_script("nowhere", script="study_onboard.py")
    assert code == 2 and "no scenario 'nowhere'" in printed and "Traceback" not in printed


def test_drawing_ends_where_there_is_no_room(price, rng):
    with pytest.raises(ValueError, match="40 vehicles found no room"):
        price["draw_opposite_points"](40, 2, 0.2, rng)


def test_half_as_many_pairs_as_vehicles_conflict_if_all_fly_alone(price):
    for number in range(4):
        mission, _, (x, _), meetings = price["make_instance"]("j2", 5, number)
        alive = np.ones(x.shape[1::-1], dtype=bool)
        flown = [
            separations(two[..., :3], two[..., 3:], alive[:, :2], mission.step).minimum.distance
            for two in (x[list(pair)].swapaxes(0, 1) for pair in combinations(range(5), 2))
        ]
        assert meetings == np.sum(np.array(flown) < mission.collision_radius) >= 3


def test_table_of_the_docs_is_made_from_the_file(tmp_path):
    found = [(1.0, 1.02), (1.0, np.inf), (np.nan, 1.0), (1.0, 1.0)]
    rows = [row(*fuel, number=number) for number, fuel in enumerate(found)]
    code, printed = run_script(write(tmp_path / "all.csv", rows))
    assert code == 0
    cells = "1.111 | 3 | 1.1000 | 0 of 4 | 1.0200 | gave up | 1 of 4 | 1e-05 | 1 of 4"
    assert f"| plane 3 | {cells} |" in printed
    assert printed.splitlines()[-2].split()[2:] == ["1.020", "gave", "up", "none", "1.000"]


def test_better_optimum_of_another_run_counts(tmp_path):
    rows = [row(fuel, 1.1, number) for number, fuel in enumerate([1.0, np.nan, 1.0])]
    other = row(0.5, number=2, alone=0.8)  # of another program
    more = write(tmp_path / "more.csv", [row(0.9), row(1.1, number=1), other])
    code, printed = run_script(write(tmp_path / "all.csv", rows), "--best", more)
    assert code == 0
    assert printed.splitlines()[-2].split()[2:] == ["1.222", "1.000", "1.100"]


def test_missing_file_is_refused():
    code, printed = run_script("nowhere.csv")
    assert code == 2 and "nowhere.csv is not a table" in printed and "Traceback" not in printed


def test_file_of_another_kind_is_refused(tmp_path):
    (tmp_path / "other.csv").write_text("a,b\n1,2\n")
    code, printed = run_script(str(tmp_path / "other.csv"))
    assert code == 2 and "other.csv is not a table of instances" in printed.replace("\n", "")


def test_optimum_of_an_instance_is_no_more_than_its_plan(price, rng):
    found = price["compare"](rng, "plane", 2, 0, guesses=0, orders=2, bargains=1)
    assert found["found"] and 1 <= found["ratio"] <= found["ratio_printed"] < np.inf
    assert found["alone"] <= found["central"] and found["padding"] <= 1e-3
    assert found["good"] == (found["sato"] <= 1.05 * found["central"])
