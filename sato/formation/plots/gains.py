"""Gains of each shape: on the graph, and as matrices."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy import ndarray as Array

from problems.gains import Gains
from sato.formation.check import Evidence
from sato.plots.look import DARK
from sato.plots.view import letter

# From pale to dark, told apart by the colour-blind, and from white by all.
COLOURS = ListedColormap(colormaps["YlGnBu"](np.linspace(0.15, 1, 256)))
FEW = 8  # points, up to which entries are written out


class Layout(NamedTuple):
    """Where the three panels of a shape are."""

    mosaic: list[list[str]]
    rows: list[float]  # their heights, to one another
    width: float  # [in]
    height: float  # [in]


SQUARE = Layout([["graph", "plane", "upwards"]], [1.0], 10.2, 3.65)
WIDE = Layout([["graph", "graph"], ["plane", "upwards"]], [0.5, 1.0], 7.6, 5.9)


def gains(evidence: Evidence) -> Figure:
    """The graph of every shape, its edges by |A_ij|, and |A| in the plane and upwards."""
    shapes = _distinct(evidence.mission.shapes)
    layouts = [WIDE if _wide(shape) else SQUARE for shape in shapes]
    heights = [layout.height for layout in layouts]
    size = max(layout.width for layout in layouts), sum(heights)
    figure = Figure(figsize=size, layout="constrained")
    parts = figure.subfigures(len(shapes), 1, squeeze=False, height_ratios=heights)[:, 0]
    for number, (part, layout, shape) in enumerate(zip(parts, layouts, shapes, strict=True)):
        axes = part.subplot_mosaic(layout.mosaic, height_ratios=layout.rows)
        plane, upwards = _between(shape, shape.xy), _between(shape, shape.z)
        norm = Normalize(0, float(max(np.nanmax(plane), np.nanmax(upwards))))
        _graph(axes["graph"], shape, plane, norm)
        axes["graph"].set_title(f"{letter(number)} {_called(shape)}")
        _matrix(axes["plane"], plane, norm)
        axes["plane"].set_title(_said("in the plane", shape.rate_xy, shape.bound_xy))
        image = _matrix(axes["upwards"], upwards, norm)
        axes["upwards"].set_title(_said("upwards", shape.rate_z, shape.bound_z))
        part.colorbar(image, ax=axes["upwards"], label="|A$_{ij}$| [1/s]", shrink=0.85)
    return figure


def _wide(shape: Gains) -> bool:
    size = np.ptp(shape.formation.points, axis=0)
    return bool(size[0] > 3 * size[1])


def _distinct(shapes: tuple[Gains, ...]) -> list[Gains]:
    found: list[Gains] = []
    for shape in shapes:
        if not any(shape.belongs_to(seen.formation) for seen in found):
            found.append(shape)
    return found


def _between(shape: Gains, A: Array) -> Float[Array, "n n"]:
    # The diagonal is minus the sum of its row, and would outshine all others.
    return np.where(shape.formation.graph, np.abs(A), np.nan)


def _said(way: str, rate: float, bound: float) -> str:
    return f"|A| {way}\nrate {rate:.3f}/s, none exceeds {bound:.3f}/s"


def _called(shape: Gains) -> str:
    formation = shape.formation
    n, edges = len(formation.points), int(formation.graph.sum()) // 2
    share = 200 * edges / (n * (n - 1))
    name = formation.name.rpartition("/")[2] or f"{n} points"
    return f"{name}, by {shape.method}\n{edges} edges, {share:.3g} % of all"


def _graph(ax: Any, shape: Gains, size: Float[Array, "n n"], norm: Normalize) -> None:
    points = shape.formation.points[:, :2]
    pairs = np.argwhere(np.triu(shape.formation.graph))
    weight = size[tuple(pairs.T)]
    pairs, weight = pairs[np.argsort(weight)], np.sort(weight)  # the strongest on top
    lines = LineCollection(list(points[pairs]), cmap=COLOURS, norm=norm, zorder=1)
    lines.set_array(weight)
    lines.set_linewidth(list(0.3 + 2.2 * np.asarray(norm(weight))))
    ax.add_collection(lines)
    ax.scatter(*points.T, s=14 if len(points) < 50 else 6, color=DARK, lw=0, zorder=3)
    if len(points) <= FEW:
        for i, point in enumerate(points):
            ax.annotate(str(i), point, xytext=(4, 4), textcoords="offset points", color=DARK)
    ax.margins(0.08)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="x [m]", ylabel="y [m]", box_aspect=None if _wide(shape) else 1)


def _matrix(ax: Any, size: Float[Array, "n n"], norm: Normalize) -> Any:
    image = ax.imshow(size, cmap=COLOURS, norm=norm, interpolation="nearest")
    ax.set(xlabel="point j", ylabel="point i")
    ax.spines[["top", "right"]].set_visible(True)
    if len(size) <= FEW:
        ax.set(xticks=range(len(size)), yticks=range(len(size)))
        for i, j in np.argwhere(np.isfinite(size)):
            light = norm(size[i, j]) > 0.55
            ax.text(j, i, f"{size[i, j]:.2f}", ha="center", va="center", fontsize=7,
                    color="white" if light else DARK)  # fmt: skip
    return image
