"""Time of gain designs, and their gap to the proven optimum.

Every row has formations of its own; rows take turns, so that whatever else the machine does
slows all of them, and times are medians over the formations, of both directions together.
Formations of the library come again and again. The time is the processor's, on one thread.
Rates are the least of −A's eigenvalues outside the kernel, their mean being 1 in each
direction; a gap is the share of the proven bound that is not reached.
"""

import time
from collections.abc import Callable
from itertools import cycle
from math import inf
from typing import Annotated, NamedTuple

import numpy as np
import typer
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from problems.desired_formation import DesiredFormation
from problems.gain_design import GainMatrix, GainMethod, design_gains
from sato.shapes.formation_library import formation_names, load_formation, random_dense_graph

MAX_RESIDUAL = 1e-10
RATE_TOLERANCE = 1e-9
LARGE_SIZE = 500  # vehicles, from which a row has one formation
LIBRARY_LIMITS: dict[GainMethod, float] = {"projection": 0.005, "auto": 0.01}  # [s]
SMALL_SIZE = 6  # vehicles, up to which formations of the library have rows


class GainCase(NamedTuple):
    """Row of the table: the formations to design for, and the targets to meet."""

    kind: str
    n: int
    draw: Callable[[int, np.random.Generator], DesiredFormation]
    method: GainMethod
    max_seconds: float
    min_rate: float = 0.0  # rate, of all
    min_median_rate: float = 0.0  # rate
    max_gap: float = inf  # of all


class TimedDesign(NamedTuple):
    """Design with its time."""

    gains: GainMatrix
    seconds: float


def draw_complete(n: int, rng: np.random.Generator) -> DesiredFormation:
    """Draw a formation on the complete graph."""
    return DesiredFormation.with_complete_graph(rng.uniform(0, 5, (n, 3)))


def draw_published(n: int, rng: np.random.Generator) -> DesiredFormation:
    """Draw the published benchmark: the complete graph less n − 3 random pairs."""
    return DesiredFormation(rng.uniform(0, 5, (n, 3)), random_dense_graph(n, n - 3, rng))


def draw_with_edge_share(share: float) -> Callable[[int, np.random.Generator], DesiredFormation]:
    """Return a function that draws formations and keeps each edge with this probability."""

    def draw(n: int, rng: np.random.Generator) -> DesiredFormation:
        upper = np.triu(rng.random((n, n)) < share, 1)
        return DesiredFormation(rng.uniform(0, 1, (n, 3)) * [15, 15, 2], upper | upper.T)

    return draw


def load_in_turn(*names: str) -> Callable[[int, np.random.Generator], DesiredFormation]:
    """Return a function that loads these formations of the library in turn."""
    turns = cycle(names)
    return lambda n, rng: load_formation(next(turns))


def make_library_cases() -> list[GainCase]:
    """Build the rows of the library's small formations: complete graphs in one, others apart."""
    every = {name: load_formation(name) for name in formation_names()}
    small = {name: each for name, each in every.items() if len(each.points) <= SMALL_SIZE}
    complete = [name for name, each in small.items() if each.density == 1]
    return [GainCase("library, complete", SMALL_SIZE, load_in_turn(*complete), "auto", 0.005)] + [
        GainCase(name.split("/")[1], SMALL_SIZE, load_in_turn(name), method, limit)
        for name in sorted(small.keys() - complete)
        for method, limit in LIBRARY_LIMITS.items()
    ]


def make_cases() -> list[GainCase]:
    """Build the rows, with their time limits [s]."""
    table = make_library_cases()
    table += [
        GainCase(
            "complete",
            n,
            draw_complete,
            "auto",
            limit,
            min_rate=1 - RATE_TOLERANCE,
            max_gap=RATE_TOLERANCE,
        )
        for n, limit in ((5, inf), (20, inf), (50, inf), (100, inf), (200, 0.1), (1000, inf))
    ]
    for n, near, best in ((50, 0.02, 0.5), (100, 0.05, 2.0), (200, 0.3, 10.0)):
        thin = "n − 3 removed"
        table.append(
            GainCase(
                thin, n, draw_published, "projection", near, min_rate=0.8, min_median_rate=0.88
            )
        )
        table.append(GainCase(thin, n, draw_published, "auto", best, max_gap=0.01))
    for n, limit in ((20, 0.2), (50, 0.3), (100, 0.5), (200, 3.0)):
        table.append(
            GainCase("50 % of edges", n, draw_with_edge_share(0.5), "auto", limit, max_gap=0.002)
        )
    table.append(
        GainCase("20 % of edges", 1000, draw_with_edge_share(0.2), "auto", 300.0, max_gap=0.01)
    )
    return table


def time_design(row: GainCase, formation: DesiredFormation) -> TimedDesign:
    """Time one design without cached results."""
    begin = time.process_time()
    gains = design_gains(formation, row.method)
    return TimedDesign(gains, time.process_time() - begin)


def main(
    count: Annotated[int, typer.Option(help="formations a row, one where they are large")] = 20,
    quick: Annotated[bool, typer.Option(help="3 formations a row, and no large ones")] = False,
    seed: int = 0,
) -> None:
    """Print the table; exit 1 where a target is missed."""
    rng, count = np.random.default_rng(seed), 3 if quick else count
    asked = [row for row in make_cases() if row.n < LARGE_SIZE or not quick]
    found: list[list[TimedDesign]] = [[] for _ in asked]
    design_gains(draw_published(20, rng))  # what is loaded once is not what is timed
    with threadpool_limits(1):
        for turn in range(count):
            for row, designs in zip(asked, found, strict=True):
                if turn == 0 or row.n < LARGE_SIZE:
                    designs.append(time_design(row, row.draw(row.n, rng)))
    heads = ("graph", "n", "method", "of", "rate ≥", "median", "gap ≤", "time, s", "residual")
    table = Table(*heads)
    missed = [add_row(table, row, designs) for row, designs in zip(asked, found, strict=True)]
    Console(width=120).print(table)
    raise typer.Exit(int(any(missed)))


def add_row(table: Table, row: GainCase, designs: list[TimedDesign]) -> bool:
    """Add a row to the table; return True if it misses a target."""
    every = [design.gains for design in designs]
    rates = np.array([gains.convergence_rate for gains in every])
    gap = max(max(gains.gap_xy, gains.gap_z) for gains in every)
    residual = max(
        max(gains.residual_kernel, gains.residual_structure, gains.residual_graph)
        for gains in every
    )
    seconds = float(np.median([design.seconds for design in designs]))
    missed = not (
        rates.min() >= row.min_rate
        and np.median(rates) >= row.min_median_rate
        and gap <= row.max_gap
        and seconds <= row.max_seconds
        and residual <= MAX_RESIDUAL
    )
    table.add_row(
        row.kind,
        str(row.n),
        every[0].method,
        str(len(every)),
        f"{rates.min():.4f}" + (f" ({row.min_rate:.4g})" if row.min_rate else ""),
        f"{np.median(rates):.4f}"
        + (f" ({row.min_median_rate:.4g})" if row.min_median_rate else ""),
        f"{gap:.1e}" + (f" ({row.max_gap:.0e})" if row.max_gap < inf else ""),
        f"{seconds:.2g}" + (f" ({row.max_seconds:g})" if row.max_seconds < inf else ""),
        f"{residual:.0e}",
        style="red" if missed else None,
    )
    return missed


if __name__ == "__main__":
    typer.run(main)
