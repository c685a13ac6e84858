"""Campaigns of the repository, cases of a campaign, and the commands that show one."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from sato.campaigns.definition import Campaign, read_campaign
from sato.campaigns.table import CampaignTable
from sato.cli import app
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
