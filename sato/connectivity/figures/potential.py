"""Potential of λ₂, its slope, and repulsion [Bernard2023, Fig. 2, Sec. III-D]."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from numpy import ndarray as Array

from sato.connectivity.check import ConnectivityRecord
from sato.connectivity.potential import evaluate_potential, negative_slope, repulsion_gain
from sato.figures.axes import panel_letter
from sato.figures.style import BLUE, DARK_GRAY, GRAY, RED, SKY

CURVE_POINTS = 400  # per curve
ASYMPTOTE_GAP = 0.04  # share of the interval next to an asymptote that is not drawn

SLOPE_RANGE = 0.97  # of λ₂^max, at which the scale of −V′ ends
RUN_RANGE_STYLE: dict[str, Any] = {
    "fc": SKY,
    "alpha": 0.25,
    "lw": 0,
    "zorder": 0,
    "label": "in this run",
}


def plot_potential(record: ConnectivityRecord) -> Figure:
    """Plot V and −V′ over λ₂ and repulsion over distance, with the ranges of the run."""
    mission = record.mission
    potential, repulsion = mission.potential, mission.repulsion
    figure = Figure(figsize=(9.6, 3.7), layout="constrained")
    v, slope, away = figure.subplots(1, 3)
    names = "λ$_2^{min}$", "λ$_2^{max}$"
    for ax, law, name in (
        (v, evaluate_potential, "V(λ$_2$)"),
        (slope, negative_slope, "−V′(λ$_2$)"),
    ):
        _draw_curve(
            ax,
            partial(law, potential=potential),
            (potential.lambda2_min, potential.lambda2_max),
            names,
        )
        ax.axvspan(
            np.nanmin(record.frames.lambda2), np.nanmax(record.frames.lambda2), **RUN_RANGE_STYLE
        )
        ax.set(xlabel="λ$_2$", ylabel=name)
    if potential.strength > 0:
        slope.set(
            yscale="log",
            ylim=(negative_slope(SLOPE_RANGE * potential.lambda2_max, potential), None),
        )
    limits = repulsion.min_distance, repulsion.max_distance
    _draw_curve(
        away, lambda d: d * repulsion_gain(d, repulsion), limits, ("nearest", "farthest"), " m"
    )
    away.axvspan(
        min(record.min_separation, record.min_obstacle_distance),
        away.get_xlim()[1],
        **RUN_RANGE_STYLE,
    )
    away.axhline(mission.limits.speed, color=RED, ls="--", lw=0.9, label="limit of the command")
    away.set(xlabel="distance [m]", ylabel="speed away [m/s]")
    titles = ("potential of connectivity", "action on λ$_2$", "repulsion")
    for number, (ax, title) in enumerate(zip((v, slope, away), titles, strict=True)):
        ax.set_title(f"{panel_letter(number)} {title}", loc="left", pad=28)
    figure.legend(*away.get_legend_handles_labels(), loc="outside lower center", ncols=3)
    return figure


def _draw_curve(
    ax: Any,
    law: Callable[[float], float],
    limits: tuple[float, float],
    names: tuple[str, str],
    unit: str = "",
) -> None:
    low, high = limits
    x = np.linspace(low + ASYMPTOTE_GAP * (high - low), high + 0.15 * (high - low), CURVE_POINTS)
    y: Float[Array, " k"] = np.array([law(each) for each in x])
    ax.plot(x, y, color=BLUE, lw=1.5, label="of this mission")
    for level, name in zip(limits, names, strict=True):
        ax.axvline(level, color=GRAY, ls=":", lw=0.9)
        ax.annotate(f"{name}\n{level:g}{unit}", (level, 1.01), ha="center", va="bottom",
                    xycoords=("data", "axes fraction"), fontsize=7.5, color=DARK_GRAY)  # fmt: skip
    ax.set(xlim=(low - 0.06 * (high - low), x[-1]), ylim=(0, max(float(y.max()), 1e-9)))
