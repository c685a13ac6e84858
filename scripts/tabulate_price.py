"""Tables of docs/price.md: python scripts/tabulate_price.py plane.csv j2.csv.

Reads what `sato campaign export` wrote of campaigns/price.toml, and prints Markdown: a row for each
number of vehicles, and then every instance. With `--best other.csv`, the better of the two optima
counts where another run of the same instances found one.
"""

from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import typer

COLUMNS = (
    "model, N", "best / alone", "from SATO", "one order / best", "gave up", "SATO / best", "worst",
    "gave up", "most padding [R]", "no optimum",
)  # fmt: skip
FUELS = ["alone", "printed", "sato"]  # [m/s]
OPTIMUM = ["central", "from_guess", "padding"]
# The fuel without avoidance tells instances of different programs apart.
INSTANCE = ["model", "agents", "number", "seed", "rounded"]


def main(
    files: Annotated[list[Path], typer.Argument(help="tables of instances", dir_okay=False)],
    best: Annotated[list[Path] | None, typer.Option(help="more tables, for their optima")] = None,
) -> None:
    """Print a table and a list."""
    rows = pd.concat(map(read_rows, files))
    optima = pd.concat([rows, *map(read_rows, best or [])]).sort_values("central", kind="stable")
    optima = optima.drop_duplicates(INSTANCE)[INSTANCE + OPTIMUM]
    rows = rows.drop(columns=OPTIMUM).merge(optima, on=INSTANCE)
    rows = rows.sort_values(["model", "agents", "number"], ascending=[False, True, True])
    rows["ratio"] = rows["sato"] / rows["central"]
    groups = {f"{m} {n}": rows for (m, n), rows in rows.groupby(["model", "agents"], sort=False)}
    print("|", " | ".join(COLUMNS), "|\n|---|" + "---:|" * (len(COLUMNS) - 1))
    for name, group in groups.items():
        print("|", " | ".join([name, *summary_cells(group)]), "|")
    print("\n```")
    for name, group in groups.items():
        print(f"{name:8}", *map(format_ratio, group["ratio"]))
    print("```")


def read_rows(path: Path) -> pd.DataFrame:
    """Read a table of instances."""
    try:
        rows = pd.read_csv(path, keep_default_na=False, na_values=["", "nan"])
        return rows.assign(rounded=rows["alone"].round(9))[[*INSTANCE, *OPTIMUM, *FUELS]]
    except (OSError, KeyError, ValueError) as error:
        raise typer.BadParameter(f"{path} is not a table of instances: {error!r}") from None


def summary_cells(rows: pd.DataFrame) -> list[str]:
    """Format the cells of one number of vehicles."""
    found = rows[rows["central"].notna()]
    return [
        f"{(found['central'] / found['alone']).median():.3f}",
        str(found["from_guess"].str.startswith("SATO").sum()),
        format_ratio((found["printed"] / found["central"]).median(), 4),
        f"{np.isinf(rows['printed']).sum()} of {len(rows)}",
        format_ratio(found["ratio"].median(), 4),
        format_ratio(found["ratio"].max(), 4),
        f"{np.isinf(rows['sato']).sum()} of {len(rows)}",
        f"{found['padding'].max():.0e}",
        f"{len(rows) - len(found)} of {len(rows)}",
    ]


def format_ratio(ratio: float, digits: int = 3) -> str:
    """Format a ratio, or "gave up" where it is infinite and "none" where there is no optimum."""
    return "gave up" if np.isinf(ratio) else "none" if np.isnan(ratio) else f"{ratio:.{digits}f}"


if __name__ == "__main__":
    typer.run(main)
