"""Messages: bytes that agents receive by purpose, and synchronous rounds over time."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from sato.figures import panels
from sato.figures.axes import add_legend
from sato.figures.style import BLUE, GREEN, ORANGE, PURPLE
from sato.network.load import PURPOSES
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.figures.scene import Scene

COLORS = (GREEN, BLUE, ORANGE, PURPLE)
KILOBYTE, MEGABYTE = 1e3, 1e6


def plot_messages(record: ReconfigurationRecord) -> Figure:
    """Plot bytes by purpose, of the agents in the order of the sum, and rounds at each instant."""
    scene, frames, received = Scene(record), record.frames, record.variables.received_bytes
    assert received is not None and frames.rounds is not None
    total, ranks = received.sum(axis=1), np.argsort(-received.sum(axis=1), kind="stable")
    size, unit = (MEGABYTE, "MB") if total.max() >= MEGABYTE else (KILOBYTE, "kB")
    figure = Figure(figsize=(7.2, 4.8), layout="constrained")
    above, below = figure.subplots(2, 1, height_ratios=(1.2, 1))
    edges, base = np.arange(len(ranks) + 1) + 0.5, np.zeros(len(ranks))
    for name, color, own in zip(PURPOSES, COLORS, received[ranks].T / size, strict=True):
        style: dict[str, Any] = {"fill": True, "color": color, "lw": 0, "label": name}
        above.stairs(base + own, edges, baseline=base, **style)
        base = base + own
    for n, name in {(len(ranks) + 1) // 2: "median", 1: "most"}.items():
        offset: dict[str, Any] = {"xytext": (2, 4), "textcoords": "offset points"}
        above.annotate(f"{name}: {base[n - 1]:.3g} {unit}", (n, base[n - 1]), **offset)
    above.set(xlabel="agents, those that receive most first", ylabel=f"received [{unit}]")
    above.set(xlim=(0.5, len(ranks) + 0.5), ylim=(0, 1.12 * base.max() or 1.0))
    above.xaxis.set_major_locator(MaxNLocator(integer=True))
    t = record.time * scene.view.time_scale
    for color, rounds in zip(COLORS, frames.rounds.T, strict=True):
        mark: dict[str, Any] = {"ls": "", "marker": "o", "ms": 2.5, "mew": 0, "clip_on": False}
        below.plot(t[rounds > 0], rounds[rounds > 0], color=color, **mark)
    panels.set_time_axis(below, t, scene.view.time_unit)
    below.set(yscale="log", ylabel="synchronous rounds", ylim=(0.8, None))
    below.yaxis.set_major_formatter("{x:g}")
    below.yaxis.set_minor_formatter("")
    add_legend(figure)
    return figure
