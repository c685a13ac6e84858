"""Statistics, tables, figures, export and report of a campaign, on made-up rows."""

import csv
from html.parser import HTMLParser

import numpy as np
import pytest
from scipy import stats

from sato.campaigns.definition import Campaign
from sato.campaigns.export import export
from sato.campaigns.figures import draw_campaign, draw_distributions
from sato.campaigns.report import write_report
from sato.campaigns.selection import Group, GroupTable, Term, group_runs, list_runs, parse_term
from sato.campaigns.statistics import Statistics, wilson_interval
from sato.campaigns.table import CampaignTable
from sato.scenario.errors import InputError

POINTS, TRIALS = 6, 8


def made_up(trial, rng):
    """Make up the outcome of a trial."""
    exit = ("reached", "reached", "broken", "time limit")[rng.integers(4)]
    outcome = {"exit": exit, "error": None if exit == "reached" else "line <1>\nit & failed"}
    if exit != "time limit":
        fuel = rng.gamma(9.0)
        least = np.nan if rng.random() < 0.1 else 0.5 + rng.random()
        legs = [{"reached": True, "holes": int(rng.integers(3))}]
        outcome["summary"] = {"fuel_m_s": fuel, "min_separation_m": least, "legs": legs}
        outcome["columns"] = {"good": bool(rng.random() < 0.7)}
    return outcome | {"wall_s": rng.gamma(2.0)}


@pytest.fixture(scope="module")
def table(tmp_path_factory):
    grid = {"swarm.agents": [2, 3, 4], "plan.objective": ["fuel", "energy"]}
    campaign = Campaign(name="made-up", scenario="conflict", trials=TRIALS, grid=grid)
    rng = np.random.default_rng(0)
    with CampaignTable.create(tmp_path_factory.mktemp("made-up"), campaign) as written:
        for row in rng.permutation(campaign.runs):
            trial = campaign.trial(int(row))
            written.add(trial, made_up(trial, rng), 1)
        yield written


@pytest.mark.parametrize(
    ("good", "count", "low", "high"),
    [
        (98, 100, 0.9300, 0.9945),
        (0, 10, 0.0, 0.2775),
        (10, 10, 0.7225, 1.0),
        (1, 29, 0.0061, 0.1718),
    ],
)
def test_interval_of_a_rate_is_as_published(good, count, low, high):
    # 1 of 29 is of [Newcombe1998, Table I, method 3].
    assert wilson_interval(good, count) == pytest.approx((low, high), abs=5e-5)


def test_intervals_of_rates_and_means_are_those_of_scipy(rng):
    for count in rng.integers(1, 200, 20):
        values = rng.random(count) < rng.random()
        expected = stats.binomtest(int(values.sum()), int(count)).proportion_ci(method="wilson")
        assert Statistics.of(values, is_rate=True).interval == pytest.approx(tuple(expected))
        values = rng.normal(size=count + 1)
        expected = stats.t.interval(0.95, count, values.mean(), stats.sem(values))
        assert Statistics.of(values).interval == pytest.approx(expected)
        assert Statistics.of(values).number("p37") == pytest.approx(np.quantile(values, 0.37))


def test_statistics_ignore_what_is_absent_and_keep_what_is_infinite():
    found = Statistics.of([3.0, None, float("nan"), 1.0, True])
    assert (found.count, found.runs, found.mean) == (3, 5, pytest.approx(5 / 3))
    assert [found.number(name) for name in ("least", "median", "largest", "p50", "sum")] == [
        1.0, 1.0, 3.0, 1.0, 5.0,
    ]  # fmt: skip
    infinite = Statistics.of([1.0, 2.0, np.inf])
    assert (infinite.number("median"), infinite.mean) == (2.0, np.inf)
    assert np.isnan(infinite.deviation) and "inf" in infinite.text("mean")
    empty = Statistics.of([None], is_rate=True)
    assert (empty.text("rate"), empty.text("mean"), empty.text("count")) == ("–", "–", "0")
    assert Statistics.of([True] * 98 + [False] * 2, is_rate=True).text("rate") == "98 % [93, 99]"
    assert Statistics.of([1, 0, None], is_rate=True).text("rate").endswith("of 2")


def test_groups_partition_the_runs_whatever_they_are_grouped_by(table):
    cells = list(table.rows())
    for by in ([], ["swarm.agents"], ["exit", "plan.objective"], ["good"], ["legs.0.holes"]):
        found = group_runs(table, by, ["fuel_m_s:sum", "fuel_m_s:count", "good"])
        assert sum(group.runs for group in found.groups) == len(cells) == POINTS * TRIALS
        assert len({group.key for group in found.groups}) == len(found.groups)
        fuel = sum(cell["fuel_m_s"] or 0.0 for cell in cells)
        assert sum(g.cells[0].number("sum") for g in found.groups) == pytest.approx(fuel)
    assert group_runs(table).by == ("swarm.agents", "plan.objective")


