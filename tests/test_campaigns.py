"""Campaigns: rows follow from the definition, and the table survives what ends its writers."""

import linecache
import signal
import sqlite3
import subprocess
import sys
from pathlib import Path

import campaign_trials
import numpy as np
import pytest
from campaign_trials import TRIALS, campaign, count, die, import_nothing
from full_disk import file_size_limit
from test_cli import call, sentence

import sato
from sato.campaigns import cluster
from sato.campaigns import table as tables
from sato.campaigns import trial as trials
from sato.campaigns.definition import Campaign, read_campaign
from sato.campaigns.engine import fly_again, fly_campaign
from sato.campaigns.local import WorkerError
from sato.campaigns.table import MEASURED, CampaignTable, TableError, open_table
from sato.campaigns.trial import run_trial
from sato.scenario.errors import InputError, ScenarioError

# Dask warns where the disk is busy.
pytestmark = pytest.mark.filterwarnings("ignore:Creating scratch directories")
GRID = {"plan.horizon_steps": [1, 2], "swarm.comm_radius_m": [3.0, 3.5, 4.0]}
FILE = """
[campaign]
scenario = "conflict"
trials = 3

[grid]
plan.horizon_steps = [1, 2]

[draw]
"swarm.comm_radius_m" = { kind = "uniform", low = 2.9, high = 3.3 }
"""


def rows(folder):
    with open_table(folder) as table:
        return [
            {k: v for k, v in row.items() if k not in MEASURED and v is not None}
            for row in table.rows()
        ]


def is_sound(folder):
    connection = sqlite3.connect(folder / tables.TABLE_FILE)
    found = connection.execute("PRAGMA integrity_check").fetchone()
    connection.close()
    return found == ("ok",)


@pytest.fixture
def flown(tmp_path):
    fly_campaign(campaign(), tmp_path / "flown", workers=1, function=count)
    return tmp_path / "flown"


def test_a_row_and_the_definition_alone_decide_a_trial():
    draws = {"model.max_speed_m_s": {"kind": "normal", "mean": 0.5, "deviation": 0.01}}
    first, more = (campaign(trials=n, grid=GRID, draw=draws, seed=7) for n in (4, 9))
    trials = [first.trial(row) for row in range(first.runs)]
    assert trials == [more.trial(row) for row in range(first.runs)]
    assert len({str(trial.parameters) for trial in trials}) == first.runs == 4 * 6
    for number in range(4):
        same = trials[6 * number : 6 * number + 6]
        assert {trial.seed for trial in same} == {7 + number}
        assert len({trial.parameters["model.max_speed_m_s"] for trial in same}) == 1


@pytest.mark.parametrize(
    ("table", "quartiles"),  # of the distributions, with what 10,000 draws may be off by
    [
        ({"kind": "uniform", "low": 1.0, "high": 81.0}, [1, 21, 41, 61, 81]),
        ({"kind": "log_uniform", "low": 1.0, "high": 81.0}, [1, 3, 9, 27, 81]),
        ({"kind": "integers", "low": 1, "high": 81}, [1, 21, 41, 61, 81]),
        ({"kind": "choice", "values": [5, 1]}, [1, 1, None, 5, 5]),
        ({"kind": "normal", "mean": 9.0, "deviation": 2.0}, [None, 7.651, 9.0, 10.349, None]),
    ],
)
def test_draws_have_the_quartiles_and_limits_of_their_distribution(table, quartiles, rng):
    drawn = campaign(draw={"x": table}).draw["x"]
    found = np.quantile([drawn.draw(rng) for _ in range(10_000)], [0, 0.25, 0.5, 0.75, 1])
    for quartile, expected in zip(found, quartiles, strict=True):
        assert expected is None or quartile == pytest.approx(expected, rel=0.08)
    if "low" in table:
        assert table["low"] <= found[0] and found[-1] <= table["high"]


@pytest.mark.parametrize(
    ("table", "reason"),
    [
        ({"kind": "integers", "low": 1.5, "high": 3}, "low: must be an integer"),
        ({"kind": "log_uniform", "low": 0, "high": 3}, "low: must be greater than 0"),
        ({"kind": "normal", "mean": 0.0, "deviation": -1.0}, "deviation: "),
        ({"kind": "choice", "values": []}, "must have at least 1 item"),
        ({"kind": "uniform", "low": 0}, "high: is missing"),
        ({"kind": "uniform", "low": 0, "high": float("nan")}, "high: "),
        (3, "draw.x: must be a table"),
    ],
)
def test_distribution_with_wrong_numbers_is_refused(table, reason):
    with pytest.raises(InputError, match=reason):
        campaign(draw={"x": table})


