"""Errors of relative yaw, by visibility [Bernard2023, Fig. 7]."""

from itertools import combinations
from math import ceil

import numpy as np
from jaxtyping import Int
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy import ndarray as Array

from sato.connectivity.check import ConnectivityRecord
from sato.connectivity.figures.time_panels import find_intervals, set_time_axis
from sato.figures.axes import panel_letter
from sato.figures.style import BLUE, ORANGE

MAX_PAIRS, COLUMNS = 6, 2  # at most
# By visibility: 1 where i sees j, plus 2 where j sees i; 4 where one is lost.
VISIBILITY_COLORS = ("none", "#d3e6f5", "#fbe9b4", "#cfead9", "#dddddd")
VISIBILITY_LABELS = (
    "neither sees the other",
    "only i sees j",
    "only j sees i",
    "both see each other",
    "one of them is lost",
)
LOST = 4


def classify_visibility(record: ConnectivityRecord, i: int, j: int) -> Int[Array, " instants"]:
    """Classify how two robots see each other, as an index of `VISIBILITY_LABELS`."""
    phase = record.frames.visibility[:, i, j] + 2 * record.frames.visibility[:, j, i]
    return np.where(record.frames.alive[:, [i, j]].all(axis=1), phase, LOST)


def select_pairs(record: ConnectivityRecord) -> list[tuple[int, int]]:
    """Select the pairs with most kinds of visibility, then with most changes."""

    def variety(pair: tuple[int, int]) -> tuple[int, int]:
        found = find_intervals(record.frames.time, classify_visibility(record, *pair))
        return len({span.value for span in found} - {LOST}), len(found)

    pairs = list(combinations(range(record.mission.agents), 2))
    return sorted(sorted(pairs, key=variety, reverse=True)[:MAX_PAIRS])


def plot_yaw_error(record: ConnectivityRecord) -> Figure:
    """Plot |sin(Δψ/2)| of some pairs over time, on a background of their visibility."""
    pairs = select_pairs(record)
    columns = min(COLUMNS, len(pairs))
    rows = ceil(len(pairs) / columns)
    figure = Figure(
        figsize=(max(4.1 * columns + 0.6, 6.0), 1.45 * rows + 1.1), layout="constrained"
    )
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for number, (ax, (i, j)) in enumerate(zip(axes, pairs, strict=False)):
        phase = classify_visibility(record, i, j)
        for span in find_intervals(record.frames.time, phase):
            ax.axvspan(span.start, span.end, fc=VISIBILITY_COLORS[span.value], lw=0, zorder=0)
        for (a, b), color, width in (((i, j), BLUE, 2.0), ((j, i), ORANGE, 0.8)):
            off = np.abs(np.sin(record.frames.yaw_estimate_error[:, a, b] / 2))
            ax.plot(record.frames.time, np.where(phase == LOST, np.nan, off), color=color, lw=width)
        ax.set_title(f"{panel_letter(number)} i = {i}, j = {j}", loc="left")
    for ax in axes[len(pairs) :]:
        ax.set_axis_off()
    for ax in axes[-columns:]:
        set_time_axis(ax, record)
    figure.supylabel("|sin(Δψ/2)|", fontsize=8.5)
    lost = (LOST in classify_visibility(record, *pair) for pair in pairs)
    key: list[Patch | Line2D] = [
        Patch(fc=color, ec="#cccccc", lw=0.5, label=said)
        for color, said in list(zip(VISIBILITY_COLORS, VISIBILITY_LABELS, strict=True))[
            : LOST + any(lost)
        ]
    ]
    key += [
        Line2D([], [], color=BLUE, lw=2.0, label="error of i"),
        Line2D([], [], color=ORANGE, lw=0.8, label="error of j"),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=3)
    return figure