def test_terms_are_what_the_rows_say(table):
    cells = list(table.rows())
    ran = [cell for cell in cells if cell["fuel_m_s"] is not None]
    terms = ["exit=reached", "good", "fuel_m_s/wall_s:median", "legs.0.holes<=1", "fuel_m_s>9:sum"]
    [group] = group_runs(table, [], terms, ["swarm.agents>=3"]).groups
    ran = [cell for cell in ran if cell["swarm.agents"] >= 3]
    cells = [cell for cell in cells if cell["swarm.agents"] >= 3]
    assert group.cells[0].mean == np.mean([cell["exit"] == "reached" for cell in cells])
    assert group.cells[1].is_rate and group.cells[1].mean == np.mean([c["good"] for c in ran])
    ratios = [cell["fuel_m_s"] / cell["wall_s"] for cell in ran]
    assert group.cells[2].number("median") == pytest.approx(np.median(ratios))
    holes = [int(cell["legs"].partition('"holes": ')[2][0]) for cell in ran]
    assert group.cells[3].mean == np.mean([count <= 1 for count in holes])
    assert group.cells[4].number("sum") == sum(cell["fuel_m_s"] > 9 for cell in ran)
    head, rows = list_runs(table, [], ["fuel_m_s"], ["exit=broken"])
    assert head == ["row", "seed", "fuel_m_s", "exit", "error"]
    assert {row[-1] for row in rows} == {"it & failed"}


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("fuel_m", 'no column "fuel_m"; did you mean "fuel_m_s"'),
        ("fuel_m_s:medien", 'did you mean "median"'),
        ("fuel_m_s//wall_s", "is not COLUMN"),
        ("exit", "exit=reached|exit=broken|exit=time limit"),
        ("wall_s:rate", "neither true nor false"),
        ("fuel_m_s<0,5", '< needs a number, such as 0.5, got "0,5"'),
        ("fuel_m_s>=0.5 m/s:rate", '>= needs a number, such as 0.5, got "0.5 m/s"'),
    ],
)
def test_what_cannot_be_shown_is_refused_with_what_would_do(table, text, reason):
    with pytest.raises(InputError, match=reason):
        group_runs(table, [], [text])


def test_value_of_a_condition_may_hold_signs_of_terms(table):
    assert parse_term("fuel_m_s=1/wall_s<=x", table).parameters[0] == "1/wall_s<=x"


def test_column_of_booleans_and_numbers_has_the_rate_of_a_condition(tmp_path):
    campaign = Campaign(scenario="conflict", trials=3)
    with CampaignTable.create(tmp_path, campaign) as written:
        for row, value in enumerate((True, 7, False)):
            outcome = {"exit": "reached", "columns": {"good": value}}
            written.add(campaign.trial(row), outcome, 1)
        with pytest.raises(InputError, match="good=true would show its rate"):
            group_runs(written, [], ["good"])
        [group] = group_runs(written, [], ["good=true"]).groups
    assert group.cells[0].mean == pytest.approx(1 / 3)


def test_condition_is_asked_for_where_a_column_cannot_select(table):
    with pytest.raises(InputError, match="is not a condition"):
        group_runs(table, [], [], ["fuel_m_s"])


def test_export_returns_every_cell_and_is_refused_elsewhere(table, tmp_path):
    with open(export(table, tmp_path / "rows.csv"), newline="") as file:
        read = list(csv.DictReader(file))
    cells = [{k: "" if v is None else str(v) for k, v in row.items()} for row in table.rows()]
    assert read == cells
    with pytest.raises(InputError, match="no format"):
        export(table, tmp_path / "rows.xls", "xls")
    with pytest.raises(InputError, match="is a folder"):
        export(table, tmp_path)


def test_parquet_returns_every_cell_or_tells_what_is_missing(table, tmp_path):
    path = tmp_path / "rows.parquet"
    try:
        from pyarrow.parquet import read_table
    except ImportError:
        with pytest.raises(InputError, match="pip install pyarrow"):
            export(table, path, "parquet")
        assert not path.exists()
    else:
        assert read_table(export(table, path, "parquet")).to_pylist() == list(table.rows())


class Links(HTMLParser):
    """Collects what a page would fetch, and its text."""

    def __init__(self):
        super().__init__()
        self.links, self.words = [], []

    def handle_starttag(self, tag, attrs):
        self.links += [value for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data):
        self.words.append(data)


def test_report_fetches_nothing_and_tells_how_to_run_failures_again(table, tmp_path):
    text = write_report(table, tmp_path / "report.html").read_text(encoding="utf-8")
    page = Links()
    page.feed(text)
    assert len(page.links) == 4 and all(link.startswith("data:image/png") for link in page.links)
    assert "http" not in text and "@import" not in text and "<script" not in text
    failed = [row["row"] for row in table.rows() if row["exit"] != "reached"]
    assert failed
    for row in failed:
        assert f"sato campaign rerun {table.folder} {row}" in page.words
    assert "made-up" in page.words and "it & failed" in page.words


def test_figures_show_the_groups_and_the_runs(table):
    figures = draw_campaign(table, show=["good", "fuel_m_s:median", "wall_s"])
    assert list(figures) == ["rates", "distributions", "grid", "scatter"]
    ax, means = figures["rates"].axes
    assert (ax.get_xlabel(), means.get_xlabel()) == ("good [%]", "wall_s, mean")
    assert [label.get_text() for label in ax.get_yticklabels()][:2] == ["2, fuel", "2, energy"]
    grid = figures["grid"].axes[1].images[0].get_array()
    medians = [g.cells[0].number("median") for g in group_runs(table, None, ["fuel_m_s"]).groups]
    assert np.array_equal(grid.ravel(), medians)
    drawn = sum(len(line.get_xdata()) for line in figures["scatter"].axes[0].lines)
    assert drawn == sum(row["fuel_m_s"] is not None for row in table.rows())
    with pytest.raises(InputError, match="nothing to draw"):
        draw_campaign(table, where=["exit=died"])
    with pytest.raises(InputError, match='there is no exit "reachd"; there are reached, done'):
        draw_campaign(table, where=["exit=reachd"])


def test_curve_of_a_distribution_ends_at_the_share_that_is_finite():
    group = Group((), 4, (Statistics.of([1.0, np.inf, 2.0, 3.0]),))
    term = Term("x", "", (), False, "mean")
    [line] = draw_distributions(GroupTable((), (term,), (group,))).axes[0].lines
    assert line.get_ydata()[np.isfinite(line.get_xdata())].max() == 0.75
