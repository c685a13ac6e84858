"""What an edge weighs, by distance and by who has whom in the field of view [Bernard2023]."""

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from problems.graph import Sight, range_weight, rise
from sato.connectivity.check import Evidence
from sato.plots.look import BLUE, DARK, GREY, RED
from sato.plots.view import letter

# From pale to what words can still be read upon.
MAP = ListedColormap(colormaps["YlGnBu"](np.linspace(0, 0.68, 256)))
LEVELS = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
TOP = 1.3  # of the picture, with room for names above 1
FINE = 201  # points along an axis


def weights(evidence: Evidence) -> Figure:
    """γ over distance, f* over angle, f over both f*, and what one camera makes of the plane."""
    sight = evidence.mission.team.sight
    figure = Figure(figsize=(7.6, 6.4), layout="constrained")
    axes = figure.subplots(2, 2)
    _range(axes[0, 0], sight)
    _view(axes[0, 1], sight)
    _either(axes[1, 0])
    image = _plane(axes[1, 1], sight)
    figure.colorbar(image, ax=axes[1, :], label="weight", location="bottom", shrink=0.5, aspect=40)
    titles = ("by distance, γ", "by angle, f*", "of both views, f", "of an edge that i alone sees")
    for number, (ax, title) in enumerate(zip(axes.ravel(), titles, strict=True)):
        ax.set_title(f"{letter(number)} {title}", loc="left")
    return figure


def _range(ax: Any, sight: Sight) -> None:
    d = np.linspace(0, 1.1 * sight.d_max, FINE)
    ax.plot(d, [range_weight(x, sight)[0] for x in d], color=BLUE, lw=1.5)
    names = ("d$_{min}$", "D$_1$", "D$_2$", "d$_{max}$")
    for level, name in zip(
        (sight.d_min, sight.d_near, sight.d_far, sight.d_max), names, strict=True
    ):
        _mark(ax, level, f"{name}\n{level:g} m")
    ax.set(xlabel="distance [m]", ylabel="γ$_{ij}$", xlim=(0, d[-1]), ylim=(0, TOP))


def _view(ax: Any, sight: Sight) -> None:
    degrees = np.linspace(0, 180, FINE)
    f = [rise(a, sight.a_min, sight.a_max) for a in np.cos(np.radians(degrees))]
    ax.plot(degrees, f, color=BLUE, lw=1.5)
    for level, name in ((sight.a_max, "a$_{max}$"), (sight.a_min, "a$_{min}$")):
        if abs(level) < 1:
            angle = float(np.degrees(np.arccos(level)))
            _mark(ax, angle, f"{name}\n{level:g}\n{angle:.1f}°")
    ax.set(xlabel="angle off the optical axis o$_C$ [°]", ylabel="f*$_{ij}$", xlim=(0, 180))
    ax.set(ylim=(0, TOP), xticks=range(0, 181, 30))


def _mark(ax: Any, level: float, name: str) -> None:
    ax.axvline(level, ymax=1 / TOP, color=GREY, ls=":", lw=0.9)
    ax.annotate(name, (level, 1.03), ha="center", va="bottom", fontsize=7.5, color=DARK)


def _either(ax: Any) -> None:
    x, y = np.meshgrid(np.linspace(0, 1, FINE), np.linspace(0, 1, FINE))
    f = x + y - x * y
    ax.imshow(f, origin="lower", extent=(0, 1, 0, 1), cmap=MAP, vmin=0, vmax=1)
    lines = ax.contour(x, y, f, levels=LEVELS, colors=DARK, linewidths=0.7)
    ax.clabel(lines, fmt="%.1f", fontsize=7, manual=[(x, x) for x in 1 - np.sqrt(1 - LEVELS)])
    ax.set(xlabel="f*$_{ij}$: i has j in view", ylabel="f*$_{ji}$: j has i in view")


def _plane(ax: Any, sight: Sight) -> Any:
    reach = 1.25 * sight.d_max
    x, y = np.meshgrid(np.linspace(-reach, reach, FINE), np.linspace(-reach, reach, FINE))
    d = np.maximum(np.hypot(x, y), 1e-9)
    cosine = (sight.axis[0] * x + sight.axis[1] * y) / d
    weight = np.vectorize(
        lambda far, a: range_weight(far, sight)[0] * rise(a, sight.a_min, sight.a_max)
    )(d, cosine)
    image = ax.imshow(weight, origin="lower", extent=(-reach, reach) * 2, cmap=MAP, vmin=0, vmax=1)
    for radius in (sight.d_min, sight.d_max):
        ax.add_patch(Circle((0, 0), radius, fc="none", ec=GREY, ls=":", lw=0.9))
    for way, colour, name in (((1.0, 0.0), DARK, "x"), (sight.axis[:2], RED, "o$_C$")):
        tip = 1.08 * sight.d_max * np.array(way)
        ax.annotate("", tip, (0, 0), arrowprops={"arrowstyle": "->", "color": colour, "lw": 1.2})
        ax.annotate(name, tip, xytext=(2, 3), textcoords="offset points", color=colour, fontsize=8)
    ax.set(xlim=(-reach, reach), ylim=(-reach, reach))
    ax.locator_params(nbins=6)
    ax.set(xlabel="j ahead of i [m]", ylabel="j to the left of i [m]")
    return image
