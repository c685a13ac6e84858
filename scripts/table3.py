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
from dataclasses import replace
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

from problems.alignment import align
from problems.formation_gain import Gains, design
from sato.formation import Assigning, FormationFlight, Frame, Frames, fly, misaligned
from sato.formation.mission import as_printed
from sato.formation.shape import likeness
from sato.formation.trial import HEIGHT, Trial, judged
from sato.plots.look import BLUE, DARK, GREY, PALE, RED, STYLE
from sato.shapes.formations import formation
from sato.shapes.random_formation import random_start

SHAPES = ("Pentagonal Pyramid", "Triangular Prism", "Slanted Plane")
TIMES = 2  # through all of them
PERIOD = 1.2  # between two auctions [s]
GRIDLOCKED = 0  # seed of a flight whose first pyramid is not reached without assignment
BODY = 0.25  # radius of the paper's hexarotors [m]
SHAPE = 0.1  # error of a shape that has been taken up [m]
ROWS_OF_THREE = np.array([[0, 0], [2, 0], [4, 0], [0, 2], [2, 2], [4, 2]], dtype=float)  # [m]
OFF = 0.1  # standard deviation of how far they start off these [m]
AREA, APART = (6.0, 6.0), 1.5  # where they start when scattered, and how far from each other [m]


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


def transitions(
    row: Row, seed: int, scattered: bool = False
) -> Iterator[tuple[FormationFlight, list[Frame]]]:
    """All of one flight, one after the other; the start is the same in every row."""
    rng = np.random.default_rng(seed)
    off = rng.normal(0, OFF, (6, 2))
    flat = random_start(6, AREA, APART, rng) if scattered else ROWS_OF_THREE + off
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


def one(job: tuple[int, int, bool]) -> tuple[int, list[Outcome]]:
    """All transitions of a row and a seed."""
    row, seed, scattered = job
    with threadpool_limits(1, user_api="blas"):
        return row, [outcome(*flown) for flown in transitions(ROWS[row], seed, scattered)]


def spread(values: list[float], digits: int = 1) -> str:
    """Mean and standard deviation."""
    if len(values) < 2:
        return "–"
    return f"{np.mean(values):.{digits}f} ± {np.std(values, ddof=1):.{digits}f}"


def share(good: int, trials: int) -> str:
    """Of all, in percent."""
    return f"{100 * good / trials:.0f} %"


def by_shape(outcomes: list[Outcome]) -> str:
    """How often each shape was settled in, in percent."""
    settled = np.array([o.trial.settled for o in outcomes]).reshape(-1, len(SHAPES))
    return " ".join(f"{100 * x:.0f}" for x in settled.mean(axis=0))


def table(found: dict[int, list[Outcome]], seeds: int) -> Table:
    """All rows, the paper's beside ours."""
    shown = Table(
        title=f"{seeds * TIMES * len(SHAPES)} transitions of 6 vehicles a row; "
        "path, time and shape of those that settled, mean ± deviation"
    )
    for name in ("", "settled", "each [%]", f"shape ≤ {SHAPE} m", "path [m]", "time [s]"):
        shown.add_column(name)
    for name in ("longest [s]", "shape [m]", "least separation [m]", "the paper"):
        shown.add_column(name)
    for number, outcomes in sorted(found.items()):
        good = [o for o in outcomes if o.trial.settled]
        shown.add_row(
            ROWS[number].name,
            share(len(good), len(outcomes)),
            by_shape(outcomes),
            share(sum(o.trial.settled and o.error <= SHAPE for o in outcomes), len(outcomes)),
            spread([o.trial.path for o in good]),
            spread([o.trial.time for o in good]),
            f"{max((o.trial.time for o in good), default=float('nan')):.0f}",
            spread([o.error for o in good], 2),
            f"{min(o.trial.separation for o in outcomes):.2f}",
            ROWS[number].paper,
        )
    return shown


def draw(flight: FormationFlight, seen: list[Frame], path: Path) -> None:
    """Traces from above, who is stuck, where each wants to go, and where its point lies."""
    last, points = seen[-1], flight.shapes[0].formation.points
    flown = np.array([frame.position[:, :2] for frame in seen])
    goal = align(points[last.point], last.position).place(points)[last.point, :2]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(4.4, 4.4), layout="constrained")
        ax = figure.subplots()
        for i, here in enumerate(last.position[:, :2]):
            colour = RED if last.avoiding[i] else BLUE
            ax.plot(*flown[:, i].T, color=colour, lw=0.9, alpha=0.6)
            ax.plot(*flown[0, i], "o", ms=3, mfc="white", mec=colour, mew=0.8)
            ax.plot(*np.array([here, goal[i]]).T, color=PALE, lw=0.8, ls=":", zorder=0)
            ax.plot(*goal[i], "+", color=GREY, ms=8, mew=1.0)
            ax.annotate(str(i), goal[i], (5, -10), textcoords="offset points", color=GREY)
            keep_out = flight.avoidance.keep_out / 2
            ax.add_patch(Circle(here, keep_out, fill=False, ec=colour, lw=0.6, ls="--"))
            ax.add_patch(Circle(here, BODY, fc=colour, ec="none", alpha=0.85))
            ax.annotate(str(i), here, ha="center", va="center", color="white", weight="bold")
            wish = last.velocity_command[i, :2]  # these frames are aligned with the world's
            ax.annotate("", here + wish, here, arrowprops={"arrowstyle": "->", "color": DARK})
        ax.set_aspect("equal")
        ax.margins(0.12)
        ax.set(xlabel="x [m]", ylabel="y [m]")
        ax.set_title(f"Pyramid without assignment, stuck after {last.time:.0f} s")
        figure.legend(handles=_key(), loc="outside lower center", ncols=3)
        figure.savefig(path)


def _key() -> list[Line2D]:
    return [
        Line2D([], [], ls="", marker="o", color=RED, ms=7, label="does nothing but avoid"),
        Line2D([], [], ls="", marker="o", mfc="white", mec=RED, ms=3, label="start"),
        Line2D([], [], ls="", marker="+", color=GREY, ms=8, label="its point"),
        Line2D([], [], color=DARK, label="wanted, 1 s"),
        Line2D([], [], color=RED, ls="--", lw=0.6, label="half the keep-out"),
    ]


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--cores", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--scattered", action="store_true", help="start anywhere")
    parser.add_argument("--figure", type=Path, metavar="FILE.png", help="draw the gridlock instead")
    asked = parser.parse_args()
    if asked.figure:
        draw(*next(transitions(ROWS[0], GRIDLOCKED)), asked.figure)
        return
    began = perf_counter()
    jobs = [(row, seed, asked.scattered) for row in range(len(ROWS)) for seed in range(asked.seeds)]
    found: dict[int, list[Outcome]] = {}
    with ProcessPoolExecutor(asked.cores, mp_context=get_context("spawn")) as pool:
        flown = track(pool.map(one, jobs), "flying", len(jobs), console=Console(stderr=True))
        for row, outcomes in flown:
            found.setdefault(row, []).extend(outcomes)
    Console(width=200).print(table(found, asked.seeds))
    print(f"{perf_counter() - began:.0f} s")


if __name__ == "__main__":
    main()
