"""Campaigns of the repository, cases of a campaign, and the commands that show one."""

import json
import sqlite3
from contextlib import closing
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import sato
from sato.auctions import run_vsdaa
from sato.campaigns.definition import Campaign, read_campaign
from sato.campaigns.table import TABLE_FILE, CampaignTable
from sato.cli import app
from sato.network.link import Link
from sato.scenario.errors import InputError

FILES = sorted((Path(__file__).parents[1] / "campaigns").glob("*.toml"))


@pytest.mark.parametrize("path", FILES, ids=[path.stem for path in FILES])
def test_campaign_has_scenarios_keys_and_functions_that_exist(path, monkeypatch):
    monkeypatch.syspath_prepend(path.parent)
    campaign = read_campaign(path)
    campaign.check_keys()
    assert f"sato campaign run campaigns/{path.name}" in path.read_text(encoding="utf-8")
    for row in range(0 if campaign.function else campaign.points):
        campaign.trial(row).build_mission()


@pytest.mark.parametrize(
    ("name", "scenario", "overrides"),
    [
        ("judge_connectivity", "connectivity", ["duration_s=0.5", "start_s=0"]),
        ("judge_formations", "formation6", ["limit_s=6"]),
        ("judge_transitions", "formation6", ["limit_s=6"]),
    ],
)
def test_functions_of_the_studies_judge_a_run(name, scenario, overrides, monkeypatch):
    monkeypatch.syspath_prepend(FILES[0].parent)
    studies = import_module("studies")
    monkeypatch.setattr(studies, "REPETITIONS", 1)
    assert getattr(studies, name)(sato.run(scenario, overrides=overrides))


def test_auction_as_written_is_vsdaa_where_no_message_is_lost(monkeypatch):
    monkeypatch.syspath_prepend(FILES[0].parent)
    lossy = import_module("lossy_auctions")
    for seed in range(3):
        rng = np.random.default_rng(seed)
        start, graph = lossy._draw_start(rng, 12, 8.0)
        goal = rng.uniform(0, 8, (20, 2))
        held, more = lossy._run_as_written(rng, start, goal, graph, Link())
        expected = run_vsdaa(lossy._make_vsdaa(start, goal, graph))
        assert np.array_equal(held, expected.target_index)
        assert more["rounds"] == expected.round_count


@pytest.mark.parametrize("method", ["synchronized", "cbaa"])
def test_next_auction_settles_duplicates_of_one_that_was_cut(method, monkeypatch):
    monkeypatch.syspath_prepend(FILES[0].parent)
    rng = np.random.default_rng(0)
    counted = import_module("lossy_auctions").assign_twice(rng, method, 20, 6, 0.3, is_cut=True)
    assert counted["duplicates"] > 0 and counted["through"] < 1
    assert counted["duplicates_next"] == 0 and counted["through_next"] == 1


def test_cases_and_grid_are_all_combined_and_share_their_seeds():
    case = {"near": {"swarm": {"comm_radius_m": 2.0}}, "far": {"swarm.comm_radius_m": 9.0}}
    campaign = Campaign(
        scenario=["conflict", "random"], trials=2, case=case, grid={"plan.step_s": [1.0, 2.0, 3.0]}
    )
    trials = [campaign.trial(row) for row in range(campaign.runs)]
    named = {
        (t.scenario_name, t.case, t.parameters["swarm.comm_radius_m"], t.parameters["plan.step_s"])
        for t in trials
    }
    assert len(trials) == 2 * 2 * 2 * 3 and len(named) == 2 * 2 * 3
    assert {(case, radius) for _, case, radius, _ in named} == {("near", 2.0), ("far", 9.0)}
    assert [t.seed for t in trials] == 12 * [0] + 12 * [1]
    assert Campaign.from_json(campaign.to_json()).trial(17) == trials[17]