def test_a_definition_survives_its_file_and_its_json(tmp_path):
    (tmp_path / "mine.toml").write_text(FILE)
    read = read_campaign(tmp_path / "mine.toml")
    assert (read.name, read.runs) == ("mine", 6)
    assert Campaign.from_json(read.to_json()).to_json() == read.to_json()


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("plan.horizon_steps", "plan.horizon_step", "did you mean plan.horizon_steps?"),
        ('"swarm.comm_radius_m"', '"swarm.comm_radius"', "has no unit; write comm_radius_m"),
        ("[1, 2]", "1", "must be a list of values, got 1"),
        ("[1, 2]", "[]", "must have at least one value"),
        ("[1, 2]", "[1979-05-27]", "plan.horizon_steps: no file holds an object of type date"),
        ("[campaign]", "campaign = 3\n[grid.x]", "campaign: must be a table"),
        ("uniform", "unifrom", 'did you mean "uniform"?'),
        ("trials = 3", "trails = 3", "did you mean trials?"),
        ("trials = 3", "trials = 1_000_000", "--yes"),
        ('"conflict"', '"here:there"', "cannot be imported"),
        ("low = 2.9", "low = 9.0", "must be at least low"),
    ],
)
def test_a_faulty_file_is_refused_in_a_sentence(old, new, said, tmp_path):
    (tmp_path / "mine.toml").write_text(FILE.replace(old, new))
    result = call("campaign", "run", str(tmp_path / "mine.toml"), "--out", str(tmp_path / "out"))
    assert result.exit_code == 2
    assert said in sentence(result)
    assert not (tmp_path / "out" / tables.TABLE_FILE).exists()


def test_scenarios_of_one_name_are_told_apart_by_a_number():
    one = sato.read("conflict")
    rows = campaign(scenario=[one, "crossing", one], grid={}, draw={})
    names = [rows.trial(row).scenario_name for row in range(rows.points)]
    assert names == ["conflict", "crossing", "conflict 2"]


def test_campaigns_and_scenarios_are_not_taken_for_each_other(tmp_path):
    scenario, other = tmp_path / "mine.toml", tmp_path / "many.toml"
    scenario.write_text(sato.read("conflict").to_toml())
    other.write_text('[campaign]\nscenario = "mine.toml"\n')
    with pytest.raises(ScenarioError, match=r"is a scenario, which `sato run .*mine.toml` flies"):
        read_campaign(scenario)
    with pytest.raises(ScenarioError, match=r"is a campaign, which .*many.toml` flies"):
        sato.read(other)


def test_a_grid_may_take_a_key_away(tmp_path):
    file = tmp_path / "many.toml"
    grid = '[grid]\n"plan.foresight_steps" = [5, "none"]\n'
    file.write_text(f'[campaign]\nscenario = "conflict"\ntrials = 1\n{grid}')
    few, none = (read_campaign(file).trial(row).build_mission() for row in range(2))
    assert few.foresight_steps == 5
    assert none.foresight_steps is None


def test_a_file_in_place_of_the_folder_of_a_campaign_is_refused(tmp_path):
    (tmp_path / "there").write_text("mine")
    with pytest.raises(TableError, match="is a file, and the name of a folder would do"):
        sato.campaign("conflict", out=tmp_path / "there")


def test_a_dead_worker_and_a_time_limit_are_recorded(tmp_path, flown):
    fly_campaign(campaign(time_limit=2.0), tmp_path / "x", workers=2, function=die)
    with open_table(tmp_path / "x") as table:
        assert table.exits() == {"reached": TRIALS - 2, "died": 1, "time limit": 1}
        assert table.row(3)["exit"] == "died"
        assert table.row(5)["exit"] == "time limit"
    fly_campaign(campaign(time_limit=2.0), tmp_path / "x", workers=1, function=count, resume=True)
    again = rows(tmp_path / "x")
    assert again[5]["exit"] == "time limit"
    assert again[:5] + again[6:] == rows(flown)[:5] + rows(flown)[6:]


