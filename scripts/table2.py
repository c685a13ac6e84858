"""Table II of [Lusk2020]: 30 vehicles, random formations, five ways of assigning; and ours."""

import argparse
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from time import perf_counter
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.stats import binomtest
from scipy.stats import t as student
from threadpoolctl import threadpool_limits

from sato.formation import Assigning, FormationFlight, misaligned
from sato.formation.mission import as_printed
from sato.formation.trial import Trial, draw, fly_trial

SHAPE = 0.1  # error of a shape that has been taken up [m]


class Row(NamedTuple):
    """A configuration, and what the paper has for it."""

    name: str
    kind: str
    thin: bool
    ours: bool
    paper: str  # success, path [m], time [s], assignments


ROWS = (
    Row("none, non-complete", "none", True, False, "58 %, 28.2 ± 4.1, 131 ± 30"),
    Row("none, complete", "none", False, False, "66 %, 28.6 ± 3.6, 134 ± 25"),
    Row("CBAA, non-complete", "cbaa", True, False, "98 %, 10.9 ± 2.2, 65 ± 39, 11.6"),
    Row("CBAA, complete", "cbaa", False, False, "96 %, 9.9 ± 2.0, 68 ± 44, 11.6"),
    Row("Hungarian, complete", "hungarian", False, False, "100 %, 5.1 ± 1.0, 41 ± 54, 2.0"),
    Row("ours, complete", "vsdaa", False, True, ""),
    Row("ours, non-complete", "vsdaa", True, True, ""),
    Row("ours with CBAA, complete", "cbaa", False, True, ""),
)


def mission(row: Row, seed: int) -> tuple[FormationFlight, np.random.Generator]:
    """The flight of a trial: the same start and formations in every row with the same graph."""
    rng = np.random.default_rng(seed)
    start, shapes = draw(rng, thin=row.thin)
    if row.ours:
        frames = misaligned(len(start), spread=10.0, drift=0.01, noise=0.02, rng=rng)
        assigning = Assigning(row.kind)
        return FormationFlight(start, shapes, frames, assigning=assigning), rng
    return as_printed(start, shapes, row.kind), rng


def one(job: tuple[int, int]) -> tuple[int, Trial]:
    """Fly one trial of a row."""
    row, seed = job
    with threadpool_limits(1, user_api="blas"):
        return row, fly_trial(*mission(ROWS[row], seed))


def flown(rows: list[int], trials: int, cores: int) -> Iterator[tuple[int, Trial]]:
    """All trials, the longest first."""
    jobs = [(row, seed) for row in rows for seed in range(trials)]
    with ProcessPoolExecutor(cores, mp_context=get_context("spawn")) as pool:
        yield from track(pool.map(one, jobs, chunksize=2), "flying", len(jobs), console=ERR)


def interval(values: list[float]) -> str:
    """Mean, standard deviation, and 95 % interval of the mean."""
    x = np.array(values)
    if len(x) < 2:
        return "–"
    half = student.ppf(0.975, len(x) - 1) * x.std(ddof=1) / len(x) ** 0.5
    return f"{x.mean():.1f} ± {x.std(ddof=1):.1f} [{x.mean() - half:.1f}, {x.mean() + half:.1f}]"


def share(good: int, trials: int) -> str:
    """Share, with Wilson's 95 % interval."""
    low, high = binomtest(good, trials).proportion_ci(method="wilson")
    return f"{100 * good / trials:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def taken_up(row: Row, trial: Trial) -> bool:
    """Whether both shapes are there; in our rows not upside down, which printed ones may be."""
    return trial.error <= SHAPE and not (row.ours and trial.inverted)


def table(found: dict[int, list[Trial]]) -> Table:
    """All rows, the paper's beside ours."""
    shown = Table(title="Two formations a trial, 30 vehicles; mean ± deviation [95 % interval]")
    for name in ("", "settled", f"shape ≤ {SHAPE} m", "path [m]", "time [s]", "assignments"):
        shown.add_column(name)
    for name in ("least separation [m]", "worst shape [m]", "the paper"):
        shown.add_column(name)
    for number, trials in sorted(found.items()):
        good = [t for t in trials if t.settled]
        shown.add_row(
            ROWS[number].name,
            share(len(good), len(trials)),
            share(sum(taken_up(ROWS[number], t) for t in trials), len(trials)),
            interval([t.path for t in good]),
            interval([t.time for t in good]),
            interval([t.assignments for t in good]),
            f"{min(t.separation for t in trials):.2f}",
            f"{max((t.error for t in good), default=float('nan')):.3f}",
            ROWS[number].paper,
        )
    return shown


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--rows", choices=("printed", "ours", "all"), default="all")
    asked = parser.parse_args()
    wanted = {"printed": (False,), "ours": (True,), "all": (False, True)}[asked.rows]
    rows = [i for i, row in enumerate(ROWS) if row.ours in wanted]
    found: dict[int, list[Trial]] = {}
    began = perf_counter()
    for row, trial in flown(rows, asked.trials, asked.cores):
        found.setdefault(row, []).append(trial)
    Console(width=200).print(table(found))
    print(f"{perf_counter() - began:.0f} s")


ERR = Console(stderr=True)

if __name__ == "__main__":
    main()
