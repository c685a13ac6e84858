"""How fast are gains designed, and how near are they to what is proven to be the best?

Every row has formations of its own; rows take turns, so that whatever else the machine does
slows all of them, and times are medians over the formations, of both directions together.
The time is the processor's, on one thread. Rates are the least of −A's eigenvalues outside
the kernel, their mean being 1; a gap is the share of the proven bound that is not reached.
"""

import time
from collections.abc import Callable
from math import inf
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from problems.formation import Formation
from problems.formation_gain import Gains, Method, design
from sato.shapes.random_formation import thinned

RESIDUAL = 1e-10
EXACT = 1e-9
LARGE = 500  # vehicles, from which a row has one formation


class Row(NamedTuple):
    """One row of the table: what is designed, and what is to be reached."""

    kind: str
    n: int
    draw: Callable[[int, np.random.Generator], Formation]
    method: Method
    seconds: float
    least: float = 0.0  # rate, of all
    median: float = 0.0  # rate
    gap: float = inf  # of all


class Timed(NamedTuple):
    """One design."""

    gains: Gains
    seconds: float


def complete(n: int, rng: np.random.Generator) -> Formation:
    """Everybody measures everybody."""
    return Formation.complete(rng.uniform(0, 5, (n, 3)))


def published(n: int, rng: np.random.Generator) -> Formation:
    """The published benchmark: the complete graph less n − 3 pairs drawn at random."""
    return Formation(rng.uniform(0, 5, (n, 3)), thinned(n, n - 3, rng))


def shared(share: float) -> Callable[[int, np.random.Generator], Formation]:
    """A share of the edges, each kept or not at random."""

    def draw(n: int, rng: np.random.Generator) -> Formation:
        upper = np.triu(rng.random((n, n)) < share, 1)
        return Formation(rng.uniform(0, 1, (n, 3)) * [15, 15, 2], upper | upper.T)

    return draw


def rows() -> list[Row]:
    """What is measured, with the times to keep [s]."""
    table = [
        Row("complete", n, complete, "auto", limit, least=1 - EXACT, gap=EXACT)
        for n, limit in ((5, inf), (20, inf), (50, inf), (100, inf), (200, 0.1), (1000, inf))
    ]
    for n, near, best in ((50, 0.02, 0.5), (100, 0.05, 2.0), (200, 0.3, 10.0)):
        thin = "n − 3 removed"
        table.append(Row(thin, n, published, "projection", near, least=0.8, median=0.88))
        table.append(Row(thin, n, published, "auto", best, gap=0.01))
    for n, limit in ((20, 0.2), (50, 0.3), (100, 0.5), (200, 3.0)):
        table.append(Row("50 % of edges", n, shared(0.5), "auto", limit, gap=0.002))
    table.append(Row("20 % of edges", 1000, shared(0.2), "auto", 300.0, gap=0.01))
    return table


def timed(row: Row, formation: Formation) -> Timed:
    """Design once, with nothing kept from before."""
    begin = time.process_time()
    gains = design(formation, row.method)
    return Timed(gains, time.process_time() - begin)


def main(
    count: Annotated[int, typer.Option(help="formations a row, one where they are large")] = 20,
    quick: Annotated[bool, typer.Option(help="3 formations a row, and no large ones")] = False,
    seed: int = 0,
) -> None:
    """Print the table; exit 1 where a target is missed."""
    rng, count = np.random.default_rng(seed), 3 if quick else count
    asked = [row for row in rows() if row.n < LARGE or not quick]
    found: list[list[Timed]] = [[] for _ in asked]
    design(published(20, rng))  # what is loaded once is not what is timed
    with threadpool_limits(1):
        for turn in range(count):
            for row, designs in zip(asked, found, strict=True):
                if turn == 0 or row.n < LARGE:
                    designs.append(timed(row, row.draw(row.n, rng)))
    heads = ("graph", "n", "method", "of", "rate ≥", "median", "gap ≤", "time, s", "residual")
    table = Table(*heads)
    missed = [tell(table, row, designs) for row, designs in zip(asked, found, strict=True)]
    Console(width=120).print(table)
    raise typer.Exit(int(any(missed)))


def tell(table: Table, row: Row, designs: list[Timed]) -> bool:
    """Add a row to the table; whether it misses a target."""
    every = [design.gains for design in designs]
    rates = np.array([gains.rate for gains in every])
    gap = max(max(gains.gap_xy, gains.gap_z) for gains in every)
    residual = max(
        max(gains.residual_kernel, gains.residual_structure, gains.residual_graph)
        for gains in every
    )
    seconds = float(np.median([design.seconds for design in designs]))
    missed = not (
        rates.min() >= row.least
        and np.median(rates) >= row.median
        and gap <= row.gap
        and seconds <= row.seconds
        and residual <= RESIDUAL
    )
    table.add_row(
        row.kind,
        str(row.n),
        every[0].method,
        str(len(every)),
        f"{rates.min():.4f}" + (f" ({row.least:.4g})" if row.least else ""),
        f"{np.median(rates):.4f}" + (f" ({row.median:.4g})" if row.median else ""),
        f"{gap:.1e}" + (f" ({row.gap:.0e})" if row.gap < inf else ""),
        f"{seconds:.3f}" + (f" ({row.seconds:g})" if row.seconds < inf else ""),
        f"{residual:.0e}",
        style="red" if missed else None,
    )
    return missed


if __name__ == "__main__":
    typer.run(main)
