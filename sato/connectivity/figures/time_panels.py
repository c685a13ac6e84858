"""Panels over time, with intervals of a held stick, losses and splits."""

from math import ceil
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy import ndarray as Array

from sato.connectivity.check import ConnectivityRecord
from sato.figures.style import DARK_GRAY, RED

STICK_COLOR = "#d9f0e6"  # background while the stick is held
LEGEND_COLUMNS = 4  # of the legend below the panels


class Interval(NamedTuple):
    """Interval of time in which a value does not change."""

    value: int
    start: float  # [s]
    end: float  # [s]


def find_intervals(
    time: Float[Array, " k"], values: Int[Array, " k"] | Bool[Array, " k"]
) -> list[Interval]:
    """Find intervals of constant value; the value of an instant holds until the next.

    Args:
        time: Instants [s].
        values: Value at each instant.
    """
    first = np.append(0, 1 + np.flatnonzero(np.diff(values.astype(int))))
    ends = np.append(time[first[1:]], time[-1])
    return [
        Interval(int(values[k]), float(time[k]), float(end))
        for k, end in zip(first, ends, strict=True)
    ]


def find_stick_intervals(record: ConnectivityRecord) -> list[Interval]:
    """Find the intervals in which the stick commands a velocity."""
    return [
        s
        for s in find_intervals(record.frames.time, np.asarray(record.frames.stick.any(axis=1)))
        if s.value
    ]


def stack_panels(
    record: ConnectivityRecord, heights: tuple[float, ...]
) -> tuple[Figure, list[Any]]:
    """Make panels over time, one above the other, shaded while the stick is held."""
    figure = Figure(figsize=(7.2, 1.35 * sum(heights) + 1.1), layout="constrained")
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)
    for ax in axes[:, 0]:
        for span in find_stick_intervals(record):
            ax.axvspan(span.start, span.end, fc=STICK_COLOR, lw=0, zorder=0)
        for _, lost in record.events.of_kind("loss"):
            ax.axvline(lost["time"], color=DARK_GRAY, ls=":", lw=0.9, zorder=0.5)
    for span in find_intervals(
        record.frames.time, np.asarray((record.frames.component > 0).any(axis=1))
    ):
        if span.value:
            for ax in axes[:, 0]:
                ax.axvspan(span.start, span.end, 0.97, 1, fc=RED, lw=0, zorder=0.4)
    set_time_axis(axes[-1, 0], record)
    return figure, list(axes[:, 0])


def set_time_axis(ax: Any, record: ConnectivityRecord) -> None:
    """Set the time axis to the duration of the run."""
    start, end = float(record.frames.time[0]), float(record.frames.time[-1])
    ax.set(xlabel="time [s]", xlim=(start, max(end, start + 1e-9)))


def add_legend(figure: Figure, record: ConnectivityRecord) -> None:
    """Add one legend for all panels below them."""
    handles: dict[str, Any] = {}
    for ax in figure.axes:
        drawn, labels = ax.get_legend_handles_labels()
        handles |= dict(zip(labels, drawn, strict=True))
    if find_stick_intervals(record):
        handles["stick held"] = Patch(fc=STICK_COLOR, lw=0)
    if record.events.of_kind("loss"):
        handles["loss of a robot"] = Line2D([], [], color=DARK_GRAY, ls=":", lw=0.9)
    if (record.frames.component > 0).any():
        handles["disconnected"] = Patch(fc=RED, lw=0)
    columns = ceil(len(handles) / ceil(len(handles) / LEGEND_COLUMNS))
    figure.legend(handles.values(), handles.keys(), loc="outside lower center", ncols=columns)
