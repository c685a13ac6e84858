"""Projections of a swarm, and panels that show them."""

from math import ceil
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy import ndarray as Array

from sato.figures.style import DARK_GRAY, LIGHT_GRAY, RED

PADDING = 0.04  # around what is shown, in the size of it
KILOMETER_THRESHOLD = 1000.0  # size of what is shown, from which axes are in kilometers [m]


class Projection(NamedTuple):
    """Axes that are shown, with their labels and the unit of time.

    A swarm in orbit is seen in its orbital plane: along-track to the right, radial up.
    In space without an orbit there is no such plane, and all three axes are shown.
    """

    axes: tuple[int, ...]
    labels: tuple[str, ...]
    time_scale: float = 1.0  # in the unit of time
    time_unit: str = "s"

    def project(self, points: Float[Array, "*k d"]) -> Float[Array, "*k shown"]:
        """Return the shown coordinates of points."""
        return np.asarray(points[..., self.axes])

    def format_time(self, seconds: float) -> str:
        """Format an instant with its unit."""
        return f"{round(seconds * self.time_scale, 2):g} {self.time_unit}"


ORBITAL_PLANE = Projection((1, 0), ("y, along-track", "x, radial"), 1 / 60, "min")
THREE_AXES = Projection((0, 1, 2), ("x, radial", "y, along-track", "z, normal"), 1 / 60, "min")


class AxisBounds(NamedTuple):
    """Bounds of the axes that the panels of a figure share."""

    low: Float[Array, " d"]  # [m]
    high: Float[Array, " d"]  # [m]
    labels: tuple[str, ...]

    @classmethod
    def enclosing(
        cls, view: Projection, *points: Float[Array, "... d"], margin: float
    ) -> "AxisBounds":
        """Return bounds that enclose all projected points with at least a margin [m]."""
        flat = np.concatenate([p.reshape(-1, p.shape[-1]) for p in points])
        flat = flat[np.isfinite(flat).all(axis=1)]
        margin = max(margin, PADDING * float(np.ptp(flat, axis=0).max()))
        return cls(flat.min(axis=0) - margin, flat.max(axis=0) + margin, view.labels)

    @property
    def axes(self) -> int:
        """Number of axes."""
        return len(self.low)

    @property
    def unit(self) -> tuple[float, str]:
        """Unit of the axes in meters, and its name."""
        far = (self.high - self.low).max() > KILOMETER_THRESHOLD
        return (1000.0, "km") if far else (1.0, "m")

    @property
    def aspect(self) -> float:
        """Height over width of a panel."""
        size = self.high - self.low
        return float(np.clip(size[1] / size[0], 0.3, 2.5)) if self.axes == 2 else 0.95


def make_panels(
    count: int, space: AxisBounds, columns: int = 3, width: float = 3.0
) -> tuple[Figure, list[Any]]:
    """Return a figure of equal panels that share their limits, labeled only at its edges."""
    columns = min(columns, count) if count != 4 else 2
    rows = ceil(count / columns)
    figure = Figure(
        figsize=(width * columns + 0.5, rows * (width * space.aspect + 0.4) + 0.85),
    )
    flat = space.axes == 2
    if flat:
        figure.set_layout_engine("compressed", h_pad=0.09)
    else:  # the room that the labels of a view of space take is not all seen by the layout
        figure.set_layout_engine("constrained", rect=(0, 0, 0.96, 1))
    axes = [
        figure.add_subplot(rows, columns, i + 1, **({} if flat else {"projection": "3d"}))
        for i in range(count)
    ]
    for i, ax in enumerate(axes):
        set_axis_bounds(ax, space)
        if flat:
            ax.tick_params(labelbottom=i + columns >= count, labelleft=i % columns == 0)
            if i + columns < count:
                ax.set_xlabel("")
            if i % columns:
                ax.set_ylabel("")
    return figure, axes


def set_axis_bounds(ax: Any, space: AxisBounds) -> None:
    """Set limits, labels and equal scales of axes."""
    scale, unit = space.unit
    low, high = space.low / scale, space.high / scale
    for axis, name, a, b in zip("xyz", space.labels, low, high, strict=False):
        ax.set(**{f"{axis}lim": (a, b), f"{axis}label": f"{name} [{unit}]"})
        getattr(ax, f"{axis}axis").set_major_locator(_tick_locator())
    if space.axes == 2:
        ax.set_aspect("equal")
        return
    ax.set_box_aspect(high - low, zoom=0.88)
    ax.tick_params(labelsize=7, pad=0)
    for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
        axis.labelpad = 0
        axis.pane.set_facecolor("white")
        axis.pane.set_edgecolor(LIGHT_GRAY)
        axis._axinfo["grid"].update(color="#e6e6e6", linewidth=0.4)


def _tick_locator() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(5, steps=[1, 2, 5, 10])


def set_panel_title(ax: Any, title: str) -> None:
    """Set the title of a panel, closer to the axes if they are three-dimensional."""
    ax.set_title(title, y=0.96 if hasattr(ax, "get_zlim") else None)


def panel_letter(i: int) -> str:
    """Return the letter of a panel: (a), (b) and so on."""
    return f"({chr(ord('a') + i % 26)})"


def shade_legs(ax: Axes, edges: list[tuple[float, float, str]]) -> None:
    """Shade every other leg, and write the name of each above it."""
    for i, (start, end, name) in enumerate(edges):
        if i % 2:
            ax.axvspan(start, end, color="#f3f3f3", lw=0, zorder=0)
        ax.text(
            (start + end) / 2,
            1.01,
            name,
            transform=ax.get_xaxis_transform(),
            ha="center",
            va="bottom",
            color=DARK_GRAY,
            fontsize=8,
        )


def draw_limit(ax: Any, level: float, name: str, color: str = RED) -> None:
    """Draw a horizontal line at a limit, with its name on the right."""
    ax.axhline(level, color=color, ls="--" if color == RED else ":", lw=0.9, zorder=1)
    ax.annotate(name, (1.008, level), xycoords=("axes fraction", "data"), va="center",
                color=color, fontsize=7.5, annotation_clip=False)  # fmt: skip
