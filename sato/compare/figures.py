"""Figures of a comparison: performance profile and work-precision diagram."""

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
from sato.compare.summary import tolerances_present
from sato.figures.style import STYLE, MarkerStyle, marker_style

CONE_LABELS: dict[ConeType, str] = {
    "linear": "linear",
    "second-order": "second-order cones",
    "semidefinite": "semidefinite",
}
ERROR_FLOOR = 1e-16  # least error that is drawn: rounding of a double
MAX_RATIO = 1e3  # largest multiple of the fastest time in a profile
LINE_STYLES = ("-", "--", ":", "-.")


def draw_comparison(measurements: Sequence[Measurement], folder: Path) -> None:
    """Draw both figures into a folder."""
    for name, figure_of in (("profile", performance_profile), ("accuracy", work_precision_diagram)):
        with matplotlib.rc_context(STYLE):
            figure = figure_of(measurements)
            FigureCanvasAgg(figure)
            figure.savefig(folder / f"{name}.png")


def performance_profile(measurements: Sequence[Measurement]) -> Figure:
    """Draw the share of problems that each solver solves within a multiple of the fastest time.

    Feasible problems with the same hardest cone share a panel, one row for each tolerance; an
    unsolved problem has an infinite time [Dolan2002]. Times are those of the second solve.
    """
    styles = _solver_styles(measurements)
    cones, tolerances = _hardest_cones(measurements), tolerances_present(measurements)
    figure, axes = _make_panels(len(tolerances), len(cones), len(styles))
    for row, tolerance in enumerate(tolerances):
        for column, cone in enumerate(cones):
            ax = axes[row][column]
            some = [m for m in _feasible_with_cone(measurements, cone) if m.tolerance == tolerance]
            for solver, ratios in performance_ratios(some).items():
                _draw_profile(ax, ratios, *styles[solver])
            ax.set(xscale="log", xlim=(1, MAX_RATIO), ylim=(-2, 102))
            ax.set_title(f"{CONE_LABELS[cone]}, {format_tolerance(tolerance)}", loc="left")
            if column == 0:
                ax.set_ylabel("solved [%]")
            if row == len(tolerances) - 1:
                ax.set_xlabel("time over that of the fastest, at most")
    _add_legend(figure, styles)
    return figure


def performance_ratios(measurements: Sequence[Measurement]) -> dict[str, list[float]]:
    """Return each solver's times over the fastest on each problem; ∞ where not correct."""
    fastest: dict[tuple[str, float], float] = {}
    for m in measurements:
        if m.is_correct:
            key = m.instance.name, m.tolerance
            fastest[key] = min(m.last.seconds, fastest.get(key, np.inf))
    ratios: dict[str, list[float]] = {}
    for m in measurements:
        ratio = m.last.seconds / fastest[m.instance.name, m.tolerance] if m.is_correct else np.inf
        ratios.setdefault(m.solver, []).append(ratio)
    return ratios


def work_precision_diagram(measurements: Sequence[Measurement]) -> Figure:
    """Draw each solver's time over the accuracy that it reaches, a marker for each tolerance.

    Both are medians over correct answers; a marker is hollow where some were not correct.
    """
    styles, cones = _solver_styles(measurements), _hardest_cones(measurements)
    figure, [axes] = _make_panels(1, len(cones), len(styles), height=3.2)
    for ax, cone in zip(axes, cones, strict=True):
        for solver, (marker, _) in styles.items():
            some = [m for m in _feasible_with_cone(measurements, cone) if m.solver == solver]
            _draw_work_precision(ax, some, marker)
        ax.set(xscale="log", yscale="log", xlabel="time of a solve [ms]")
        ax.set_title(CONE_LABELS[cone], loc="left")
    axes[0].set_ylabel("relative error of the cost")
    _add_legend(figure, styles)
    return figure


def _draw_work_precision(
    ax: Axes, measurements: Sequence[Measurement], marker: MarkerStyle
) -> None:
    points = []
    for tolerance in tolerances_present(measurements):
        here = [m for m in measurements if m.tolerance == tolerance]
        correct = [m for m in here if m.is_correct]
        if correct:
            time = 1e3 * median(m.last.seconds for m in correct)
            error = median(max(m.last.cost_error, ERROR_FLOOR) for m in correct)
            points.append((time, error))
            face = marker.color if len(correct) == len(here) else "white"
            ax.plot(time, error, marker.marker, color=marker.color, mfc=face, ms=4.5, mew=0.9)
    if points:
        ax.plot(*zip(*points, strict=True), color=marker.color, lw=0.6, zorder=1)


def _draw_profile(ax: Axes, ratios: Sequence[float], marker: MarkerStyle, line: str) -> None:
    reached = np.sort([ratio for ratio in ratios if np.isfinite(ratio)])
    x = np.array([1.0, *reached, MAX_RATIO])
    y = 100 * np.array([*range(len(reached) + 1), len(reached)]) / len(ratios)
    ax.step(x, y, where="post", color=marker.color, lw=1.0, ls=line,
            marker=marker.marker, ms=3.0, mew=0, markevery=(1, max(len(x) // 4, 1)))  # fmt: skip


def _feasible_with_cone(measurements: Iterable[Measurement], cone: ConeType) -> list[Measurement]:
    return [m for m in measurements if m.instance.is_feasible and _hardest_cone(m) == cone]


def _hardest_cone(m: Measurement) -> ConeType:
    return max(m.instance.problem.cone_types, key=list(CONE_LABELS).index)


def _hardest_cones(measurements: Iterable[Measurement]) -> list[ConeType]:
    present = {_hardest_cone(m) for m in measurements}
    return [cone for cone in CONE_LABELS if cone in present]


def _solver_styles(measurements: Iterable[Measurement]) -> dict[str, tuple[MarkerStyle, str]]:
    return {
        name: (marker_style(rank), LINE_STYLES[rank // 7 % 4])
        for rank, name in enumerate(dict.fromkeys(m.solver for m in measurements))
    }


def _make_panels(
    rows: int, columns: int, solvers: int, height: float = 1.9
) -> tuple[Figure, list[list[Axes]]]:
    width = 2.0 + 2.5 * columns
    legend = 0.3 + 0.2 * -(-solvers // _legend_columns(width))
    figure = Figure(figsize=(width, height * rows + legend), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    return figure, [list(row) for row in axes]


def _add_legend(figure: Figure, styles: dict[str, tuple[MarkerStyle, str]]) -> None:
    entries = [
        Line2D([], [], color=marker.color, marker=marker.marker, ms=4, lw=1.0, label=name, ls=line)
        for name, (marker, line) in styles.items()
    ]
    ncols = min(_legend_columns(figure.get_figwidth()), len(entries))
    figure.legend(handles=entries, loc="outside lower center", ncols=ncols)


def _legend_columns(width: float) -> int:
    return int(width / 1.3)  # entries in a row of the legend
