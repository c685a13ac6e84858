"""Write the table of a campaign into the page of benchmarks.

After `sato campaign run FILE`:

    python scripts/tabulate_campaign.py campaigns/uiuc.toml runs/uiuc --write

Columns are those of [table] in the file, as it is now, without times, which other work on the
machine decides. Without `--write` it prints them.
"""

import tomllib
from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.table import Table
from written_tables import BENCHMARKS, ROOT, write_table

from sato.campaigns.selection import group_runs
from sato.campaigns.table import open_table

TIMES = "wall_s", "auction_ms"  # columns that other work on the machine decides


def main(
    file: Annotated[Path, typer.Argument(help="Definition of the campaign.")],
    folder: Annotated[Path, typer.Argument(help="Folder with its table.")],
    write: Annotated[bool, typer.Option("--write", help="Replace the table of the page.")] = False,
    note: Annotated[str, typer.Option(help="Circumstances, such as other work.")] = "",
    times: Annotated[bool, typer.Option(help="Show wall times too.")] = False,
    page: Annotated[Path, typer.Option(help="Page with the marker.")] = BENCHMARKS,
) -> None:
    """Print or write the table; exit 1 where runs are missing."""
    shown = tomllib.loads(file.read_text("utf-8")).get("table", {})
    runs = open_table(folder)
    terms = [term for term in shown.get("show", ()) if times or not term.startswith(TIMES)]
    head, rows = group_runs(runs, shown.get("by"), terms).text()
    table = Table(*head)
    for row in rows:
        table.add_row(*row)
    Console(width=200).print(table)
    if len(runs) < runs.campaign.runs:
        print(f"{len(runs)} of {runs.campaign.runs} runs: fly the rest first")
        raise typer.Exit(1)
    if write:
        source = f"scripts/tabulate_campaign.py {file.resolve().relative_to(ROOT)}"
        write_table(table, source, page, note)


if __name__ == "__main__":
    typer.run(main)
