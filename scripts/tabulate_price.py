"""Tables of docs/price.md: python scripts/tabulate_price.py plane.csv j2.csv.

Reads what `price_of_decentralization.py --csv` wrote, and prints Markdown: a row for each number
of vehicles, and then every instance. With `--best other.csv`, the better of the two optima counts
where another run of the same instances found one.
"""

from math import isnan
from pathlib import Path
from typing import Annotated

import typer
from price_of_decentralization import (
    COLUMNS,
    PriceResult,
    format_ratio,
    group_by_size,
    read_csv,
    summary_cells,
)


def main(
    files: Annotated[list[Path], typer.Argument(help="tables of instances", dir_okay=False)],
    best: Annotated[list[Path] | None, typer.Option(help="more tables, for their optima")] = None,
) -> None:
    """Print a table and a list."""
    rows = [row for path in files for row in read_csv(path)]
    rows = merge_best_optima(rows, [row for path in best or [] for row in read_csv(path)])
    groups = group_by_size(sorted(rows, key=lambda row: (row.case.model == "j2", row.case[1:])))
    print("|", " | ".join(COLUMNS), "|\n|---|" + "---:|" * (len(COLUMNS) - 1))
    for name, group in groups.items():
        print("|", " | ".join([name, *summary_cells(group)]), "|")
    print("\n```")
    for name, group in groups.items():
        print(f"{name:8}", *(format_ratio(row.ratio) for row in group))
    print("```")


def merge_best_optima(rows: list[PriceResult], others: list[PriceResult]) -> list[PriceResult]:
    """Return the rows, each with the best optimum that any row of its instance has."""
    optima: dict[tuple[object, ...], PriceResult] = {}
    for row in [*rows, *others]:
        known = optima.setdefault(_instance_key(row), row)
        if row.central < known.central or isnan(known.central):
            optima[_instance_key(row)] = row
    merged = []
    for row in rows:
        best = optima[_instance_key(row)]
        merged.append(
            row._replace(central=best.central, from_guess=best.from_guess, padding=best.padding)
        )
    return merged


def _instance_key(row: PriceResult) -> tuple[object, ...]:
    # The fuel without avoidance tells instances of different programs apart.
    return *row.case[:4], f"{row.alone:.9f}"


if __name__ == "__main__":
    typer.run(main)
