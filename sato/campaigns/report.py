"""Report of a campaign: tables and figures in one HTML file, which asks for nothing else."""

import json
from base64 import b64encode
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from shlex import quote
from typing import Any

import tomli_w

from sato.atomic import replace_atomically
from sato.campaigns.figures import as_png, draw_campaign
from sato.campaigns.selection import group_runs
from sato.campaigns.table import SUCCESSES, CampaignTable
from sato.terminal import as_html

MAX_FAILURES = 500  # that are listed
CAPTIONS = {
    "rates": "Rates and means of the groups, with 95 % intervals",
    "distributions": "Empirical distributions",
    "grid": "Statistics over the grid",
    "scatter": "Runs",
}
_CSS = """
body { font: 15px/1.45 system-ui, sans-serif; max-width: 70rem; margin: 2rem auto;
  padding: 0 1rem; color: #222 }
table { border-collapse: collapse; font-variant-numeric: tabular-nums }
th, td { padding: 0.2rem 1.2rem 0.2rem 0; border-bottom: 1px solid #ddd; text-align: left;
  vertical-align: top; white-space: pre-line }
div { overflow-x: auto }
img { max-width: 100%; display: block; margin: 1rem 0 }
pre { background: #f5f5f5; padding: 0.8rem; overflow-x: auto }
"""


def write_report(table: CampaignTable, path: Path) -> Path:
    """Write the report of a campaign that has runs; a file is replaced once all is written."""
    figures = draw_campaign(table)
    text = "\n".join(
        [
            *_format_head(table),
            "<h2>Groups</h2>",
            "<p>Rates with Wilson’s interval, means ± deviation with Student’s; 95 %.</p>",
            _format_table(*group_runs(table).text()),
            *(_format_figure(CAPTIONS[name], as_png(figure)) for name, figure in figures.items()),
            *_format_failures(table),
            "<h2>Definition</h2>",
            f"<pre>{as_html(_format_definition(table))}</pre>",
            "</body></html>\n",
        ]
    )
    with replace_atomically(path) as new:
        new.write_text(text, encoding="utf-8")
    return path


def _format_head(table: CampaignTable) -> list[str]:
    name = as_html(table.campaign.name)
    exits = [f"{count} {exit}" for exit, count in table.exits().items()]
    runs = f"{len(table)} of {table.campaign.runs}: {', '.join(exits)}"
    facts = ["Runs", runs], ["Version", f"sato {table.version}"], ["Table", str(table.path)]
    return [
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">',
        f"<title>{name}</title><style>{_CSS}</style></head>\n<body>\n<h1>{name}</h1>",
        _format_table([], facts),
    ]


def _format_failures(table: CampaignTable) -> list[str]:
    failed = "SELECT row, seed, parameters, exit, error FROM runs WHERE exit NOT IN (?, ?)"
    rows = list(table.query(f"{failed} ORDER BY row", SUCCESSES))
    lines = [f"<h2>Runs that did not reach it: {len(rows)}</h2>"]
    if len(rows) > MAX_FAILURES:
        lines.append(f"<p>The first {MAX_FAILURES}.</p>")
    head = ["row", "seed", "parameters", "exit", "error", "again"]
    cells = []
    for row, seed, parameters, exit, error in rows[:MAX_FAILURES]:
        values = _format_parameters(parameters)
        last = str(error or "").strip().rpartition("\n")[2]
        trust = " --trust" if table.campaign.functions else ""
        again = f"sato campaign rerun {quote(str(table.folder.resolve()))} {row}{trust}"
        cells.append([str(row), str(seed), values, str(exit), last, again])
    return [*lines, _format_table(head, cells)] if rows else lines


def _format_parameters(text: Any) -> str:
    with suppress(ValueError, TypeError, AttributeError, RecursionError):
        return ", ".join(f"{key} = {value}" for key, value in json.loads(text).items())
    return str(text)  # of a damaged row


def _format_definition(table: CampaignTable) -> str:
    def known(value: Any) -> Any:  # TOML has no null
        if isinstance(value, dict):
            return {key: known(part) for key, part in value.items() if part not in (None, {}, "")}
        return [known(part) for part in value] if isinstance(value, list) else value

    return tomli_w.dumps(known(json.loads(table.campaign.to_json())))


def _format_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    def line(cells: Sequence[str], tag: str) -> str:
        return f"<tr>{''.join(f'<{tag}>{as_html(cell)}</{tag}>' for cell in cells)}</tr>"

    lines = [line(head, "th")] if head else []
    return "\n".join(["<div><table>", *lines, *(line(row, "td") for row in rows), "</table></div>"])


def _format_figure(caption: str, png: bytes) -> str:
    data = b64encode(png).decode()
    return f'<h2>{caption}</h2>\n<img alt="{caption}" src="data:image/png;base64,{data}">'
