"""Table III of [Lusk2020]: six vehicles go twice through a pyramid, a prism and a slanted plane.

They start in two rows of three, in the order of their numbers, a little off; or anywhere, with
--scattered. A trial is one transition, from where the last one left the vehicles, also if it
failed. The paper's are hardware flights, and a human said when a formation was taken up; here
the protocol says so, and the error of the shape is printed beside. With --figure FILE.png the
first transition without assignment is drawn, which ends in a gridlock as in the paper's Fig. 7.
"""

import argparse
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle
from numpy import ndarray as Array
from rich.console import Console
from rich.progress import track
from rich.table import Table
from threadpoolctl import threadpool_limits

from problems.alignment import align, compute_shape_error
from sato.figures.style import BLUE, DARK_GRAY, GRAY, LIGHT_GRAY, RED, STYLE
from sato.formation.check.recorded import FormationRecord, summarize_flight
from sato.formation.leg import FormationLeg
from sato.formation.loop import FormationFrame, simulate
from sato.formation.mission import Formation, legacy_formation
from sato.formation.settings import AssignmentSettings, FrameSettings
from sato.shapes.random_points import sample_positions

HEIGHT = 1.0  # initial height [m]
SHAPES = ("Pentagonal Pyramid", "Triangular Prism", "Slanted Plane")
REPETITIONS = 2  # through all of them
AUCTION_PERIOD = 1.2  # between two auctions [s]
GRIDLOCK_SEED = 0  # seed of a flight whose first pyramid is not reached without assignment
BODY_RADIUS = 0.25  # radius of the paper's hexarotors [m]
SHAPE_TOLERANCE = 0.1  # error of a shape that has been taken up [m]
ROWS_OF_THREE = np.array([[0, 0], [2, 0], [4, 0], [0, 2], [2, 2], [4, 2]], dtype=float)  # [m]
START_NOISE = 0.1  # standard deviation of how far they start off these [m]
AREA, APART = (6.0, 6.0), 1.5  # where they start when scattered, and how far from each other [m]


class Table3Row(NamedTuple):
    """Configuration with the paper's results."""

    name: str
    assignment_method: str
    graph: str
    ours: bool
    paper: str  # path [m], time [s], success


ROWS = (
    Table3Row("none, non-complete", "none", "own", False, "0.8 ± 0.5, 15.5 ± 9.2, 50 %"),
    Table3Row("none, complete", "none", "complete", False, "0.9 ± 1.0, 11.3 ± 3.0, 67 %"),
    Table3Row("CBAA, non-complete", "cbaa", "own", False, "1.4 ± 0.8, 14.3 ± 8.7, 100 %"),
    Table3Row("CBAA, complete", "cbaa", "complete", False, "0.8 ± 0.6, 10.1 ± 4.8, 100 %"),
    Table3Row("ours, none, non-complete", "none", "own", True, ""),
    Table3Row("ours, none, complete", "none", "complete", True, ""),
    Table3Row("ours, CBAA, non-complete", "cbaa", "own", True, ""),
    Table3Row("ours, CBAA, complete", "cbaa", "complete", True, ""),
    Table3Row("ours, non-complete", "vsdaa", "own", True, ""),
    Table3Row("ours, complete", "vsdaa", "complete", True, ""),
)


class TransitionResult(NamedTuple):
    """Outcome of one transition."""

    converged: bool
    path_length: float  # in the plane, mean of the vehicles [m]
    time: float  # [s]
    min_separation: float  # in the plane [m]
    error: float  # shape error at the end, also where the formation was given up [m]


@cache
def draw_leg(shape: str, graph: str) -> FormationLeg:
    """Return the leg to a shape on its own graph or the complete one, with its gains."""
    leg = FormationLeg(shape, graph)
    return leg.draw(6, 0.0, np.random.default_rng(0))


def build_mission(row: Table3Row, shape: str, start: Array, frames: FrameSettings) -> Formation:
    """Build the mission of one transition."""
    legs = [draw_leg(shape, row.graph)]
    settings = AssignmentSettings(row.assignment_method, period=AUCTION_PERIOD)
    if row.ours:
        return Formation(start=start, legs=legs, frames=frames, assignment=settings)
    return legacy_formation(start, legs, assignment=settings)


def run_transitions(
    row: Table3Row, seed: int, scattered: bool = False
) -> Iterator[tuple[Formation, list[FormationFrame]]]:
    """Simulate all transitions of a flight; the start is the same in every row."""
    rng = np.random.default_rng(seed)
    off = rng.normal(0, START_NOISE, (6, 2))
    flat = sample_positions(6, AREA, APART, rng) if scattered else ROWS_OF_THREE + off
    frames = FrameSettings().draw(6, rng)
    start = np.column_stack([flat, np.full(6, HEIGHT)])
    for shape in SHAPES * REPETITIONS:
        flight = build_mission(row, shape, start, frames).draw(np.random.default_rng(seed))
        seen = list(simulate(flight, rng))
        yield flight, seen
        start = seen[-1].position


def evaluate_transition(flight: Formation, seen: list[FormationFrame]) -> TransitionResult:
    """Evaluate one transition."""
    last, points = seen[-1], flight.gains[0].formation.points
    error = compute_shape_error(last.position[np.argsort(last.point_index)], points).error
    record = FormationRecord.from_frames(seen, flight)
    found, [leg] = summarize_flight(record), record.replay.legs
    return TransitionResult(
        leg.completed, found["path_m"], found["time_s"], found["min_separation_m"], error
    )