def test_a_killed_campaign_resumes_to_the_undisturbed_table(tmp_path, flown):
    words = [sys.executable, campaign_trials.__file__, str(tmp_path / "x")]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process:
        while process.stdout.readline() not in ("7\n", ""):
            pass
        process.send_signal(signal.SIGKILL)
    with open_table(tmp_path / "x") as table:
        assert 7 <= len(table) < TRIALS
    assert is_sound(tmp_path / "x")
    fly_campaign(campaign(), tmp_path / "x", workers=1, function=count, resume=True)
    assert rows(tmp_path / "x") == rows(flown)


@pytest.fixture
def scheduler(monkeypatch):
    from distributed import LocalCluster

    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 60.0)  # the machine may be busy
    options = {"processes": False, "n_workers": 2, "threads_per_worker": 1}
    with LocalCluster(**options, dashboard_address=None) as started:
        yield started.scheduler_address


def test_a_dask_cluster_gives_the_rows_of_this_machine(tmp_path, flown, scheduler):
    fly_campaign(campaign(), tmp_path / "x", scheduler=scheduler, function=count)
    assert rows(tmp_path / "x") == rows(flown)


def test_a_time_limit_needs_workers_that_are_restarted(tmp_path, scheduler):
    with pytest.raises(InputError, match="needs workers with nannies"):
        fly_campaign(campaign(time_limit=9.0), tmp_path, scheduler=scheduler, function=count)


def test_columns_that_no_table_can_hold_are_told_in_the_row(tmp_path):
    for cells in ({"": 1}, {"a\0b": 1}, {str(k): k for k in range(3000)}, {"x": object()}, None):
        told = trials.more_columns(f"{__name__}:echo", cells)["columns_error"]
        assert "echo: the result must be" in told and "Traceback" not in told
    cells = trials.more_columns(f"{__name__}:echo", {"x": "\ud800", 'y"': [float("nan")]})
    mine = campaign()
    outcome = count(mine.trial(0)) | {"columns": cells}
    with CampaignTable.create(tmp_path, mine) as table:
        table.add(mine.trial(0), outcome, 1)
        assert table.row(0)['y"'] == "[null]"


def echo(value):
    return value


def test_a_scheduler_that_cannot_be_reached_is_told(tmp_path, monkeypatch):
    monkeypatch.setattr(cluster, "CONNECT_TIMEOUT", 0.1)
    with pytest.raises(WorkerError, match="no Dask scheduler can be reached"):
        fly_campaign(campaign(), tmp_path, scheduler="tcp://127.0.0.1:1", function=count)
    assert not list(tmp_path.iterdir())


def test_a_table_without_rows_is_no_campaign_that_could_be_lost(tmp_path):
    CampaignTable.create(tmp_path, campaign(grid=GRID)).close()
    fly_campaign(campaign(), tmp_path, workers=1, function=count)
    with open_table(tmp_path) as table:
        assert table.exits() == {"reached": TRIALS}
        assert table.campaign.to_json() == campaign().to_json()


def test_a_function_that_workers_cannot_import_ends_the_campaign(tmp_path):
    with pytest.raises(InputError, match=r"nowhere:f.* cannot be imported"):
        fly_campaign(campaign(), tmp_path, workers=1, function=import_nothing)
    with open_table(tmp_path) as table:
        assert len(table) == 0


def test_keys_in_another_order_are_another_campaign(tmp_path):
    nan = {"plan.horizon_steps": [1, 2], "plan.tie_break": [float("nan")]}
    fly_campaign(campaign(grid=nan, trials=1), tmp_path, workers=1, function=count)
    fly_campaign(campaign(grid=nan, trials=2), tmp_path, workers=1, function=count, resume=True)
    other = campaign(grid=dict(reversed(nan.items())), trials=2)
    with pytest.raises(InputError, match="with another grid"):
        fly_campaign(other, tmp_path, function=count, resume=True)


