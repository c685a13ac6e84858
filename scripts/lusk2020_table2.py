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

from sato.formation import AssignmentSettings, Formation, draw_frames
from sato.formation.mission import legacy_formation
from sato.formation.trial import FormationTrial, draw_trial, run_trial

SHAPE_TOLERANCE = 0.1  # error of a shape that has been taken up [m]


class Table2Row(NamedTuple):
    """A configuration, and what the paper has for it."""

    name: str
    assignment_method: str
    is_sparse: bool
    ours: bool
    paper: str  # success, path [m], time [s], assignments


ROWS = (
    Table2Row("none, non-complete", "none", True, False, "58 %, 28.2 ± 4.1, 131 ± 30"),
    Table2Row("none, complete", "none", False, False, "66 %, 28.6 ± 3.6, 134 ± 25"),
    Table2Row("CBAA, non-complete", "cbaa", True, False, "98 %, 10.9 ± 2.2, 65 ± 39, 11.6"),
    Table2Row("CBAA, complete", "cbaa", False, False, "96 %, 9.9 ± 2.0, 68 ± 44, 11.6"),
    Table2Row("Hungarian, complete", "hungarian", False, False, "100 %, 5.1 ± 1.0, 41 ± 54, 2.0"),
    Table2Row("ours, complete", "vsdaa", False, True, ""),
    Table2Row("ours, non-complete", "vsdaa", True, True, ""),
    Table2Row("ours with CBAA, complete", "cbaa", False, True, ""),
)


def build_mission(row: Table2Row, seed: int) -> tuple[Formation, np.random.Generator]:
    """The flight of a trial: the same start and formations in every row with the same graph."""
    rng = np.random.default_rng(seed)
    start, shapes = draw_trial(rng, remove_edges=row.is_sparse)
    if row.solve:
        frames = draw_frames(len(start), origin_range=10.0, drift=0.01, noise=0.02, rng=rng)
        assigning = AssignmentSettings(row.assignment_method)
        return Formation(start, shapes, frames, assignment=assigning), rng
    return legacy_formation(start, shapes, row.assignment_method), rng


def run_trial(job: tuple[int, int]) -> tuple[int, FormationTrial]:
    """Fly one trial of a row."""
    row, seed = job
    with threadpool_limits(1, user_api="blas"):
        return row, run_trial(*build_mission(ROWS[row], seed))


def run_trials(rows: list[int], trials: int, cores: int) -> Iterator[tuple[int, FormationTrial]]:
    """All trials, the longest first."""
    jobs = [(row, seed) for row in rows for seed in range(trials)]
    with ProcessPoolExecutor(cores, mp_context=get_context("spawn")) as pool:
        yield from track(
            pool.map(run_trial, jobs, chunksize=2), "flying", len(jobs), console=STDERR_CONSOLE
        )


def format_mean_interval(values: list[float]) -> str:
    """Mean, standard deviation, and 95 % interval of the mean."""
    x = np.array(values)
    if len(x) < 2:
        return "–"
    half = student.ppf(0.975, len(x) - 1) * x.std(ddof=1) / len(x) ** 0.5
    return f"{x.mean():.1f} ± {x.std(ddof=1):.1f} [{x.mean() - half:.1f}, {x.mean() + half:.1f}]"


def format_share(good: int, trials: int) -> str:
    """Share, with Wilson's 95 % interval."""
    low, high = binomtest(good, trials).proportion_ci(method="wilson")
    return f"{100 * good / trials:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def is_shape_reached(row: Table2Row, trial: FormationTrial) -> bool:
    """Whether both shapes are there; in our rows not upside down, which printed ones may be."""
    return trial.shape_error <= SHAPE_TOLERANCE and not (row.solve and trial.inverted)


def make_table(found: dict[int, list[FormationTrial]]) -> Table:
    """All rows, the paper's beside ours."""
    shown = Table(title="Two formations a trial, 30 vehicles; mean ± deviation [95 % interval]")
    for name in (
        "",
        "settled",
        f"shape ≤ {SHAPE_TOLERANCE} m",
        "path [m]",
        "time [s]",
        "assignments",
    ):
        shown.add_column(name)
    for name in ("least separation [m]", "worst shape [m]", "the paper"):
        shown.add_column(name)
    for number, trials in sorted(found.items()):
        good = [t for t in trials if t.completed]
        shown.add_row(
            ROWS[number].name,
            format_share(len(good), len(trials)),
            format_share(sum(is_shape_reached(ROWS[number], t) for t in trials), len(trials)),
            format_mean_interval([t.path_length for t in good]),
            format_mean_interval([t.time for t in good]),
            format_mean_interval([t.assignments for t in good]),
            f"{min(t.min_separation for t in trials):.2f}",
            f"{max((t.shape_error for t in good), default=float('nan')):.3f}",
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
    rows = [i for i, row in enumerate(ROWS) if row.solve in wanted]
    found: dict[int, list[FormationTrial]] = {}
    began = perf_counter()
    for row, trial in run_trials(rows, asked.trials, asked.cores):
        found.setdefault(row, []).append(trial)
    Console(width=200).print(make_table(found))
    print(f"{perf_counter() - began:.0f} s")


STDERR_CONSOLE = Console(stderr=True)

if __name__ == "__main__":
    main()