@pytest.mark.parametrize(
    ("more", "reason"),
    [
        ({"grid": {"plan.step_s": [1.0]}}, r"stands in \[case.slow\] and in \[grid\]"),
        ({"case": {"slow": {"plan.stop_s": 2.0}}}, "case.slow.*did you mean plan.step_s"),
        ({"case": {"slow": 2.0}}, "case.slow: must be a table"),
    ],
)
def test_case_with_wrong_keys_is_refused_by_its_name(more, reason):
    given = {"scenario": "conflict", "case": {"slow": {"plan.step_s": 2.0}}} | more
    with pytest.raises(InputError, match=reason):
        Campaign(**given).check_keys()


@pytest.mark.parametrize(
    ("one", "two"),
    [
        ("plan.step_s", "step_min"),
        ("comm_radius_m", "swarm.comm_radius_km"),
        ("steps", "leg.steps"),
    ],
)
@pytest.mark.parametrize("tables", [("grid", "draw"), ("case", "grid"), ("grid", "grid")])
def test_one_key_under_two_spellings_is_refused_with_both(one, two, tables):
    first, second = tables
    given = {"grid": {one: [2]}, "case": {"a": {one: 2}}}
    second_values = {"draw": {"kind": "integers", "low": 1, "high": 3}, "grid": [2]}
    more = {second: {two: second_values[second]}}
    settings = (
        {first: given[first]} | more if first != second else {first: given[first] | more[first]}
    )
    place = "case.a" if first == "case" else first
    reason = rf"{two}: stands in \[{second}\], and as {one} in \[{place}\]; one is enough"
    with pytest.raises(InputError, match=reason):
        Campaign(scenario="conflict", **settings).check_keys()


def test_a_part_of_a_list_may_differ_from_the_rest():
    grid = {"leg.steps": [20], "leg.0.steps": [30]}
    campaign = Campaign(scenario="uiuc", grid=grid)
    campaign.check_keys()
    assert [leg.steps for leg in campaign.trial(0).build_mission().legs] == [30, 20, 20, 20]
    with pytest.raises(InputError, match=r"leg\.steps: stands in \[grid\], and as leg\.0\.steps"):
        Campaign(scenario="uiuc", grid=dict(reversed(grid.items()))).check_keys()


def test_a_table_of_a_newer_version_is_refused_with_that_version(tmp_path):
    campaign = Campaign(scenario="conflict")
    CampaignTable.create(tmp_path, campaign).close()
    newer = {**json.loads(campaign.to_json()), "later": 1}
    with closing(sqlite3.connect(tmp_path / TABLE_FILE)) as connection, connection:
        values = json.dumps(newer), "9.1"
        connection.execute("UPDATE campaign SET definition = ?, version = ?", values)
    shown = CliRunner().invoke(app, ["campaign", "table", str(tmp_path)])
    assert shown.exit_code == 2
    text = " ".join(shown.output.split())
    assert "written by sato 9.1" in text and "later: is a key of another version" in text


def test_commands_show_a_campaign_and_write_its_files(tmp_path):
    campaign = Campaign(scenario="conflict", trials=3, case={"a": {}, "b": {}}, show=["wall_s:sum"])
    with CampaignTable.create(tmp_path, campaign) as table:
        for row in range(campaign.runs):
            table.add(campaign.trial(row), {"exit": "reached", "wall_s": 1.0 + row}, 1)
    folder, run = str(tmp_path), CliRunner().invoke
    shown = run(app, ["campaign", "table", folder, "--markdown", "--where", "seed>0"]).output
    assert [line.split() for line in shown.splitlines() if "| a" in line or "| b" in line] == [
        ["|", "a", "|", "2", "|", "8", "|"],
        ["|", "b", "|", "2", "|", "10", "|"],
    ]
    rows = run(app, ["campaign", "table", folder, "--rows", "--show", "wall_s"]).output
    assert rows.count("reached") == campaign.runs
    for command in ("plot", "export", "report"):
        done = run(app, ["campaign", command, folder])
        assert done.exit_code == 0
        assert all(Path(line).stat().st_size > 0 for line in done.output.splitlines())
    refused = run(app, ["campaign", "table", folder, "--show", "wal_s"])
    assert refused.exit_code == 2 and 'did you mean "wall_s"' in refused.output
