"""Texts of strangers in pages and figures: shown as text, and nothing else."""

import shutil
import sys
import warnings
from pathlib import Path

import pytest
from playwright.sync_api import sync_playwright

import sato
from sato.campaigns.table import CampaignTable
from sato.figures.axes import as_label
from sato.terminal import as_html, as_line

sys.path.append(str(Path(__file__).parents[1] / "scripts"))

import open_hostile_pages as hostile

CHROMIUM = shutil.which("chromium")
FIELDS = [
    "attribute: name", "attribute: version", "attribute: stopped", "event: key",
    "origin: name", "note: all", "long_name: all", "variable: more", "summary: key",
]  # fmt: skip


@pytest.fixture
def visitor():
    if CHROMIUM is None:
        pytest.skip("there is no Chromium; `apt-get install chromium` installs one")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=hostile.FLAGS)
        yield hostile.Visitor(browser)
        browser.close()


def test_pages_of_runs_and_campaigns_show_hostile_texts_as_text(visitor, tmp_path):
    raw = tmp_path / "raw.html"
    raw.write_text(f"<pre>{hostile.TEXTS[0]}{hostile.TEXTS[3]}</pre>")
    assert {"script runs", "element img onerror", "1 scripts"} <= {*visitor.visit(raw)}
    run, campaign, out = tmp_path / "run", tmp_path / "campaign", tmp_path / "out"
    out.mkdir()
    sato.run("crossing").save(run)
    sato.campaign("conflict", out=campaign, trials=2, workers=1).close()
    hostile.write_run(run, tmp_path / "used", FIELDS, hostile.JOINED)
    hostile.write_campaign(campaign, tmp_path / "table", hostile.JOINED)
    with warnings.catch_warnings():  # of texts too long for their panels
        warnings.simplefilter("ignore")
        loaded = sato.load(tmp_path / "used")
        with CampaignTable(tmp_path / "table") as table:
            pages = hostile.write_campaign_pages(table, out)
    shutil.move(out / "notebook.html", out / "table.html")
    pages += [out / "table.html", hostile.write_notebook([loaded, loaded.data], out, [])]
    for page in [*pages, loaded.player(out / "player.html")]:
        assert (page.name, visitor.visit(page)) == (page.name, [])
        assert page.suffix == ".svg" or hostile.MARK in visitor.text
    assert len(pages) >= 5


@pytest.mark.parametrize("number", range(len(hostile.TEXTS)))
def test_texts_are_plain_in_lines_pages_and_figures(number):
    text = hostile.TEXTS[number]
    for plain in (as_line(text), as_html(text), as_label(text)):
        plain.encode("utf-8")
        assert not set("\x00\x1b\x7f\x9b\u202e\u2066\uffff") & set(plain)
    assert not set("<>\"'") & set(as_html(text)) and "\n" not in as_line(text)
    assert as_label(text).count("$") == as_label(text).count(r"\$")
    assert len(as_label(text).replace(r"\$", "$")) <= 101