def test_another_campaign_in_the_folder_is_refused(flown):
    with pytest.raises(InputError, match="holds a campaign; --resume, resume=True in Python"):
        fly_campaign(campaign(), flown, function=count)
    with pytest.raises(InputError, match="holds another campaign, with another grid"):
        fly_campaign(campaign(grid=GRID), flown, function=count, resume=True)
    with pytest.raises(InputError, match="fewer"):
        fly_campaign(campaign(trials=1), flown, function=count, resume=True)
    other = campaign(scenario="crossing")
    with pytest.raises(InputError, match="another scenario or function; --allow-version"):
        fly_campaign(other, flown, function=count, resume=True)
    fly_campaign(other, flown, function=count, resume=True, allow_version=True)
    more = campaign(scenario=["crossing", "conflict"])
    with pytest.raises(InputError, match="another number of scenarios"):
        fly_campaign(more, flown, function=count, resume=True, allow_version=True)


def test_more_trials_add_rows_after_all_others(flown):
    before = rows(flown)
    fly_campaign(campaign(trials=TRIALS + 2), flown, workers=1, function=count, resume=True)
    assert rows(flown)[:TRIALS] == before
    assert len(rows(flown)) == TRIALS + 2


def test_a_locked_or_full_table_is_told_and_stays_sound(flown, monkeypatch):
    monkeypatch.setattr(tables, "PATIENCE", 0.01)
    trial = campaign().trial(0)
    before = rows(flown)
    with CampaignTable(flown, is_writer=True) as table:
        other = sqlite3.connect(flown / tables.TABLE_FILE, isolation_level=None)
        other.execute("BEGIN IMMEDIATE")
        with pytest.raises(TableError, match="another program has locked the table"):
            table.add(trial, count(trial), 1)
        other.close()
        large = count(trial) | {"summary": {"new": "x" * 10**6}}
        with file_size_limit(200_000), pytest.raises(TableError, match="nothing can be written"):
            table.add(trial, large, 1)
        table.add(trial, count(trial), 1)
    assert is_sound(flown)
    assert rows(flown) == before


def test_a_row_is_flown_again_from_itself_alone(tmp_path):
    (tmp_path / "mine.toml").write_text(FILE)
    mine = read_campaign(tmp_path / "mine.toml", trials=2)
    mine = Campaign(
        **{name: getattr(mine, name) for name in ("scenario", "trials", "grid", "draw")},
        columns=campaign_trials.more_columns,
    )
    with CampaignTable.create(tmp_path / "x", mine) as table:
        for row in (1, 3):
            trial = mine.trial(row)
            table.add(trial, run_trial(trial), 1)
        assert table.exits() == {"reached": 2}
        first, second = table.rows()
        assert first["instants"] > 40 and first["columns_error"] is None
        assert second["instants"] is None and "no such thing" in second["columns_error"]
        with pytest.raises(
            InputError, match="campaign_trials:more_columns, which is code; --trust"
        ):
            fly_again(table, 1)
        outcome, differing = fly_again(table, 1, is_trusted=True)
        assert (outcome["exit"], differing) == ("reached", [])
    assert sato.load(tmp_path / "x" / "runs" / "1").check().kept


def test_a_drawn_mission_that_no_file_holds_is_drawn_again(tmp_path):
    with sato.campaign(campaign_trials.draw_gusty, trials=2, workers=1, out=tmp_path) as table:
        outcome, differing = fly_again(table, 1, is_trusted=True)
        assert outcome["exit"] == table.row(1)["exit"] != "refused"
    assert not differing


def test_columns_that_no_table_holds_are_refused_in_words():
    for column in (10**400, object(), 1j):
        with pytest.raises(InputError, match="must be a dict of numbers, text and lists"):
            trials._as_columns({"a": column})
    with pytest.raises(InputError, match="differ by their case alone"):
        trials._as_columns({"fuel": 1, "Fuel": 2})


def test_a_mission_that_is_refused_is_a_row():
    outcome = run_trial(campaign(grid={"swarm.comm_radius_m": [0.1]}).trial(0))
    assert outcome["exit"] == "refused"
    assert "comm_radius_m" in outcome["error"]


def test_a_function_may_draw_missions():
    drawn = [campaign(scenario=draw_mission).trial(row).build_mission() for row in (0, 1, 0)]
    assert drawn[0] == drawn[2] != drawn[1]


def test_a_function_draws_by_its_generator_alone():
    with pytest.raises(InputError, match="draws two missions from one seed"):
        campaign(scenario=draw_by_chance).trial(0).build_mission()


def draw_by_chance(rng: np.random.Generator):
    return draw_mission(np.random.default_rng())


