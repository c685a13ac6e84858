"""Tables of the pages that scripts write, each with the commit, the machine and the versions.

A table stands between markers that name what writes it:

    <!-- written by scripts/benchmark_costs.py -->
    …
    <!-- end -->
"""

import os
import re
import subprocess
from pathlib import Path

from rich.table import Table
from rich.text import Text

from problems.solvers import load_adapters
from sato.compare.report import describe_machine

ROOT = Path(__file__).parents[1]
BENCHMARKS = ROOT / "docs/benchmarks.md"
PACKAGES = ("dynamics", "problems", "sato")


def as_markdown(table: Table) -> list[str]:
    """Return the lines of a table."""
    columns = [[_plain(column.header), *map(_plain, column.cells)] for column in table.columns]
    rows = [
        " | ".join(cell.replace("|", "\\|") for cell in row) for row in zip(*columns, strict=True)
    ]
    lines = [f"| {row} |" for row in rows]
    return [lines[0], "|---" * len(columns) + "|", *lines[1:]]


def _plain(cell: object) -> str:
    text = cell.plain if isinstance(cell, Text) else str(cell)
    return " ".join(text.replace("\n", ": ").split())


def describe_origin() -> str:
    """Name commit, machine, its load and versions, and nothing that identifies the owner."""
    commit = _git("rev-parse", "--short", "HEAD")
    commit += " with changes" if _git("status", "--porcelain", *PACKAGES) else ""
    solvers = [load_adapters()[name] for name in ("clarabel", "highs") if name in load_adapters()]
    machine = describe_machine(solvers)
    names = ", ".join(f"{name} {number}" for name, number in machine["versions"].items())
    place = f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}"
    load = f"load average {os.getloadavg()[0]:.0f}"
    return f"*Commit {commit}; {place}, {load}; {names}.*"


def _git(*arguments: str) -> str:
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()


def write_table(table: Table, source: str, page: Path = BENCHMARKS, note: str = "") -> None:
    """Replace what stands between the markers of a source.

    Args:
        table: Table that was measured just now.
        source: Script and arguments, as the marker of the page has them.
        page: Page with the marker.
        note: Circumstances that readers should know, such as other work on the machine.

    Raises:
        ValueError: The page has no such marker, or more than one.
    """
    lines = [*as_markdown(table), "", describe_origin() + (f" {note}" if note else "")]
    text = page.read_text("utf-8")
    head = f"<!-- written by {source} -->"
    pattern = rf"{re.escape(head)}\n.*?<!-- end -->"
    new, count = re.subn(
        pattern,
        lambda _: "\n".join([head, "", *lines, "", "<!-- end -->"]),
        text,
        flags=re.DOTALL,
    )
    if count != 1:
        raise ValueError(f"{page.name} has {count} markers {head}; it takes one")
    page.write_text(new, "utf-8")
