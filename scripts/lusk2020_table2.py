"""Table II of [Lusk2020]: 30 vehicles, random formations, five ways of assigning; and ours."""

import argparse
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.stats import binomtest
from scipy.stats import t as student
from threadpoolctl import threadpool_limits

from sato.formation.check.recorded import FormationRecord, summarize_flight
from sato.formation.leg import FormationLeg
from sato.formation.loop import simulate
from sato.formation.mission import Formation, legacy_formation
from sato.formation.settings import AssignmentSettings
from sato.shapes.formation_library import random_dense_graph
from sato.shapes.random_points import sample_formation, sample_positions

AGENTS, HEIGHT = 30, 1.0  # number, and initial height [m]
SHAPE_TOLERANCE = 0.1  # error of a shape that has been taken up [m]


class Table2Row(NamedTuple):
    """Configuration with the paper's results."""

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
    """Draw the flight of a trial: the same start and formations in every row of one graph.

    As in [Lusk2020, Sec. V-A], two formations are drawn for one graph, which is complete, or
    lacks 1 to n − 4 random edges.
    """
    rng = np.random.default_rng(seed)
    flat = sample_positions(AGENTS, (20.0, 20.0), 1.5, rng)
    start = np.column_stack([flat, np.full(AGENTS, HEIGHT)])
    points = [sample_formation(AGENTS, (15.0, 15.0, 2.0), 2.0, rng) for _ in range(2)]
    removals = int(rng.integers(1, AGENTS - 3)) if row.is_sparse else 0
    graph = random_dense_graph(AGENTS, removals, rng) if removals else ~np.eye(AGENTS, dtype=bool)
    legs = [FormationLeg(p, graph, gains="projection") for p in points]
    settings = AssignmentSettings(row.assignment_method)
    build = Formation if row.ours else legacy_formation
    return build(start=start, legs=legs, assignment=settings).draw(rng), rng


def run_trial(job: tuple[int, int]) -> tuple[int, dict[str, Any]]:
    """Fly one trial of a row, and summarize it."""
    row, seed = job
    with threadpool_limits(1, user_api="blas"):
        mission, rng = build_mission(ROWS[row], seed)
        record = FormationRecord.from_frames(list(simulate(mission, rng)), mission)
        ends = [leg.completed for leg in record.replay.legs]
        converged = len(ends) == len(mission.legs) and all(ends)
        return row, summarize_flight(record) | {"converged": converged}


def run_trials(rows: list[int], trials: int, cores: int) -> Iterator[tuple[int, dict[str, Any]]]:
    """Run all trials, the longest first."""
    jobs = [(row, seed) for row in rows for seed in range(trials)]
    with ProcessPoolExecutor(cores, mp_context=get_context("spawn")) as pool:
        yield from track(
            pool.map(run_trial, jobs, chunksize=2), "flying", len(jobs), console=STDERR_CONSOLE
        )


def format_mean_interval(values: list[float]) -> str:
    """Format the mean, the standard deviation, and the 95 % interval of the mean."""
    x = np.array(values)
    if len(x) < 2:
        return "–"
    half = student.ppf(0.975, len(x) - 1) * x.std(ddof=1) / len(x) ** 0.5
    return f"{x.mean():.1f} ± {x.std(ddof=1):.1f} [{x.mean() - half:.1f}, {x.mean() + half:.1f}]"


def format_share(good: int, trials: int) -> str:
    """Format a share with Wilson's 95 % interval."""
    low, high = binomtest(good, trials).proportion_ci(method="wilson")
    return f"{100 * good / trials:.0f} % [{100 * low:.0f}, {100 * high:.0f}]"


def is_shape_reached(row: Table2Row, trial: dict[str, Any]) -> bool:
    """Tell whether both formations are reached, in our rows upright."""
    inverted = any(leg.get("inverted", False) for leg in trial["legs"])
    is_close = trial["converged"] and trial["shape_error_m"] <= SHAPE_TOLERANCE
    return is_close and not (row.ours and inverted)


def make_table(found: dict[int, list[dict[str, Any]]]) -> Table:
    """Tabulate all rows, the paper's beside ours."""
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
        good = [t for t in trials if t["converged"]]
        shown.add_row(
            ROWS[number].name,
            format_share(len(good), len(trials)),
            format_share(sum(is_shape_reached(ROWS[number], t) for t in trials), len(trials)),
            format_mean_interval([t["path_m"] for t in good]),
            format_mean_interval([t["time_s"] for t in good]),
            format_mean_interval([t["reassignments"] for t in good]),
            f"{min(t['min_separation_m'] for t in trials):.2f}",
            f"{max((t['shape_error_m'] for t in good), default=float('nan')):.3f}",
            ROWS[number].paper,
        )
    return shown


def main() -> None:
    """Run the trials and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--trials", type=int, default=100)
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--rows", choices=("printed", "ours", "all"), default="all")
    asked = parser.parse_args()
    wanted = {"printed": (False,), "ours": (True,), "all": (False, True)}[asked.rows]
    rows = [i for i, row in enumerate(ROWS) if row.ours in wanted]
    found: dict[int, list[dict[str, Any]]] = {}
    began = perf_counter()
    for row, trial in run_trials(rows, asked.trials, asked.cores):
        found.setdefault(row, []).append(trial)
    Console(width=200).print(make_table(found))
    print(f"{perf_counter() - began:.0f} s")


STDERR_CONSOLE = Console(stderr=True)

if __name__ == "__main__":
    main()
