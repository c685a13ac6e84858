"""How well robots reckon how others are turned, by who sees whom [Bernard2023, Fig. 7]."""

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

MAX_PAIRS, COLUMNS = 6, 2  # shown at most
# By how a pair sees each other: i sees j is 1, j sees i is 2; one of them is lost is 4.
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
    """How a pair sees each other, see `SAID`, or that it is `GONE`."""
    phase = record.frames.visibility[:, i, j] + 2 * record.frames.visibility[:, j, i]
    return np.where(record.frames.alive[:, [i, j]].all(axis=1), phase, LOST)


def select_pairs(record: ConnectivityRecord) -> list[tuple[int, int]]:
    """The pairs that see each other in most ways, and among these change most often."""

    def tells(pair: tuple[int, int]) -> tuple[int, int]:
        found = find_intervals(record.frames.time, classify_visibility(record, *pair))
        return len({span.value for span in found} - {LOST}), len(found)

    pairs = list(combinations(range(record.mission.agents), 2))
    return sorted(sorted(pairs, key=tells, reverse=True)[:MAX_PAIRS])


def plot_yaw_error(record: ConnectivityRecord) -> Figure:
    """|sin(Δψ/2)| of the relative yaws that some pairs reckon, on who sees whom meanwhile."""
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
        for (a, b), colour, width in (((i, j), BLUE, 2.0), ((j, i), ORANGE, 0.8)):
            off = np.abs(np.sin(record.frames.yaw_estimate_error[:, a, b] / 2))
            ax.plot(
                record.frames.time, np.where(phase == LOST, np.nan, off), color=colour, lw=width
            )
        ax.set_title(f"{panel_letter(number)} i = {i}, j = {j}", loc="left")
    for ax in axes[len(pairs) :]:
        ax.set_axis_off()
    for ax in axes[-columns:]:
        set_time_axis(ax, record)
    figure.supylabel("|sin(Δψ/2)|", fontsize=8.5)
    lost = (LOST in classify_visibility(record, *pair) for pair in pairs)
    key: list[Patch | Line2D] = [
        Patch(fc=colour, ec="#cccccc", lw=0.5, label=said)
        for colour, said in list(zip(VISIBILITY_COLORS, VISIBILITY_LABELS, strict=True))[
            : LOST + any(lost)
        ]
    ]
    key += [
        Line2D([], [], color=BLUE, lw=2.0, label="error of what i has"),
        Line2D([], [], color=ORANGE, lw=0.8, label="error of what j has"),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=3)
    return figure