def run_seed(job: tuple[int, int, bool]) -> tuple[int, list[TransitionResult]]:
    """Run all transitions of a row and a seed."""
    row, seed, scattered = job
    with threadpool_limits(1, user_api="blas"):
        return row, [
            evaluate_transition(*flown) for flown in run_transitions(ROWS[row], seed, scattered)
        ]


def format_mean_deviation(values: list[float], digits: int = 1) -> str:
    """Format the mean and the standard deviation."""
    if len(values) < 2:
        return "–"
    return f"{np.mean(values):.{digits}f} ± {np.std(values, ddof=1):.{digits}f}"


def format_share(good: int, trials: int) -> str:
    """Format a share in percent."""
    return f"{100 * good / trials:.0f} %"


def success_by_shape(outcomes: list[TransitionResult]) -> str:
    """Format the success rate of each shape, in percent."""
    settled = np.array([o.converged for o in outcomes]).reshape(-1, len(SHAPES))
    return " ".join(f"{100 * x:.0f}" for x in settled.mean(axis=0))


def make_table(found: dict[int, list[TransitionResult]], seeds: int) -> Table:
    """Tabulate all rows, the paper's beside ours."""
    shown = Table(
        title=f"{seeds * REPETITIONS * len(SHAPES)} transitions of 6 vehicles a row; "
        "path, time and shape of those that settled, mean ± deviation"
    )
    for name in ("", "settled", "each [%]", f"shape ≤ {SHAPE_TOLERANCE} m", "path [m]", "time [s]"):
        shown.add_column(name)
    for name in ("longest [s]", "shape [m]", "least separation [m]", "the paper"):
        shown.add_column(name)
    for number, outcomes in sorted(found.items()):
        good = [o for o in outcomes if o.converged]
        shown.add_row(
            ROWS[number].name,
            format_share(len(good), len(outcomes)),
            success_by_shape(outcomes),
            format_share(
                sum(o.converged and o.error <= SHAPE_TOLERANCE for o in outcomes),
                len(outcomes),
            ),
            format_mean_deviation([o.path_length for o in good]),
            format_mean_deviation([o.time for o in good]),
            f"{max((o.time for o in good), default=float('nan')):.0f}",
            format_mean_deviation([o.error for o in good], 2),
            f"{min(o.min_separation for o in outcomes):.2f}",
            ROWS[number].paper,
        )
    return shown


def draw_gridlock(flight: Formation, seen: list[FormationFrame], path: Path) -> None:
    """Plot paths from above, agents in gridlock, commands and points."""
    last, points = seen[-1], flight.gains[0].formation.points
    flown = np.array([frame.position[:, :2] for frame in seen])
    goal = align(points[last.point_index], last.position).transform(points)[last.point_index, :2]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.4, 4.4), layout="constrained")
        ax = figure.subplots()
        for i, here in enumerate(last.position[:, :2]):
            color = RED if last.avoiding[i] else BLUE
            ax.plot(*flown[:, i].T, color=color, lw=0.9, alpha=0.6)
            ax.plot(*flown[0, i], "o", ms=3, mfc="white", mec=color, mew=0.8)
            ax.plot(*np.array([here, goal[i]]).T, color=LIGHT_GRAY, lw=0.8, ls=":", zorder=0)
            ax.plot(*goal[i], "+", color=GRAY, ms=8, mew=1.0)
            ax.annotate(str(i), goal[i], (5, -10), textcoords="offset points", color=GRAY)
            keep_out = flight.keep_out / 2
            ax.add_patch(Circle(here, keep_out, fill=False, ec=color, lw=0.6, ls="--"))
            ax.add_patch(Circle(here, BODY_RADIUS, fc=color, ec="none", alpha=0.85))
            ax.annotate(str(i), here, ha="center", va="center", color="white", weight="bold")
            wish = last.velocity_command[i, :2]  # these frames are aligned with the world's
            ax.annotate("", here + wish, here, arrowprops={"arrowstyle": "->", "color": DARK_GRAY})
        ax.set_aspect("equal")
        ax.margins(0.12)
        ax.set(xlabel="x [m]", ylabel="y [m]")
        ax.set_title(f"Pyramid without assignment, stuck after {last.time:.0f} s")
        figure.legend(handles=_legend_handles(), loc="outside lower center", ncols=3)
        figure.savefig(path)


def _legend_handles() -> list[Line2D]:
    return [
        Line2D([], [], ls="", marker="o", color=RED, ms=7, label="does nothing but avoid"),
        Line2D([], [], ls="", marker="o", mfc="white", mec=RED, ms=3, label="start"),
        Line2D([], [], ls="", marker="+", color=GRAY, ms=8, label="its point"),
        Line2D([], [], color=DARK_GRAY, label="wanted, 1 s"),
        Line2D([], [], color=RED, ls="--", lw=0.6, label="half the keep-out"),
    ]


def main() -> None:
    """Run the transitions, and print the table or draw the figure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--scattered", action="store_true", help="start anywhere")
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="draw the gridlock instead")
    asked = parser.parse_args()
    if asked.figure:
        draw_gridlock(*next(run_transitions(ROWS[0], GRIDLOCK_SEED)), asked.figure)
        return
    began = perf_counter()
    jobs = [(row, seed, asked.scattered) for row in range(len(ROWS)) for seed in range(asked.seeds)]
    found: dict[int, list[TransitionResult]] = {}
    with ProcessPoolExecutor(asked.cores, mp_context=get_context("spawn")) as pool:
        flown = track(pool.map(run_seed, jobs), "flying", len(jobs), console=Console(stderr=True))
        for row, outcomes in flown:
            found.setdefault(row, []).extend(outcomes)
    Console(width=200).print(make_table(found, asked.seeds))
    print(f"{perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
