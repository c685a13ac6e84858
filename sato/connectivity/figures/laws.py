"""Laws of a mission: weight of an edge [Bernard2023], potential of λ₂ and repulsion [Fig. 2]."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from problems.interaction_graph import cosine_ramp, range_weight
from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.controller import evaluate_potential, negative_slope, repulsion_gain
from sato.figures.axes import add_legend, add_titles
from sato.figures.style import BLUE, DARK_GRAY, GRAY, RED, SKY

# Light enough for labels.
COLORMAP = ListedColormap(colormaps["YlGnBu"](np.linspace(0, 0.68, 256)))
CONTOUR_LEVELS = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
CURVE_POINTS, GRID_POINTS = 400, 201  # of a curve, and on each axis of an image
ASYMPTOTE_GAP = 0.04  # share of the interval next to an asymptote that is not drawn
SLOPE_RANGE = 0.97  # of λ₂^max, at which the scale of −V′ ends
RUN_RANGE_STYLE: dict[str, Any] = {"fc": SKY, "alpha": 0.25, "lw": 0, "label": "in this run"}


def plot_weights(record: ConnectivityRecord) -> Figure:
    """Plot γ over distance, f* over angle, f over both f*, and the weight of one camera."""
    sight = record.mission.assumed_camera
    figure = Figure(figsize=(7.6, 6.4), layout="constrained")
    axes = figure.subplots(2, 2)
    by_range, by_angle, by_views, one_sided = axes.ravel()
    d = np.linspace(0, 1.1 * sight.d_max, GRID_POINTS)
    by_range.plot(d, range_weight(d, sight), color=BLUE, lw=1.5)
    names = "d$_{min}$", "D$_1$", "D$_2$", "d$_{max}$"
    levels = sight.d_min, sight.d_near, sight.d_far, sight.d_max
    for name, level in zip(names, levels, strict=True):
        _mark_level(by_range, level, f"{name}\n{level:g} m")
    by_range.set(xlabel="distance [m]", ylabel="γ$_{ij}$", xlim=(0, d[-1]), ylim=(0, None))

    degrees = np.linspace(0, 180, GRID_POINTS)
    in_view = cosine_ramp(np.cos(np.radians(degrees)), sight.a_min, sight.a_max)
    by_angle.plot(degrees, in_view, color=BLUE, lw=1.5)
    for cosine, name in ((sight.a_max, "a$_{max}$"), (sight.a_min, "a$_{min}$")):
        if abs(cosine) < 1:
            angle = float(np.degrees(np.arccos(cosine)))
            _mark_level(by_angle, angle, f"{name} = {cosine:g}\n{angle:.1f}°")
    by_angle.set(xlabel="angle off the optical axis o$_C$ [°]", ylabel="f*$_{ij}$", xlim=(0, 180))
    by_angle.set(ylim=(0, None), xticks=range(0, 181, 30))

    x, y = np.meshgrid(*[np.linspace(0, 1, GRID_POINTS)] * 2)
    f = x + y - x * y
    by_views.imshow(f, origin="lower", extent=(0, 1, 0, 1), cmap=COLORMAP, vmin=0, vmax=1)
    lines = by_views.contour(x, y, f, levels=CONTOUR_LEVELS, colors=DARK_GRAY, linewidths=0.7)
    on_diagonal = [(x, x) for x in 1 - np.sqrt(1 - CONTOUR_LEVELS)]
    by_views.clabel(lines, fmt="%.1f", fontsize=7, manual=on_diagonal)
    by_views.set(xlabel="f*$_{ij}$: i has j in view", ylabel="f*$_{ji}$: j has i in view")

    reach = 1.25 * sight.d_max
    x, y = np.meshgrid(*[np.linspace(-reach, reach, GRID_POINTS)] * 2)
    d = np.maximum(np.hypot(x, y), 1e-9)
    toward = (sight.optical_axis[0] * x + sight.optical_axis[1] * y) / d
    weight = range_weight(d, sight) * cosine_ramp(toward, sight.a_min, sight.a_max)
    style: dict[str, Any] = {"cmap": COLORMAP, "vmin": 0, "vmax": 1, "origin": "lower"}
    image = one_sided.imshow(weight, extent=(-reach, reach) * 2, **style)
    for radius in (sight.d_min, sight.d_max):
        one_sided.add_patch(Circle((0, 0), radius, fc="none", ec=GRAY, ls=":", lw=0.9))
    for axis, color, name in (((1.0, 0.0), DARK_GRAY, "x"), (sight.optical_axis[:2], RED, "o$_C$")):
        tip = 1.08 * sight.d_max * np.array(axis)
        arrow = {"arrowstyle": "<-", "color": color, "lw": 1.2}
        one_sided.annotate(name, (0, 0), tip, color=color, ha="center", arrowprops=arrow)
    one_sided.set(xlabel="j ahead of i [m]", ylabel="j to the left of i [m]")
    one_sided.locator_params(nbins=6)
    figure.colorbar(image, ax=axes[1, :], label="weight", location="bottom", shrink=0.5, aspect=40)
    titles = ["by distance, γ", "by angle, f*", "of both views, f", "of an edge that i alone sees"]
    add_titles(axes.ravel(), titles, loc="left", pad=28)
    return figure


def _mark_level(ax: Any, level: float, name: str) -> None:
    ax.axvline(level, color=GRAY, ls=":", lw=0.9)
    ax.annotate(name, (level, 1.01), ha="center", va="bottom", fontsize=7.5, color=DARK_GRAY,
                xycoords=("data", "axes fraction"))  # fmt: skip


def plot_potential(record: ConnectivityRecord) -> Figure:
    """Plot V and −V′ over λ₂ and repulsion over distance, with the ranges of the run."""
    potential, repulsion = record.mission.potential, record.mission.repulsion
    figure = Figure(figsize=(9.6, 3.7), layout="constrained")
    v, slope, away = figure.subplots(1, 3)
    limits = {"λ$_2^{min}$": potential.lambda2_min, "λ$_2^{max}$": potential.lambda2_max}
    lambda2 = record.frames.lambda2
    for ax, law, name in (
        (v, evaluate_potential, "V(λ$_2$)"),
        (slope, negative_slope, "−V′(λ$_2$)"),
    ):
        _draw_curve(ax, partial(law, potential=potential), limits)
        ax.axvspan(np.nanmin(lambda2), np.nanmax(lambda2), **RUN_RANGE_STYLE)
        ax.set(xlabel="λ$_2$", ylabel=name)
    if potential.strength > 0:
        least = negative_slope(SLOPE_RANGE * potential.lambda2_max, potential)
        slope.set(yscale="log", ylim=(least, None))
    limits = {"nearest": repulsion.min_distance, "farthest": repulsion.max_distance}
    _draw_curve(away, lambda d: d * repulsion_gain(d, repulsion), limits, " m")
    nearest = min(record.closest_pair.distance, record.min_obstacle_distance)
    away.axvspan(nearest, away.get_xlim()[1], **RUN_RANGE_STYLE)
    away.axhline(record.mission.limits.speed, color=RED, ls="--", label="limit of the command")
    away.set(xlabel="distance [m]", ylabel="speed away [m/s]")
    titles = ["potential of connectivity", "action on λ$_2$", "repulsion"]
    add_titles((v, slope, away), titles, loc="left", pad=28)
    add_legend(figure)
    return figure


def _draw_curve(
    ax: Any, law: Callable[[float], float], limits: dict[str, float], unit: str = ""
) -> None:
    low, high = limits.values()
    size = high - low
    x = np.linspace(low + ASYMPTOTE_GAP * size, high + 0.15 * size, CURVE_POINTS)
    y = np.array([law(each) for each in x])
    ax.plot(x, y, color=BLUE, lw=1.5, label="of this mission")
    for name, level in limits.items():
        _mark_level(ax, level, f"{name}\n{level:g}{unit}")
    ax.set(xlim=(low - 0.06 * size, x[-1]), ylim=(0, max(float(y.max()), 1e-9)))
