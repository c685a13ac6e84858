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

from problems.conic import ConeType
from sato.compare.measure import Measurement
from sato.compare.plan import format_tolerance
from sato.figures.style import STYLE, MarkerStyle, marker_style

CONE_LABELS: dict[ConeType, str] = {
    "linear": "linear",
    "second-order": "second-order cones",
    "semidefinite": "semidefinite",
}
ERROR_FLOOR = 1e-16  # of an error, below which a double cannot say
MAX_RATIO = 1e3  # times the fastest, up to which a profile is drawn
LINE_STYLES = ("-", "--", ":", "-.")


def draw_comparison(measurements: Sequence[Measurement], folder: Path) -> list[Path]:
    """Draw both figures into a folder."""
    paths = []
    for name, figure_of in (("profile", performance_profile), ("accuracy", work_precision_diagram)):
        with matplotlib.rc_context(STYLE):
            figure = figure_of(measurements)
            FigureCanvasAgg(figure)
            figure.savefig(folder / f"{name}.png")
        paths.append(folder / f"{name}.png")
    return paths


def performance_profile(measurements: Sequence[Measurement]) -> Figure:
    """The share of questions that each solver answers within a multiple of the fastest time.

    Of questions that have an answer, those with the same hardest cone together, one row a
    tolerance; what was not solved took for ever [Dolan2002]. Times are of the second solve.
    """
    looks = _solver_markers(measurements)
    kinds, tolerances = _hardest_cones(measurements), _tolerances(measurements)
    figure, axes = _make_panels(len(tolerances), len(kinds), len(looks))
    for row, tolerance in enumerate(tolerances):
        for column, kind in enumerate(kinds):
            ax = axes[row][column]
            some = [m for m in _feasible_with_cone(measurements, kind) if m.tolerance == tolerance]
            for solver, ratios in performance_ratios(some).items():
                _draw_profile(
                    ax, ratios, looks[solver], LINE_STYLES[list(looks).index(solver) // 7 % 4]
                )
            ax.set(xscale="log", xlim=(1, MAX_RATIO), ylim=(-2, 102))
            ax.set_title(f"{CONE_LABELS[kind]}, {format_tolerance(tolerance)}", loc="left")
            if column == 0:
                ax.set_ylabel("solved [%]")
            if row == len(tolerances) - 1:
                ax.set_xlabel("time over that of the fastest, at most")
    _add_legend(figure, looks)
    return figure


def performance_ratios(some: Iterable[Measurement]) -> dict[str, list[float]]:
    """For each solver, its times over those of the fastest at each question; ∞ where unsolved."""
    fastest: dict[tuple[str, float], float] = {}
    asked = list(some)
    for m in asked:
        if m.is_correct:
            key = m.instance.name, m.tolerance
            fastest[key] = min(m.last.seconds, fastest.get(key, np.inf))
    found: dict[str, list[float]] = {}
    for m in asked:
        ratio = m.last.seconds / fastest[m.instance.name, m.tolerance] if m.is_correct else np.inf
        found.setdefault(m.solver, []).append(ratio)
    return found


def work_precision_diagram(measurements: Sequence[Measurement]) -> Figure:
    """What each solver takes for the accuracy it reaches, a mark for each tolerance.

    Medians over what it solved; a mark is hollow where it did not solve all.
    """
    looks, kinds = _solver_markers(measurements), _hardest_cones(measurements)
    figure, [axes] = _make_panels(1, len(kinds), len(looks), height=3.2)
    for ax, kind in zip(axes, kinds, strict=True):
        for solver, look in looks.items():
            mine = [m for m in _feasible_with_cone(measurements, kind) if m.solver == solver]
            _draw_work_precision(ax, mine, look)
        ax.set(xscale="log", yscale="log", xlabel="time of a solve [ms]")
        ax.set_title(CONE_LABELS[kind], loc="left")
    axes[0].set_ylabel("relative error of the cost")
    _add_legend(figure, looks)
    return figure


def _draw_work_precision(ax: Axes, mine: Sequence[Measurement], look: MarkerStyle) -> None:
    trail = []
    for tolerance in _tolerances(mine):
        here = [m for m in mine if m.tolerance == tolerance]
        solved = [m for m in here if m.is_correct]
        if solved:
            time = 1e3 * median(m.last.seconds for m in solved)
            error = median(max(m.last.cost_error, ERROR_FLOOR) for m in solved)
            trail.append((time, error))
            full = look.color if len(solved) == len(here) else "white"
            ax.plot(time, error, look.marker, color=look.color, mfc=full, ms=4.5, mew=0.9)
    if trail:
        ax.plot(*zip(*trail, strict=True), color=look.color, lw=0.6, zorder=1)


def _draw_profile(ax: Axes, ratios: Sequence[float], look: MarkerStyle, stroke: str) -> None:
    reached = np.sort([ratio for ratio in ratios if np.isfinite(ratio)])
    x = np.array([1.0, *reached, MAX_RATIO])
    y = 100 * np.array([*range(len(reached) + 1), len(reached)]) / len(ratios)
    ax.step(x, y, where="post", color=look.color, lw=1.0, ls=stroke,
            marker=look.marker, ms=3.0, mew=0, markevery=(1, max(len(x) // 4, 1)))  # fmt: skip


def _feasible_with_cone(measurements: Iterable[Measurement], kind: ConeType) -> list[Measurement]:
    return [m for m in measurements if m.instance.is_feasible and _hardest_cone(m) == kind]


def _hardest_cone(m: Measurement) -> ConeType:
    return max(m.instance.problem.cone_types, key=list(CONE_LABELS).index)


def _hardest_cones(measurements: Iterable[Measurement]) -> list[ConeType]:
    there = {_hardest_cone(m) for m in measurements}
    return [kind for kind in CONE_LABELS if kind in there]


def _tolerances(measurements: Iterable[Measurement]) -> list[float]:
    return sorted({m.tolerance for m in measurements}, reverse=True)


def _solver_markers(measurements: Iterable[Measurement]) -> dict[str, MarkerStyle]:
    return {
        name: marker_style(rank)
        for rank, name in enumerate(dict.fromkeys(m.solver for m in measurements))
    }


def _make_panels(
    rows: int, columns: int, solvers: int, height: float = 1.9
) -> tuple[Figure, list[list[Axes]]]:
    width = 2.0 + 2.5 * columns
    key = 0.3 + 0.2 * -(-solvers // _legend_columns(width))
    figure = Figure(figsize=(width, height * rows + key), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    return figure, [list(row) for row in axes]


def _add_legend(figure: Figure, looks: dict[str, MarkerStyle]) -> None:
    entries = [
        Line2D([], [], color=look.color, marker=look.marker, ms=4, lw=1.0, label=name,
               ls=LINE_STYLES[rank // 7 % 4])
        for rank, (name, look) in enumerate(looks.items())
    ]  # fmt: skip
    ncols = min(_legend_columns(figure.get_figwidth()), len(entries))
    figure.legend(handles=entries, loc="outside lower center", ncols=ncols)


def _legend_columns(width: float) -> int:
    return int(width / 1.3)  # names of solvers in a row of the key
