"""The price of decentralisation as the table of docs/price.md.

    python scripts/tabulate_price.py plane.csv j2.csv

reads what `price_of_decentralisation.py --csv` wrote, and prints Markdown: a line a number of
vehicles, and then every instance.
"""

from collections.abc import Sequence
from math import inf, isnan
from pathlib import Path
from statistics import median
from typing import Annotated

import typer
from tabulate_comparison import Row, measured, table

HEADS = (
    "model, N", "best / alone", "one order / best", "gave up", "SATO / best", "worst", "gave up",
    "padding [R]", "no optimum",
)  # fmt: skip
NAMES = {"plane": "plane", "j2": "J2"}


def main(
    files: Annotated[list[Path], typer.Argument(help="lines of instances", dir_okay=False)],
) -> None:
    """Print a table and a list."""
    rows = [row for path in files for row in measured(path)]
    groups: dict[str, list[Row]] = {}
    for row in sorted(rows, key=_order):
        groups.setdefault(f"{NAMES[row['model']]} {row['agents']}", []).append(row)
    print(table(HEADS, ([name, *summary(of)] for name, of in groups.items())))
    print("```")
    for name, of in groups.items():
        print(f"{name:8}", *(shown(ratio) for ratio in ratios(of, "sato")))
    print("```")


def _order(row: Row) -> tuple[bool, int, int]:
    return row["model"] == "j2", int(row["agents"]), int(row["number"])


def summary(rows: Sequence[Row]) -> list[str]:
    """The cells of one number of vehicles."""
    found = [row for row in rows if not isnan(float(row["central"]))]
    if not found:
        return [""] * (len(HEADS) - 2) + [f"{len(rows)} of {len(rows)}"]
    above = [float(row["central"]) / float(row["alone"]) for row in found]
    padding = max(float(row["padding"]) for row in found)
    once, often = ratios(found, "printed"), ratios(found, "sato")
    return [
        f"{median(above):.3f}",
        shown(median(once), 4),
        f"{once.count(inf)} of {len(rows)}",
        f"**{shown(median(often), 4)}**",
        shown(max(often), 4),
        f"{often.count(inf)} of {len(rows)}",
        f"{padding:.0e}",
        f"{len(rows) - len(found)} of {len(rows)}",
    ]


def ratios(rows: Sequence[Row], which: str) -> list[float]:
    """Fuel over that of the best optimum; infinite where something was given up."""
    return [float(row[which]) / float(row["central"]) for row in rows]


def shown(ratio: float, digits: int = 3) -> str:
    """A ratio, or what there is instead."""
    return "gave up" if ratio == inf else "none" if isnan(ratio) else f"{ratio:.{digits}f}"


if __name__ == "__main__":
    typer.run(main)
