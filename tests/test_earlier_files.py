"""Files of earlier versions: read and judged as by the version that wrote them."""

import json
import re
import sqlite3
from contextlib import closing

import pytest

import sato
from sato.campaigns.engine import fly_again
from sato.campaigns.table import CampaignTable
from sato.check.report import JUDGED
from sato.scenario.origin import Origin
from sato.verify import LATER

SHORT = {
    "crossing": (),
    "formation": ("protocol.limit_s=9",),
    "connectivity": ("run.duration_s=1", "start_s=0", "swarm.agents=3"),
}


@pytest.fixture(scope="module", params=SHORT)
def run(request):
    return sato.run(request.param, overrides=SHORT[request.param])


def write_early(run, folder, **entries):
    """Save a run with the summary of a version before verdicts; return the file of it."""
    file = run.save(folder) / "summary.json"
    summary = json.loads(file.read_text())
    early = {k: v for k, v in summary.items() if k not in {"verdict", "digest", *LATER}}
    file.write_text(json.dumps(early | entries))
    return folder


def test_a_summary_before_verdicts_is_judged_by_its_numbers(run, tmp_path):
    for success in (True, False):
        early = sato.load(write_early(run, tmp_path, success=success, broken=["x"]))
        assert (early.verdict, early.report.line) == (run.verdict, run.report.line)
        assert early.summary == run.summary


@pytest.mark.parametrize("entry", ["wall_s", "min_separation_m", "prize"])
def test_a_number_of_an_early_summary_that_is_wrong_is_told(run, tmp_path, entry):
    report = sato.load(write_early(run, tmp_path, **{entry: 123.0})).report
    [broken] = [promise for promise in report.broken if promise.name == "summary"]
    assert broken.message.endswith(f": {entry}") and report.verdict == "broken"


def test_an_entry_that_all_versions_wrote_is_missed(run, tmp_path):
    folder = write_early(run, tmp_path)
    summary = json.loads((folder / "summary.json").read_text())
    del summary["min_separation_m"]
    (folder / "summary.json").write_text(json.dumps(summary))
    assert sato.load(folder).verdict == "broken"


def test_a_built_in_scenario_before_a_key_was_known_is_that_scenario():
    text, origin = sato.read("crossing").to_toml(), Origin("built-in", "crossing")
    early = re.sub(r"\n(compute_s|printed) = .*|\[link\](\n.+)+", "", text)
    assert early.count("\n") < text.count("\n") - 5
    assert origin.gives(early) and origin.gives(text)
    assert not origin.gives(early.replace("step_s = ", "step_s = 1"))
    assert not origin.gives("no = TOML =")


def test_a_row_before_verdicts_is_equal_to_itself_flown_again(tmp_path):
    sato.campaign("conflict", out=tmp_path, trials=1, workers=1).close()
    with closing(sqlite3.connect(tmp_path / "campaign.sqlite")) as opened:
        opened.execute("ALTER TABLE runs DROP COLUMN verdict")
        opened.execute("UPDATE runs SET broken = '[1]'")
        opened.commit()
    with CampaignTable(tmp_path) as table:
        assert "verdict" in JUDGED and "verdict" not in table.columns
        assert fly_again(table, 0)[1] == []
