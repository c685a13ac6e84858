"""Collision half-space of an encounter, from circle to tangent [Morgan2016, Fig. 2]."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy import ndarray as Array
from scipy.spatial import ConvexHull

from dynamics.trajectory_geometry import control_points, hull_distance
from sato.figures.axes import add_legend, add_titles
from sato.figures.style import BLUE, DARK_GRAY, GREEN, RED
from sato.reconfiguration.check.recorded import ReconfigurationRecord

# Control points of an encounter that is drawn where none was close, in collision radii.
EXAMPLE = np.array([[1.5, 0.9], [1.1, 1.0], [0.6, 1.25], [0.2, 1.6]])
AVOIDED_RANGE = (1.4, 3.0)  # distances at which agents see each other coming, in collision radii


def plot_half_space(record: ReconfigurationRecord) -> Figure:
    """Plot the prohibited circle, its tangent half-plane, and the half-plane of a whole step."""
    radius = record.mission.largest_separation
    example = radius * EXAMPLE
    points, path = _find_closest_encounter(record) or (example, example)
    distance, nearest = hull_distance(points)
    figure = Figure(figsize=(9.0, 3.9), layout="constrained")
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    circle, tangent, whole = axes
    color = {"fc": RED, "alpha": 0.18, "lw": 0, "label": f"prohibited, $R_{{col}}$ = {radius:g} m"}
    circle.add_patch(Circle((0, 0), radius, **color))
    _draw_half_plane(tangent, radius, points[0] / np.linalg.norm(points[0]), color)
    tangent.plot(*np.array([[0, 0], points[0]]).T, color=DARK_GRAY, lw=0.7, ls=":")
    _draw_half_plane(whole, radius, nearest / distance, color)
    whole.plot(*points.T, "D", ms=4, color=GREEN, mew=0, label="control points of a step")
    hull = points[ConvexHull(points, qhull_options="QJ").vertices]
    whole.add_patch(Polygon(hull, fc=GREEN, alpha=0.15, ec=GREEN, lw=0.8))
    for ax in axes:
        ax.add_patch(Circle((0, 0), radius, fill=False, ec=RED, lw=0.8))
        ax.plot(*path.T, color=BLUE, lw=0.9, ls="--", label="trajectory of $j$ relative to $i$")
        ax.plot(0, 0, "s", ms=6, color=DARK_GRAY, label=r"agent $i$, nominal $\bar{x}_i$")
        ax.set(aspect="equal", xlabel="[m]")
    for ax in (circle, tangent):
        ax.plot(*points[0], "o", ms=7, color=BLUE, label=r"agent $j$, nominal $\bar{x}_j$")
    reach = 1.1 * max(2.0 * radius, float(np.abs(points).max()))
    circle.set(xlim=(-reach, reach), ylim=(-reach, reach), ylabel="[m]")
    titles = ["prohibited circle", "convexified: tangent half-plane", "half-plane of a whole step"]
    add_titles(axes, titles)
    add_legend(figure)
    return figure


def _draw_half_plane(ax: Any, radius: float, n: Float[Array, " 2"], color: dict[str, Any]) -> None:
    edge, along, far = radius * n, np.array([-n[1], n[0]]), 60 * radius
    ends = np.array([edge + far * along, edge - far * along])
    ax.add_patch(Polygon([*ends, *(ends[::-1] - far * n)], **color))
    ax.plot(*ends.T, color=RED, lw=1.2)
    ax.annotate("", edge + 0.4 * radius * n, edge, arrowprops={"arrowstyle": "->", "color": RED})


def _find_closest_encounter(
    record: ReconfigurationRecord,
) -> tuple[Float[Array, "4 2"], Float[Array, "k 2"]] | None:
    # The two agents that came closest, some steps before, if they were near enough to avoid each
    # other: the control points of a step of their relative trajectory, and more of it, in the
    # plane of their encounter.
    radius, d = record.mission.largest_separation, record.mission.axes
    found, _ = record.separations
    if not len(found.distance) or not found.minimum.distance <= 2 * radius:
        return None
    i, j = found.minimum.pair
    near = found.minimum.piece // record.pieces_per_step
    x = record.state[:, j] - record.state[:, i]
    alive = record.frames.alive[:, i] & record.frames.alive[:, j]
    first = int(np.flatnonzero(~alive[: near + 1]).max(initial=-1)) + 1
    distance = np.linalg.norm(x[first : near + 1, :d], axis=1)
    low, high = AVOIDED_RANGE
    far = np.flatnonzero((distance >= low * radius) & (distance <= high * radius))
    if not len(far):
        return None
    k = first + int(far[-1])
    points = control_points(x[k : k + 2, :d], x[k : k + 2, d:], record.mission.step)[0]
    plane = np.eye(2) if d == 2 else np.linalg.svd(points)[2][:2]
    if not hull_distance(points @ plane.T)[0] > radius:
        return None
    around = slice(max(first, k - 12), 2 * near - k + 13)
    return points @ plane.T, x[around, :d][alive[around]] @ plane.T
