"""Panels of figures: projections of a swarm, trajectories, titles and legends."""

from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager
from itertools import cycle
from math import ceil
from string import ascii_lowercase
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.style import context
from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]  # no stubs
from numpy import ndarray as Array

from sato.figures.style import GRAY, STYLE
from sato.terminal import as_line

PADDING = 0.04  # around what is shown, in the size of it
LONGEST_LABEL = 100  # that is not cut
KILOMETER_THRESHOLD = 1000.0  # size of what is shown, from which axes are in kilometers [m]


def styled() -> AbstractContextManager[None]:
    """Return a context in which matplotlib has its defaults, and the settings of our figures."""
    return context(["default", STYLE])


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
ORBITAL_SPACE = Projection((0, 1, 2), ("x, radial", "y, along-track", "z, normal"), 1 / 60, "min")


class AxisBounds(NamedTuple):
    """Bounds of the axes that the panels of a figure share."""

    low: Float[Array, " d"]  # [m]
    high: Float[Array, " d"]  # [m]
    labels: tuple[str, ...]

    @classmethod
    def enclosing(
        cls, labels: tuple[str, ...], *points: Float[Array, "... d"], margin: float
    ) -> "AxisBounds":
        """Return bounds that enclose all projected points with at least a margin [m]."""
        flat = np.concatenate([p.reshape(-1, len(labels)) for p in points])
        flat = flat[np.isfinite(flat).all(axis=1)]
        margin = max(margin, PADDING * float(np.ptp(flat, axis=0).max()))
        return cls(flat.min(axis=0) - margin, flat.max(axis=0) + margin, labels)

    @property
    def is_flat(self) -> bool:
        """True for two axes."""
        return len(self.low) == 2

    @property
    def size(self) -> Float[Array, " d"]:
        """Length of each axis [m]."""
        return np.asarray(self.high - self.low)

    @property
    def unit(self) -> tuple[float, str]:
        """Unit of the axes in meters, and its name."""
        return (1000.0, "km") if self.size.max() > KILOMETER_THRESHOLD else (1.0, "m")

    @property
    def aspect(self) -> float:
        """Height over width of a panel."""
        return float(np.clip(self.size[1] / self.size[0], 0.3, 2.5)) if self.is_flat else 0.95


def make_panels(
    titles: list[str], space: AxisBounds, columns: int = 3, width: float = 3.0
) -> tuple[Figure, list[Any]]:
    """Return a figure of equal panels that share their limits, labeled only at its edges."""
    count = len(titles)
    columns = min(columns, count) if count != 4 else 2
    rows = ceil(count / columns)
    size = width * columns + 0.5, rows * (width * space.aspect + 0.4) + 0.85
    figure = Figure(figsize=size)
    if space.is_flat:
        figure.set_layout_engine("compressed", h_pad=0.09)
    else:  # the room that the labels of a view of space take is not all seen by the layout
        figure.set_layout_engine("constrained", rect=(0, 0, 0.92, 1))
    axes = [add_axes(figure, space, (rows, columns, i + 1)) for i in range(count)]
    for i, ax in enumerate(axes if space.is_flat else []):
        is_lowest, is_first = i + columns >= count, i % columns == 0
        ax.tick_params(labelbottom=is_lowest, labelleft=is_first)
        ax.xaxis.label.set_visible(is_lowest)
        ax.yaxis.label.set_visible(is_first)
    add_titles(axes, titles)
    return figure, axes


def add_axes(figure: Figure, space: AxisBounds, cell: tuple[int, int, int] = (1, 1, 1)) -> Any:
    """Add axes with these bounds at a row, column and number of a grid."""
    ax = figure.add_subplot(*cell, projection=None if space.is_flat else "3d")
    set_axis_bounds(ax, space)
    return ax


def set_axis_bounds(ax: Any, space: AxisBounds) -> None:
    """Set limits, labels and equal scales of axes."""
    scale, unit = space.unit
    for axis, name, low, high in zip("xyz", space.labels, space.low, space.high, strict=False):
        ax.set(**{f"{axis}lim": (low / scale, high / scale), f"{axis}label": f"{name} [{unit}]"})
    ax.locator_params(nbins=5, steps=[1, 2, 5, 10])
    if space.is_flat:
        ax.set_aspect("equal")
    else:
        ax.set_box_aspect(space.size)
        ax.tick_params(labelsize=7, pad=0)


def draw_paths(
    ax: Any, space: AxisBounds, path: Float[Array, "instants agents d"], color: str, **style: Any
) -> None:
    """Draw trajectories; an agent is not shown where its position is NaN."""
    kind = LineCollection if space.is_flat else Line3DCollection
    lines = list(np.moveaxis(path, 1, 0) / space.unit[0])
    ax.add_collection(kind(lines, colors=color, **{"lw": 0.8, **style}))


def draw_ends(
    ax: Any, space: AxisBounds, path: Float[Array, "instants agents d"], color: str, ms: float = 3.0
) -> None:
    """Draw where agents start, and where those that are not lost end."""
    known = np.isfinite(path[..., 0])
    first = path[np.argmax(known, axis=0), np.arange(path.shape[1])] / space.unit[0]
    mark: dict[str, Any] = {"ls": "", "marker": "o", "ms": ms, "zorder": 4}
    ax.plot(*first.T, **mark, mfc="white", mec=GRAY, mew=0.7, label="start")
    ax.plot(*path[-1].T / space.unit[0], **mark, color=color, mew=0, label="end")


def add_titles(axes: Iterable[Any], titles: Sequence[str], **options: Any) -> None:
    """Set the titles of panels, after the letters (a), (b) and so on."""
    for ax, title, letter in zip(axes, titles, cycle(ascii_lowercase), strict=False):
        ax.set_title(f"({letter}) {title}", **options)


def as_label(text: str) -> str:
    """Return text as one line of a figure, cut short; no part of it is a formula."""
    line = as_line(text)
    short = line if len(line) <= LONGEST_LABEL else f"{line[:LONGEST_LABEL]}…"
    return short.replace("$", r"\$")


def add_legend(figure: Figure, *handles: Any, title: str | None = None) -> None:
    """Add a legend below all panels: each label in them once, then those of the handles."""
    entries: dict[str, Any] = {}
    for ax in figure.axes:
        drawn, labels = ax.get_legend_handles_labels()
        entries |= dict(zip(labels, drawn, strict=True))
    entries |= {handle.get_label(): handle for handle in handles}
    rows = ceil(len(entries) / int(figure.get_figwidth() / 1.8))
    columns = ceil(len(entries) / rows)
    place: dict[str, Any] = {"loc": "outside lower center", "ncols": columns, "title": title}
    figure.legend(entries.values(), entries.keys(), **place)
