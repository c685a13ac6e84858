"""Gains of each formation: on the graph, and as matrices."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy import ndarray as Array

from problems.gain_matrix import GainMatrix
from sato.figures.axes import panel_letter
from sato.figures.style import DARK_GRAY
from sato.formation.check import FormationRecord

# From pale to dark, distinct to color-blind readers, and all distinct from white.
COLORMAP = ListedColormap(colormaps["YlGnBu"](np.linspace(0.15, 1, 256)))
MAX_ANNOTATED_POINTS = 8  # up to which entries are written out


class Layout(NamedTuple):
    """Arrangement of the three panels of a formation."""

    mosaic: list[list[str]]
    rows: list[float]  # relative heights
    width: float  # [in]
    height: float  # [in]


SQUARE_LAYOUT = Layout([["graph", "plane", "vertical"]], [1.0], 10.2, 3.65)
WIDE_LAYOUT = Layout([["graph", "graph"], ["plane", "vertical"]], [0.5, 1.0], 7.6, 5.9)


def plot_gains(record: FormationRecord) -> Figure:
    """Plot the graph of every formation, its edges by |A_ij|, and |A| in the plane and vertical."""
    different = _unique_gains(record.mission.gains)
    layouts = [WIDE_LAYOUT if _is_wide(gains) else SQUARE_LAYOUT for gains in different]
    heights = [layout.height for layout in layouts]
    size = max(layout.width for layout in layouts), sum(heights)
    figure = Figure(figsize=size, layout="constrained")
    parts = figure.subfigures(len(different), 1, squeeze=False, height_ratios=heights)[:, 0]
    for number, (part, layout, gains) in enumerate(zip(parts, layouts, different, strict=True)):
        axes = part.subplot_mosaic(layout.mosaic, height_ratios=layout.rows)
        plane, vertical = _edge_magnitudes(gains, gains.xy), _edge_magnitudes(gains, gains.z)
        norm = Normalize(0, float(max(np.nanmax(plane), np.nanmax(vertical))))
        _plot_graph(axes["graph"], gains, plane, norm)
        axes["graph"].set_title(f"{panel_letter(number)} {_graph_title(gains)}")
        _plot_matrix(axes["plane"], plane, norm)
        axes["plane"].set_title(_matrix_title("in the plane", gains.rate_xy, gains.bound_xy))
        image = _plot_matrix(axes["vertical"], vertical, norm)
        axes["vertical"].set_title(_matrix_title("vertical", gains.rate_z, gains.bound_z))
        part.colorbar(image, ax=axes["vertical"], label="|A$_{ij}$| [1/s]", shrink=0.85)
    return figure


def _is_wide(gains: GainMatrix) -> bool:
    size = np.ptp(gains.formation.points, axis=0)
    return bool(size[0] > 3 * size[1])


def _unique_gains(all_gains: tuple[GainMatrix, ...]) -> list[GainMatrix]:
    found: list[GainMatrix] = []
    for gains in all_gains:
        if not any(gains.matches_formation(seen.formation) for seen in found):
            found.append(gains)
    return found


def _edge_magnitudes(gains: GainMatrix, A: Array) -> Float[Array, "n n"]:
    # The diagonal, minus the sum of its row, would dominate the color scale.
    return np.where(gains.formation.graph, np.abs(A), np.nan)


def _matrix_title(way: str, rate: float, bound: float) -> str:
    return f"|A| {way}\nrate {rate:.3f}/s, none exceeds {bound:.3f}/s"


def _graph_title(gains: GainMatrix) -> str:
    formation = gains.formation
    name = formation.name.rpartition("/")[2] or f"{len(formation.points)} points"
    edges = f"{formation.edge_count} edges, {100 * formation.density:.3g} % of all"
    return f"{name}, by {gains.method}\n{edges}"


def _plot_graph(ax: Any, gains: GainMatrix, size: Float[Array, "n n"], norm: Normalize) -> None:
    points = gains.formation.points[:, :2]
    pairs = np.argwhere(np.triu(gains.formation.graph))
    weight = size[tuple(pairs.T)]
    pairs, weight = pairs[np.argsort(weight)], np.sort(weight)  # the strongest on top
    lines = LineCollection(list(points[pairs]), cmap=COLORMAP, norm=norm, zorder=1)
    lines.set_array(weight)
    lines.set_linewidth(list(0.3 + 2.2 * np.asarray(norm(weight))))
    ax.add_collection(lines)
    ax.scatter(*points.T, s=14 if len(points) < 50 else 6, color=DARK_GRAY, lw=0, zorder=3)
    if len(points) <= MAX_ANNOTATED_POINTS:
        for i, point in enumerate(points):
            ax.annotate(str(i), point, xytext=(4, 4), textcoords="offset points", color=DARK_GRAY)
    ax.margins(0.08)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="x [m]", ylabel="y [m]", box_aspect=None if _is_wide(gains) else 1)


def _plot_matrix(ax: Any, size: Float[Array, "n n"], norm: Normalize) -> Any:
    image = ax.imshow(size, cmap=COLORMAP, norm=norm, interpolation="nearest")
    ax.set(xlabel="point j", ylabel="point i")
    ax.spines[["top", "right"]].set_visible(True)
    if len(size) <= MAX_ANNOTATED_POINTS:
        ax.set(xticks=range(len(size)), yticks=range(len(size)))
        for i, j in np.argwhere(np.isfinite(size)):
            light = norm(size[i, j]) > 0.55
            ax.text(j, i, f"{size[i, j]:.2f}", ha="center", va="center", fontsize=7,
                    color="white" if light else DARK_GRAY)  # fmt: skip
    return image
