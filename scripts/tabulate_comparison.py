"""A comparison of solvers as the tables of docs/solvers.md.

    python scripts/tabulate_comparison.py runs/compare

reads the measurements.csv that `sato compare` wrote, and prints Markdown: who was right at each
tolerance, how long it took at 1e-6 on the medium size, and the worst of each kind of trouble.
"""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import median
from typing import Annotated

import typer

from sato.compare.plan import format_tolerance

FAMILY_LABELS = {  # as wide as a table can bear
    "transfer-lp": "transfer",
    "transfer-socp": "speed limit",
    "avoidance-5": "5 near",
    "avoidance-20": "20 near",
    "j2": "J2",
    "near-infeasible": "nearly out of reach",
    "infeasible": "out of reach",
    "gain-sdp": "gains",
}
EXPECTED_VERDICTS = ("", "solved", "infeasible", "skipped")

Row = dict[str, str]


def main(
    folder: Annotated[Path, typer.Argument(help="where measurements.csv is")],
    tolerance: Annotated[float, typer.Option(help="of the times")] = 1e-6,
    size: Annotated[str, typer.Option(help="of the times")] = "medium",
) -> None:
    """Print three tables."""
    rows = read_measurements(folder / "measurements.csv")
    solvers = sorted({row["solver"] for row in rows})
    tolerances = sorted({float(row["tolerance"]) for row in rows}, reverse=True)
    heads = [f"right at {format_tolerance(t)}" for t in tolerances]
    heads += ["wrong claims", "failed", "unproven", "crashed", "given up as too slow"]
    print(
        format_markdown_table(
            ["solver", *heads],
            ([s, *count_verdicts(rows_of_solver(rows, s), tolerances)] for s in solvers),
        )
    )
    there = label_families(rows)
    timed = [r for r in rows if r["size"] == size and float(r["tolerance"]) == tolerance]
    lines = (
        [s, *(median_times(rows_of_solver(timed, s), name) for name in there)] for s in solvers
    )
    print(format_markdown_table(["solver", *there.values()], lines))
    print(
        "\n".join(
            f"- *{s}*: {words}."
            for s in solvers
            if (words := list_failures(rows_of_solver(rows, s)))
        )
    )


def read_measurements(path: Path) -> list[Row]:
    """The lines of a file of measurements."""
    try:
        with open(path, newline="", encoding="utf-8") as file:
            return list(csv.DictReader(file))
    except OSError as error:
        typer.echo(f"{path} cannot be read: {error.strerror}", err=True)
        raise typer.Exit(2) from None


def label_families(rows: Iterable[Row]) -> dict[str, str]:
    """The families that were asked, in the order of the names; those without one come last."""
    asked = dict.fromkeys(row["family"] for row in rows)
    known = {name: FAMILY_LABELS[name] for name in FAMILY_LABELS if name in asked}
    return known | {name: name for name in asked if name not in FAMILY_LABELS}


def rows_of_solver(rows: Sequence[Row], solver: str) -> list[Row]:
    """The rows of a solver."""
    return [row for row in rows if row["solver"] == solver]


def count_verdicts(rows: Sequence[Row], tolerances: Sequence[float]) -> list[str]:
    """How many questions had everything right at each tolerance, and what became of all solves."""
    cells = []
    for tolerance in tolerances:
        here = [row for row in rows if float(row["tolerance"]) == tolerance]
        cells.append(f"{sum(row['right'] == 'True' for row in here)} of {len(here)}")
    found = [row[f"{time}_verdict"] for row in rows for time in ("first", "again")]
    for kind in ("wrong claim", "failed", "unproven", "crashed", "skipped"):
        cells.append(str(found.count(kind)))
    return cells


def median_times(rows: Sequence[Row], family: str) -> str:
    """Medians of the first solve and of the second, of what was right [ms]."""
    asked = [row for row in rows if row["family"] == family]
    right = [row for row in asked if row["right"] == "True"]
    if not right:
        return "✗" if asked else ""
    found = [format_milliseconds(row["first_s"] for row in right)]
    if any(row["again_s"] for row in right):
        found.append(format_milliseconds(row["again_s"] for row in right if row["again_s"]))
    share = "" if len(right) == len(asked) else f" ({len(right)} of {len(asked)})"
    return " / ".join(found) + share


def format_milliseconds(seconds: Iterable[str]) -> str:
    """The median, in two digits."""
    value = 1e3 * median(map(float, seconds))
    return f"{value:.0f}" if value >= 10 else f"{value:.2g}"


def list_failures(rows: Sequence[Row]) -> str:
    """How often there was what kind of trouble in a family, and the first example of it."""
    found: dict[tuple[str, str], list[str]] = {}
    for row in rows:
        for time in ("first", "again"):
            verdict = row[f"{time}_verdict"]
            if verdict not in EXPECTED_VERDICTS:
                found.setdefault((row["family"], verdict), []).append(row[f"{time}_why"])
    return "; ".join(
        f"{family}: {verdict} {len(whys)} ×, as in “{whys[0]}”"
        for (family, verdict), whys in found.items()
    )


def format_markdown_table(heads: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    """Markdown."""
    rule = "|---|" + "---:|" * (len(heads) - 1)
    return "\n".join([_format_markdown_row(heads), rule, *map(_format_markdown_row, lines)]) + "\n"


def _format_markdown_row(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    typer.run(main)
