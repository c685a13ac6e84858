"""Two figures of a comparison: who is how often how fast, and what accuracy costs."""

from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import median

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from problems.conic import Cone
from sato.compare.measure import Measurement
from sato.compare.plan import power
from sato.plots.look import STYLE, Mark, mark

KINDS: dict[Cone, str] = {
    "linear": "linear",
    "second-order": "second-order cones",
    "semidefinite": "semidefinite",
}
FLOOR = 1e-16  # of an error, below which a double cannot say
FAR = 1e3  # times the fastest, up to which a profile is drawn
STROKES = ("-", "--", ":", "-.")


def draw(measurements: Sequence[Measurement], folder: Path) -> list[Path]:
    """Draw both figures into a folder."""
    paths = []
    for name, figure_of in (("profile", profile), ("accuracy", accuracy)):
        with matplotlib.rc_context(STYLE):
            figure = figure_of(measurements)
            FigureCanvasAgg(figure)
            figure.savefig(folder / f"{name}.png")
        paths.append(folder / f"{name}.png")
    return paths


def profile(measurements: Sequence[Measurement]) -> Figure:
    """The share of questions that each solver answers within a multiple of the fastest time.

    Of questions that have an answer, those with the same hardest cone together, one row a
    tolerance; what was not solved took for ever [Dolan2002]. Times are of the second solve.
    """
    looks = _looks(measurements)
    kinds, tolerances = _kinds(measurements), _tolerances(measurements)
    figure, axes = _panels(len(tolerances), len(kinds), len(looks))
    for row, tolerance in enumerate(tolerances):
        for column, kind in enumerate(kinds):
            ax = axes[row][column]
            some = [m for m in _solvable(measurements, kind) if m.tolerance == tolerance]
            for solver, ratios in slowness(some).items():
                _climb(ax, ratios, looks[solver], STROKES[list(looks).index(solver) // 7 % 4])
            ax.set(xscale="log", xlim=(1, FAR), ylim=(-2, 102))
            ax.set_title(f"{KINDS[kind]}, {power(tolerance)}", loc="left")
            if column == 0:
                ax.set_ylabel("solved [%]")
            if row == len(tolerances) - 1:
                ax.set_xlabel("time over that of the fastest, at most")
    _key(figure, looks)
    return figure


def slowness(some: Iterable[Measurement]) -> dict[str, list[float]]:
    """For each solver, its times over those of the fastest at each question; ∞ where unsolved."""
    fastest: dict[tuple[str, float], float] = {}
    asked = list(some)
    for m in asked:
        if m.right:
            key = m.instance.name, m.tolerance
            fastest[key] = min(m.last.seconds, fastest.get(key, np.inf))
    found: dict[str, list[float]] = {}
    for m in asked:
        ratio = m.last.seconds / fastest[m.instance.name, m.tolerance] if m.right else np.inf
        found.setdefault(m.solver, []).append(ratio)
    return found


def accuracy(measurements: Sequence[Measurement]) -> Figure:
    """What each solver takes for the accuracy it reaches, a mark for each tolerance.

    Medians over what it solved; a mark is hollow where it did not solve all.
    """
    looks, kinds = _looks(measurements), _kinds(measurements)
    figure, [axes] = _panels(1, len(kinds), len(looks), height=3.2)
    for ax, kind in zip(axes, kinds, strict=True):
        for solver, look in looks.items():
            mine = [m for m in _solvable(measurements, kind) if m.solver == solver]
            _trail(ax, mine, look)
        ax.set(xscale="log", yscale="log", xlabel="time of a solve [ms]")
        ax.set_title(KINDS[kind], loc="left")
    axes[0].set_ylabel("relative error of the cost")
    _key(figure, looks)
    return figure


def _trail(ax: Axes, mine: Sequence[Measurement], look: Mark) -> None:
    trail = []
    for tolerance in _tolerances(mine):
        here = [m for m in mine if m.tolerance == tolerance]
        solved = [m for m in here if m.right]
        if solved:
            time = 1e3 * median(m.last.seconds for m in solved)
            error = median(max(m.last.cost_error, FLOOR) for m in solved)
            trail.append((time, error))
            full = look.colour if len(solved) == len(here) else "white"
            ax.plot(time, error, look.shape, color=look.colour, mfc=full, ms=4.5, mew=0.9)
    if trail:
        ax.plot(*zip(*trail, strict=True), color=look.colour, lw=0.6, zorder=1)


def _climb(ax: Axes, ratios: Sequence[float], look: Mark, stroke: str) -> None:
    reached = np.sort([ratio for ratio in ratios if np.isfinite(ratio)])
    x = np.array([1.0, *reached, FAR])
    y = 100 * np.array([*range(len(reached) + 1), len(reached)]) / len(ratios)
    ax.step(x, y, where="post", color=look.colour, lw=1.0, ls=stroke,
            marker=look.shape, ms=3.0, mew=0, markevery=(1, max(len(x) // 4, 1)))  # fmt: skip


def _solvable(measurements: Iterable[Measurement], kind: Cone) -> list[Measurement]:
    return [m for m in measurements if m.instance.feasible and _kind(m) == kind]


def _kind(m: Measurement) -> Cone:
    return max(m.instance.problem.kinds, key=list(KINDS).index)


def _kinds(measurements: Iterable[Measurement]) -> list[Cone]:
    there = {_kind(m) for m in measurements}
    return [kind for kind in KINDS if kind in there]


def _tolerances(measurements: Iterable[Measurement]) -> list[float]:
    return sorted({m.tolerance for m in measurements}, reverse=True)


def _looks(measurements: Iterable[Measurement]) -> dict[str, Mark]:
    return {
        name: mark(rank) for rank, name in enumerate(dict.fromkeys(m.solver for m in measurements))
    }


def _panels(
    rows: int, columns: int, solvers: int, height: float = 1.9
) -> tuple[Figure, list[list[Axes]]]:
    width = 2.0 + 2.5 * columns
    key = 0.3 + 0.2 * -(-solvers // _beside(width))
    figure = Figure(figsize=(width, height * rows + key), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    return figure, [list(row) for row in axes]


def _key(figure: Figure, looks: dict[str, Mark]) -> None:
    entries = [
        Line2D([], [], color=look.colour, marker=look.shape, ms=4, lw=1.0, label=name,
               ls=STROKES[rank // 7 % 4])
        for rank, (name, look) in enumerate(looks.items())
    ]  # fmt: skip
    ncols = min(_beside(figure.get_figwidth()), len(entries))
    figure.legend(handles=entries, loc="outside lower center", ncols=ncols)


def _beside(width: float) -> int:
    return int(width / 1.3)  # names of solvers in a row of the key
