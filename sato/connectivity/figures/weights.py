"""Weight of an edge over distance and view angle [Bernard2023]."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from problems.interaction_graph import Camera, cosine_ramp, range_weight
from sato.connectivity.check import ConnectivityRecord
from sato.figures.axes import panel_letter
from sato.figures.style import BLUE, DARK_GRAY, GRAY, RED

# Light enough for labels.
COLORMAP = ListedColormap(colormaps["YlGnBu"](np.linspace(0, 0.68, 256)))
CONTOUR_LEVELS = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
Y_MAX = 1.3  # with room for labels above 1
GRID_POINTS = 201  # per axis


def plot_weights(record: ConnectivityRecord) -> Figure:
    """Plot γ over distance, f* over angle, f over both f*, and the weight of one camera."""
    sight = record.mission.assumed_camera
    figure = Figure(figsize=(7.6, 6.4), layout="constrained")
    axes = figure.subplots(2, 2)
    _plot_range_weight(axes[0, 0], sight)
    _plot_view_weight(axes[0, 1], sight)
    _plot_combined_view_weight(axes[1, 0])
    image = _plot_one_sided_weight(axes[1, 1], sight)
    figure.colorbar(image, ax=axes[1, :], label="weight", location="bottom", shrink=0.5, aspect=40)
    titles = ("by distance, γ", "by angle, f*", "of both views, f", "of an edge that i alone sees")
    for number, (ax, title) in enumerate(zip(axes.ravel(), titles, strict=True)):
        ax.set_title(f"{panel_letter(number)} {title}", loc="left")
    return figure


def _plot_range_weight(ax: Any, sight: Camera) -> None:
    d = np.linspace(0, 1.1 * sight.d_max, GRID_POINTS)
    ax.plot(d, range_weight(d, sight)[0], color=BLUE, lw=1.5)
    names = ("d$_{min}$", "D$_1$", "D$_2$", "d$_{max}$")
    for level, name in zip(
        (sight.d_min, sight.d_near, sight.d_far, sight.d_max), names, strict=True
    ):
        _mark_level(ax, level, f"{name}\n{level:g} m")
    ax.set(xlabel="distance [m]", ylabel="γ$_{ij}$", xlim=(0, d[-1]), ylim=(0, Y_MAX))


def _plot_view_weight(ax: Any, sight: Camera) -> None:
    degrees = np.linspace(0, 180, GRID_POINTS)
    f, _ = cosine_ramp(np.cos(np.radians(degrees)), sight.a_min, sight.a_max)
    ax.plot(degrees, f, color=BLUE, lw=1.5)
    for level, name in ((sight.a_max, "a$_{max}$"), (sight.a_min, "a$_{min}$")):
        if abs(level) < 1:
            angle = float(np.degrees(np.arccos(level)))
            _mark_level(ax, angle, f"{name}\n{level:g}\n{angle:.1f}°")
    ax.set(xlabel="angle off the optical axis o$_C$ [°]", ylabel="f*$_{ij}$", xlim=(0, 180))
    ax.set(ylim=(0, Y_MAX), xticks=range(0, 181, 30))


def _mark_level(ax: Any, level: float, name: str) -> None:
    ax.axvline(level, ymax=1 / Y_MAX, color=GRAY, ls=":", lw=0.9)
    ax.annotate(name, (level, 1.03), ha="center", va="bottom", fontsize=7.5, color=DARK_GRAY)


def _plot_combined_view_weight(ax: Any) -> None:
    x, y = np.meshgrid(np.linspace(0, 1, GRID_POINTS), np.linspace(0, 1, GRID_POINTS))
    f = x + y - x * y
    ax.imshow(f, origin="lower", extent=(0, 1, 0, 1), cmap=COLORMAP, vmin=0, vmax=1)
    lines = ax.contour(x, y, f, levels=CONTOUR_LEVELS, colors=DARK_GRAY, linewidths=0.7)
    ax.clabel(
        lines, fmt="%.1f", fontsize=7, manual=[(x, x) for x in 1 - np.sqrt(1 - CONTOUR_LEVELS)]
    )
    ax.set(xlabel="f*$_{ij}$: i has j in view", ylabel="f*$_{ji}$: j has i in view")


def _plot_one_sided_weight(ax: Any, sight: Camera) -> Any:
    reach = 1.25 * sight.d_max
    x, y = np.meshgrid(
        np.linspace(-reach, reach, GRID_POINTS), np.linspace(-reach, reach, GRID_POINTS)
    )
    d = np.maximum(np.hypot(x, y), 1e-9)
    cosine = (sight.optical_axis[0] * x + sight.optical_axis[1] * y) / d
    weight = range_weight(d, sight)[0] * cosine_ramp(cosine, sight.a_min, sight.a_max)[0]
    image = ax.imshow(
        weight, origin="lower", extent=(-reach, reach) * 2, cmap=COLORMAP, vmin=0, vmax=1
    )
    for radius in (sight.d_min, sight.d_max):
        ax.add_patch(Circle((0, 0), radius, fc="none", ec=GRAY, ls=":", lw=0.9))
    for way, color, name in (((1.0, 0.0), DARK_GRAY, "x"), (sight.optical_axis[:2], RED, "o$_C$")):
        tip = 1.08 * sight.d_max * np.array(way)
        ax.annotate("", tip, (0, 0), arrowprops={"arrowstyle": "->", "color": color, "lw": 1.2})
        ax.annotate(name, tip, xytext=(2, 3), textcoords="offset points", color=color, fontsize=8)
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach))
    ax.locator_params(nbins=6)
    ax.set(xlabel="j ahead of i [m]", ylabel="j to the left of i [m]")
    return image
