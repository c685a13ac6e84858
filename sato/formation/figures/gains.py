"""Gains of each formation: on the graph, and as matrices."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.colors import ListedColormap, Normalize
from matplotlib.figure import Figure
from numpy import ndarray as Array

from problems.desired_formation import DesiredFormation
from problems.gain_matrix import GainMatrix
from sato.figures.axes import add_titles, as_label
from sato.figures.style import DARK_GRAY
from sato.formation.check.recorded import FormationRecord

# From pale to dark, distinct to color-blind readers, and all distinct from white.
COLORMAP = ListedColormap(colormaps["YlGnBu"](np.linspace(0.15, 1, 256)))
MAX_ANNOTATED_POINTS = 8  # up to which entries are written out


def plot_gains(record: FormationRecord) -> Figure:
    """Plot the graph of every formation, its edges by |A_ij|, and |A| in the plane and vertical."""
    different: list[GainMatrix] = []
    for gains in record.mission.gains:
        if not any(gains.matches_formation(seen.formation) for seen in different):
            different.append(gains)
    figure = Figure(figsize=(10.2, 3.65 * len(different)), layout="constrained")
    rows = figure.subplots(len(different), 3, squeeze=False)
    for (graph, plane, vertical), gains in zip(rows, different, strict=True):
        # The diagonal, minus the sum of its row, would dominate the color scale.
        xy, z = (np.where(gains.formation.graph, np.abs(A), np.nan) for A in (gains.xy, gains.z))
        norm = Normalize(0, float(np.nanmax([xy, z])))
        _plot_graph(graph, gains.formation, xy, norm)
        _plot_matrix(plane, xy, norm)
        plane.set_title(_matrix_title("in the plane", gains.rate_xy, gains.bound_xy))
        image = _plot_matrix(vertical, z, norm)
        vertical.set_title(_matrix_title("vertical", gains.rate_z, gains.bound_z))
        figure.colorbar(image, ax=vertical, label="|A$_{ij}$| [1/s]", shrink=0.85)
    add_titles(rows[:, 0], [_graph_title(gains) for gains in different])
    return figure


def _matrix_title(way: str, rate: float, bound: float) -> str:
    return f"|A| {way}\nrate {rate:.3f}/s\nat this trace ≤ {bound:.3f}/s"


def _graph_title(gains: GainMatrix) -> str:
    formation = gains.formation
    name = as_label(formation.name.rpartition("/")[2]) or f"{len(formation.points)} points"
    edges = f"{formation.edge_count} edges, {100 * formation.density:.3g} % of all"
    both = f"rate {gains.convergence_rate:.3f}/s, jointly ≤ {gains.joint_bound:.3f}/s"
    return f"{name}, by {as_label(gains.method)}\n{edges}\n{both}"


def _plot_graph(
    ax: Any, formation: DesiredFormation, size: Float[Array, "n n"], norm: Normalize
) -> None:
    points, pairs = formation.points[:, :2], np.argwhere(np.triu(formation.graph))
    pairs = pairs[np.argsort(size[tuple(pairs.T)])]  # the strongest on top
    weight = size[tuple(pairs.T)]
    widths = 0.3 + 2.2 * np.asarray(norm(weight))
    style: dict[str, Any] = {"cmap": COLORMAP, "norm": norm, "array": weight, "lw": widths}
    ax.add_collection(LineCollection(list(points[pairs]), zorder=1, **style))
    ax.plot(*points.T, "o", ms=3.5 if len(points) < 50 else 2.5, color=DARK_GRAY, mew=0)
    if len(points) <= MAX_ANNOTATED_POINTS:
        for i, point in enumerate(points):
            ax.annotate(str(i), point, xytext=(4, 4), textcoords="offset points", color=DARK_GRAY)
    ax.margins(0.08)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="x [m]", ylabel="y [m]", box_aspect=1)


def _plot_matrix(ax: Any, size: Float[Array, "n n"], norm: Normalize) -> Any:
    image = ax.imshow(size, cmap=COLORMAP, norm=norm, interpolation="nearest")
    ax.set(xlabel="point j", ylabel="point i")
    if len(size) <= MAX_ANNOTATED_POINTS:
        for i, j in np.argwhere(np.isfinite(size)):
            color = "white" if norm(size[i, j]) > 0.55 else DARK_GRAY
            ax.text(j, i, f"{size[i, j]:.2f}", ha="center", va="center", fontsize=7, color=color)
    return image
