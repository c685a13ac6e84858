"""Panels over time: intervals, legs, limits and spreads of quantities; marks of broken promises."""

from collections.abc import Iterable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Shaped
from matplotlib.figure import Figure
from numpy import ndarray as Array

from sato.figures.style import BLUE, DARK_GRAY, RED, SKY, VIVID


class Interval(NamedTuple):
    """Interval of time in which a value does not change."""

    value: Any
    start: float
    end: float


def find_intervals(time: Float[Array, " k"], values: Shaped[Array, " k"]) -> list[Interval]:
    """Find intervals of constant value; the value of an instant holds until the next."""
    first = np.append(0, 1 + np.flatnonzero(values[1:] != values[:-1]))
    ends = np.append(time[first[1:]], time[-1])
    return [Interval(values[k], float(time[k]), float(e)) for k, e in zip(first, ends, strict=True)]


def stack(time: Float[Array, " k"], *heights: float, unit: str = "s") -> tuple[Figure, list[Any]]:
    """Make panels over time, one above the other."""
    figure = Figure(figsize=(7.2, 1.35 * sum(heights) + 1.3), layout="constrained")
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)
    set_time_axis(axes[-1, 0], time, unit)
    return figure, list(axes[:, 0])


def set_time_axis(ax: Any, time: Float[Array, " k"], unit: str = "s") -> None:
    """Set the time axis to the duration of the run."""
    ax.set(xlabel=f"time [{unit}]", xlim=(time[0], max(time[-1], time[0] + 1e-9)))


def shade(axes: Iterable[Any], span: Interval, color: str, label: str, **style: Any) -> None:
    """Shade an interval in all panels."""
    for ax in axes:
        ax.axvspan(span.start, span.end, fc=color, lw=0, zorder=0, label=label, **style)


def mark_instants(axes: Iterable[Any], times: Iterable[float], label: str) -> None:
    """Draw vertical lines at instants in all panels."""
    for ax in axes:
        for time in times:
            ax.axvline(time, color=DARK_GRAY, ls=":", lw=0.9, zorder=0.5, label=label)


def mark_legs(axes: list[Any], legs: Iterable[Interval]) -> None:
    """Draw a line where each leg starts, and write its name above the first panel."""
    for leg in legs:
        for ax in axes:
            ax.axvline(leg.start, color=DARK_GRAY, lw=0.5, zorder=0.5)
        middle = (leg.start + leg.end) / 2, 1.03
        axes[0].annotate(leg.value, middle, xycoords=("data", "axes fraction"), ha="center",
                         color=DARK_GRAY, fontsize=8, annotation_clip=False)  # fmt: skip


def draw_limit(ax: Any, level: float, name: str, color: str = RED) -> None:
    """Draw a horizontal line at a limit, with its name on the right."""
    ax.axhline(level, color=color, ls="--" if color == RED else ":", lw=0.9, zorder=1)
    ax.annotate(name, (1.008, level), xycoords=("axes fraction", "data"), va="center",
                color=color, fontsize=7.5, annotation_clip=False)  # fmt: skip


def plot_spread(ax: Any, time: Float[Array, " k"], each: Float[Array, "k agents"]) -> None:
    """Plot the median of the agents, and the range of all."""
    median = np.full(len(each), np.nan)
    known = np.isfinite(each).any(axis=1)
    median[known] = np.nanmedian(each[known], axis=1)
    low, high = np.fmin.reduce(each, axis=1), np.fmax.reduce(each, axis=1)
    ax.fill_between(time, low, high, color=SKY, alpha=0.45, lw=0, label="all agents")
    ax.plot(time, median, color=BLUE, lw=1.0, label="median")


def mark_broken(ax: Any, unit: float, places: Float[Array, "agents d"], name: str) -> None:
    """Mark the places [m] at which agents break a promise, on axes of a unit [m]."""
    look: dict[str, Any] = {"ls": "", "ms": 11, "mfc": "none", "mec": VIVID, "mew": 1.8}
    ax.plot(*places.T / unit, "o", **look, zorder=9, label=f"broken: {name}")
