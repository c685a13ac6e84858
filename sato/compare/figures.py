"""Figures of a comparison: performance profile and work-precision diagram."""

from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sato.compare.measure import Measurement
from sato.compare.plan import format_tolerance
from sato.figures.axes import styled
from sato.figures.style import marker_style

CONES = ("linear", "second-order", "semidefinite")  # the hardest last
ERROR_FLOOR = 1e-16  # least error that is drawn: rounding of a double
MAX_RATIO = 1e3  # largest multiple of the fastest time in a profile
LEGEND_ENTRY = (1.3, 0.2)  # width and height [in]
LINE_STYLES = ("-", "--", ":", "-.")


def draw_comparison(measurements: Sequence[Measurement], profile: Path, accuracy: Path) -> None:
    """Draw both figures into files."""
    with styled():
        performance_profile(measurements).savefig(profile)
        work_precision_diagram(measurements).savefig(accuracy)


def performance_profile(measurements: Sequence[Measurement]) -> Figure:
    """Draw the share of problems that each solver solves within a multiple of the fastest time.

    Feasible problems with the same hardest cone share a panel, one row for each tolerance; an
    unsolved problem has an infinite time [Dolan2002]. Times are those of the second solve.
    """
    by_cone = _group_by_cone(measurements)
    tolerances = sorted({m.tolerance for m in measurements}, reverse=True)
    figure, axes, styles = _make_panels(measurements, len(tolerances), len(by_cone), 1.9)
    for row, tolerance in zip(axes, tolerances, strict=True):
        for ax, (cone, group) in zip(row, by_cone.items(), strict=True):
            ratios = performance_ratios([m for m in group if m.tolerance == tolerance])
            for solver, its in ratios.items():
                # What is beyond the axis is drawn just there, so that a line ends at the axis.
                ax.ecdf(np.minimum(its, 2 * MAX_RATIO), markevery=0.15, **styles[solver])
            ax.set(xscale="log", xlim=(1, MAX_RATIO), ylim=(-0.02, 1.02), ylabel="share solved")
            ax.set(xlabel="time over that of the fastest, at most")
            ax.set_title(f"{cone}, {format_tolerance(tolerance)}", loc="left")
            ax.label_outer()
    return figure


def performance_ratios(measurements: Sequence[Measurement]) -> dict[str, list[float]]:
    """Return each solver's times over the fastest on each problem; ∞ where not correct."""
    times: dict[str, dict[str, float]] = defaultdict(dict)  # by problem and solver
    for m in measurements:
        times[m.instance.name][m.solver] = m.outcomes[-1].seconds if m.is_correct else np.inf
    ratios: dict[str, list[float]] = defaultdict(list)
    for by_solver in times.values():
        fastest = min(by_solver.values())
        for solver, time in by_solver.items():
            ratios[solver].append(time / fastest if np.isfinite(time) else np.inf)
    return dict(ratios)


def work_precision_diagram(measurements: Sequence[Measurement]) -> Figure:
    """Draw each solver's time over the accuracy that it reaches, a marker for each tolerance.

    Both are medians over correct answers; a marker is hollow where some were not correct.
    """
    by_cone = _group_by_cone(measurements)
    figure, [axes], styles = _make_panels(measurements, 1, len(by_cone), 3.2)
    for ax, (cone, group) in zip(axes, by_cone.items(), strict=True):
        for solver, style in styles.items():
            points = []
            for tolerance in sorted({m.tolerance for m in group}, reverse=True):
                some = [m for m in group if (m.solver, m.tolerance) == (solver, tolerance)]
                correct = [m.outcomes[-1] for m in some if m.is_correct]
                if correct:
                    time = 1e3 * median(outcome.seconds for outcome in correct)
                    error = median(max(outcome.cost_error, ERROR_FLOOR) for outcome in correct)
                    points.append((time, error))
                    face = style["color"] if len(correct) == len(some) else "white"
                    ax.plot(time, error, **style | {"mfc": face, "ms": 4.5, "mew": 0.9})
            if points:
                ax.plot(*zip(*points, strict=True), color=style["color"], lw=0.6, zorder=1)
        ax.set(xscale="log", yscale="log", xlabel="time of a solve [ms]")
        ax.set_title(cone, loc="left")
    axes[0].set_ylabel("relative error of the cost")
    return figure


def _group_by_cone(measurements: Sequence[Measurement]) -> dict[str, list[Measurement]]:
    """Group the feasible problems by their hardest cone."""
    groups: dict[str, list[Measurement]] = {cone: [] for cone in CONES}
    for m in measurements:
        if m.instance.is_feasible:
            groups[max(m.instance.problem.cone_types, key=CONES.index)].append(m)
    return {cone: group for cone, group in groups.items() if group} or {CONES[0]: []}


def _make_panels(
    measurements: Sequence[Measurement], rows: int, columns: int, height: float
) -> tuple[Figure, list[list[Axes]], dict[str, dict[str, Any]]]:
    """Make a figure with equal axes, and the styles of the solvers with a legend below."""
    styles: dict[str, dict[str, Any]] = {}
    for rank, name in enumerate(dict.fromkeys(m.solver for m in measurements)):
        line = LINE_STYLES[rank // 7 % len(LINE_STYLES)]
        styles[name] = marker_style(rank) | {"ls": line, "lw": 1.0, "ms": 3.0}
    width = 2.0 + 2.5 * columns
    ncols = min(int(width / LEGEND_ENTRY[0]), len(styles))
    legend = LEGEND_ENTRY[1] * (1 + -(-len(styles) // ncols))
    figure = Figure(figsize=(width, height * rows + legend), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)
    handles = [Line2D([], [], label=name, **style) for name, style in styles.items()]
    figure.legend(handles=handles, loc="outside lower center", ncols=ncols)
    return figure, axes.tolist(), styles