def draw_mission(rng: np.random.Generator):
    return sato.read("conflict", [f"comm_radius_m={rng.uniform(3.0, 3.2)}"])


def leave(rng: np.random.Generator):
    sys.exit(0)


def test_a_function_that_ends_the_process_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"leave raises SystemExit: 0"):
        sato.campaign(leave, out=tmp_path)


def test_more_workers_than_a_machine_has_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"workers: must be at most 1024, got 1000000"):
        fly_campaign(campaign(), tmp_path, workers=10**6)


def test_commands_tell_the_state_of_a_campaign(flown):
    assert "40 of 40 runs: 40 reached" in call("campaign", "status", str(flown)).output
    result = call("campaign", "status", str(Path(flown, "nowhere")))
    assert result.exit_code == 2
    assert "holds no campaign" in sentence(result)
    with open_table(flown) as table, pytest.raises(InputError, match=r"did you mean .half"):
        list(table.rows(["haf"]))


def test_files_that_are_no_campaign_are_refused(tmp_path):
    with pytest.raises(ScenarioError, match="cannot be read"):
        read_campaign(tmp_path / "none.toml")


def test_a_function_in_place_of_runs_fills_columns_that_come_again(tmp_path):
    grid = {"sides": [2, 6], "fails": [False, True]}
    given = {"function": campaign_trials.toss, "trials": 20, "grid": grid, "workers": 1}
    with sato.campaign(**given, out=tmp_path) as table:
        assert dict(table.exits()) == {"done": 40, "error": 40}
        found = [row for row in table.rows() if row["exit"] == "done"]
        assert {row["thrown"] for row in found if row["sides"] == 6} > set(range(2))
        assert all(row["is_first"] == (row["thrown"] == 0) for row in found)
        outcome, differing = fly_again(table, found[-1]["row"], is_trusted=True)
    assert outcome["columns"]["thrown"] == found[-1]["thrown"]
    assert not differing


def test_a_row_of_a_function_beside_the_file_is_computed_again(tmp_path, monkeypatch):
    (tmp_path / "beside.py").write_text("def solve(rng, x): return {'y': x + rng.random()}")
    text = '[campaign]\nfunction = "beside:solve"\n[grid]\nx = [1, 2]\n'
    (tmp_path / "mine.toml").write_text(text)
    folder = str(tmp_path / "out")
    for words in (
        ["run", str(tmp_path / "mine.toml"), "--out", folder],
        ["rerun", folder, "1", "--trust"],
    ):
        with monkeypatch.context() as patch:
            patch.setattr(sys, "path", [*sys.path])  # as in a process that has just started
            result = call("campaign", *words)
        sys.modules.pop("beside")
        assert result.exit_code == 0
    assert result.output == "done\nequal to the row\n"
    (tmp_path / "beside.py").write_text("def solve(rng, x): return {'y': x - rng.random()}")
    linecache.clearcache()
    with monkeypatch.context() as patch:
        patch.setattr(sys, "path", [*sys.path])
        words = "run", str(tmp_path / "mine.toml"), "--out", folder, "--resume"
        assert "was begun with another scenario or function" in sentence(call("campaign", *words))


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"scenario": "conflict"}, r"campaign\.scenario: is needed, or a function, and not both"),
        ({"function": ""}, r"campaign\.scenario: is needed, or a function"),
        ({"keep": "all"}, r"campaign\.function: has no runs"),
        ({"grid": {"side": [6]}}, r"grid\.side: .*toss missing .*; did you mean .sides.\?"),
        ({"grid": {"fails": [True]}}, r"campaign\.function: .*toss missing .* argument: 'sides'"),
        (
            {"function": campaign_trials.count_agents, "grid": {"agents": [6]}},
            r"campaign\.function: .*count_agents begins with agents, and rng comes first",
        ),
        ({"function": "math:pi"}, r"campaign\.function: \"math:pi\" is no function"),
        (
            {"function": "", "scenario": f"{__name__}:raise_at_once"},
            "raise_at_once raised ZeroDivisionError: no",
        ),
    ],
)
def test_a_function_beside_what_only_runs_have_is_refused(changes, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        sato.campaign(**{"function": campaign_trials.toss, "out": tmp_path} | changes)


def raise_at_once(rng):
    raise ZeroDivisionError("no")
