"""The price of decentralisation as the table of docs/price.md.

    python scripts/tabulate_price.py plane.csv j2.csv

reads what `price_of_decentralisation.py --csv` wrote, and prints Markdown: a line a number of
vehicles, and then every instance. With `--best other.csv` an optimum that another run of the same
instances found counts where it is the better one.
"""

from collections.abc import Sequence
from math import inf, isnan
from pathlib import Path
from statistics import median
from typing import Annotated

import typer
from tabulate_comparison import Row, format_markdown_table, read_measurements

COLUMNS = (
    "model, N", "best / alone", "from SATO", "one order / best", "gave up", "SATO / best", "worst",
    "gave up", "most padding [R]", "no optimum",
)  # fmt: skip
MODEL_LABELS = {"plane": "plane", "j2": "J2"}


def main(
    files: Annotated[list[Path], typer.Argument(help="lines of instances", dir_okay=False)],
    best: Annotated[list[Path] | None, typer.Option(help="more, of which optima count")] = None,
) -> None:
    """Print a table and a list."""
    rows = [row for path in files for row in read_measurements(path)]
    rows = merge_best_optima(rows, [row for path in best or [] for row in read_measurements(path)])
    groups: dict[str, list[Row]] = {}
    for row in sorted(rows, key=_sort_key):
        groups.setdefault(f"{MODEL_LABELS[row['model']]} {row['agents']}", []).append(row)
    print(
        format_markdown_table(COLUMNS, ([name, *summary_cells(of)] for name, of in groups.items()))
    )
    print("```")
    for name, of in groups.items():
        print(f"{name:8}", *(format_ratio(ratio) for ratio in fuel_ratios(of, "sato")))
    print("```")


def _sort_key(row: Row) -> tuple[bool, int, int]:
    return row["model"] == "j2", int(row["agents"]), int(row["number"])


def merge_best_optima(rows: Sequence[Row], others: Sequence[Row]) -> list[Row]:
    """The same rows, each with the best optimum that any row of its instance has."""
    optima: dict[tuple[str, ...], Row] = {}
    for row in [*rows, *others]:
        known = optima.setdefault(_instance_key(row), row)
        if float(row["central"]) < float(known["central"]) or isnan(float(known["central"])):
            optima[_instance_key(row)] = row
    found = ("central", "from_guess", "padding")
    return [row | {name: optima[_instance_key(row)][name] for name in found} for row in rows]


def _instance_key(row: Row) -> tuple[str, ...]:
    # What all alone burn tells instances of different programmes apart.
    return row["model"], row["agents"], row["number"], row["seed"], f"{float(row['alone']):.9f}"


def summary_cells(rows: Sequence[Row]) -> list[str]:
    """The cells of one number of vehicles."""
    found = [row for row in rows if not isnan(float(row["central"]))]
    if not found:
        return [""] * (len(COLUMNS) - 2) + [f"{len(rows)} of {len(rows)}"]
    above = [float(row["central"]) / float(row["alone"]) for row in found]
    padding = max(float(row["padding"]) for row in found)
    once, often = fuel_ratios(found, "printed"), fuel_ratios(found, "sato")
    return [
        f"{median(above):.3f}",
        str(sum(row["from_guess"].startswith("SATO") for row in found)),
        format_ratio(median(once), 4),
        format_gave_up(rows, "printed"),
        f"**{format_ratio(median(often), 4)}**",
        format_ratio(max(often), 4),
        format_gave_up(rows, "sato"),
        f"{padding:.0e}",
        f"{len(rows) - len(found)} of {len(rows)}",
    ]


def format_gave_up(rows: Sequence[Row], which: str) -> str:
    """How many have something given up, of all."""
    return f"{sum(float(row[which]) == inf for row in rows)} of {len(rows)}"


def fuel_ratios(rows: Sequence[Row], which: str) -> list[float]:
    """Fuel over that of the best optimum; infinite where something was given up."""
    return [float(row[which]) / float(row["central"]) for row in rows]


def format_ratio(ratio: float, digits: int = 3) -> str:
    """A ratio, or what there is instead."""
    return "gave up" if ratio == inf else "none" if isnan(ratio) else f"{ratio:.{digits}f}"


if __name__ == "__main__":
    typer.run(main)
