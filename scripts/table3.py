"""Table III of [Lusk2020]: six vehicles go twice through a pyramid, a prism and a slanted plane.

A trial is one transition, from where the last one left the vehicles, also if it failed. The
paper's are hardware flights, and a human said when a formation was taken up; here the protocol
says so, and the error of the shape is printed beside.
"""

import argparse
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import cache
from multiprocessing import get_context
from time import perf_counter
from typing import NamedTuple

import numpy as np
from numpy import ndarray as Array
from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

from problems.formation_gain import Gains, design
from sato.formation import Assigning, FormationFlight, Frame, Frames, fly, misaligned
from sato.formation.mission import as_printed
from sato.formation.shape import likeness
from sato.formation.trial import HEIGHT, Trial, judged
from sato.shapes.formations import formation
from sato.shapes.random_formation import random_start

SHAPES = ("Pentagonal Pyramid", "Triangular Prism", "Slanted Plane")
TIMES = 2  # through all of them
PERIOD = 1.2  # between two auctions [s]
SHAPE = 0.1  # error of a shape that has been taken up [m]
AREA = (6.0, 6.0)  # where they start [m],
APART = 1.5  # and how far from each other [m]


class Row(NamedTuple):
    """A configuration, and what the paper has for it."""

    name: str
    kind: str
    graph: str
    ours: bool
    paper: str  # path [m], time [s], success


ROWS = (
    Row("none, non-complete", "none", "own", False, "0.8 ± 0.5, 15.5 ± 9.2, 50 %"),
    Row("none, complete", "none", "complete", False, "0.9 ± 1.0, 11.3 ± 3.0, 67 %"),
    Row("CBAA, non-complete", "cbaa", "own", False, "1.4 ± 0.8, 14.3 ± 8.7, 100 %"),
    Row("CBAA, complete", "cbaa", "complete", False, "0.8 ± 0.6, 10.1 ± 4.8, 100 %"),
    Row("ours, none, non-complete", "none", "own", True, ""),
    Row("ours, none, complete", "none", "complete", True, ""),
    Row("ours, CBAA, non-complete", "cbaa", "own", True, ""),
    Row("ours, CBAA, complete", "cbaa", "complete", True, ""),
    Row("ours, non-complete", "vsdaa", "own", True, ""),
    Row("ours, complete", "vsdaa", "complete", True, ""),
)


class Outcome(NamedTuple):
    """What came of one transition."""

    trial: Trial
    error: float  # of the shape in the end, also if it was given up [m]


@cache
def gains(shape: str, graph: str) -> Gains:
    """Of a shape on its own graph or the complete one."""
    return design(formation(shape, graph))


def mission(row: Row, shape: str, start: Array, frames: Frames) -> FormationFlight:
    """One transition."""
    shapes = (gains(shape, row.graph),)
    if row.ours:
        return FormationFlight(start, shapes, frames, assigning=Assigning(row.kind, period=PERIOD))
    flight = as_printed(start, shapes, row.kind)
    return replace(flight, assigning=flight.assigning._replace(period=PERIOD))


def transitions(row: Row, seed: int) -> Iterator[tuple[FormationFlight, list[Frame]]]:
    """All of one flight, one after the other; the start is the same in every row."""
    rng = np.random.default_rng(seed)
    flat = random_start(6, AREA, APART, rng)
    frames = misaligned(6, spread=10.0, drift=0.01, noise=0.02, rng=rng)
    start = np.column_stack([flat, np.full(6, HEIGHT)])
    for shape in SHAPES * TIMES:
        flight = mission(row, shape, start, frames)
        seen = list(fly(flight, rng))
        yield flight, seen
        start = seen[-1].position


def outcome(flight: FormationFlight, seen: list[Frame]) -> Outcome:
    """Judge one transition."""
    last, points = seen[-1], flight.shapes[0].formation.points
    error = likeness(last.position[np.argsort(last.point)], points).error
    return Outcome(judged(flight, seen), error)


def one(job: tuple[int, int]) -> tuple[int, list[Outcome]]:
    """All transitions of a row and a seed."""
    row, seed = job
    with threadpool_limits(1, user_api="blas"):
        return row, [outcome(*flown) for flown in transitions(ROWS[row], seed)]


def spread(values: list[float]) -> str:
    """Mean and standard deviation."""
    return f"{np.mean(values):.1f} ± {np.std(values, ddof=1):.1f}" if len(values) > 1 else "–"


def share(good: int, trials: int) -> str:
    """Of all, in percent."""
    return f"{100 * good / trials:.0f} %"


def table(found: dict[int, list[Outcome]], seeds: int) -> Table:
    """All rows, the paper's beside ours."""
    shown = Table(
        title=f"{seeds * TIMES * len(SHAPES)} transitions of 6 vehicles a row; path and time of "
        "those that settled, mean ± deviation"
    )
    for name in ("", "settled", f"shape ≤ {SHAPE} m", "path [m]", "time [s]", "shape [m]"):
        shown.add_column(name)
    for name in ("longest [s]", "least separation [m]", "the paper"):
        shown.add_column(name)
    for number, outcomes in sorted(found.items()):
        good = [o for o in outcomes if o.trial.settled]
        shown.add_row(
            ROWS[number].name,
            share(len(good), len(outcomes)),
            share(sum(o.trial.settled and o.error <= SHAPE for o in outcomes), len(outcomes)),
            spread([o.trial.path for o in good]),
            spread([o.trial.time for o in good]),
            f"{np.mean([o.error for o in good]):.3f}",
            f"{max(o.trial.time for o in good):.0f}",
            f"{min(o.trial.separation for o in outcomes):.2f}",
            ROWS[number].paper,
        )
    return shown


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    asked = parser.parse_args()
    began = perf_counter()
    jobs = [(row, seed) for row in range(len(ROWS)) for seed in range(asked.seeds)]
    found: dict[int, list[Outcome]] = {}
    with ProcessPoolExecutor(asked.cores, mp_context=get_context("spawn")) as pool:
        flown = track(pool.map(one, jobs), "flying", len(jobs), console=Console(stderr=True))
        for row, outcomes in flown:
            found.setdefault(row, []).extend(outcomes)
    Console(width=200).print(table(found, asked.seeds))
    print(f"{perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
