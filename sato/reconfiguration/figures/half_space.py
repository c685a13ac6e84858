"""Collision half-space of an encounter, from circle to tangent [Morgan2016, Fig. 2]."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon
from numpy import ndarray as Array

from dynamics.trajectory_geometry import control_points, evaluate_bezier, hull_distance
from sato.figures.axes import panel_letter
from sato.figures.style import BLUE, DARK_GRAY, GREEN, RED
from sato.reconfiguration.check.recorded import ReconfigurationRecord

_PROHIBITED_STYLE: dict[str, Any] = {"facecolor": RED, "alpha": 0.18, "edgecolor": "none"}


class Encounter(NamedTuple):
    """Relative trajectory of two agents that come close, in the plane of their encounter."""

    radius: float  # [m]
    control_points: Float[Array, "4 2"]  # of the relative trajectory in a step [m]
    path: Float[Array, "k 2"]  # relative trajectory over more steps [m]


def plot_half_space(record: ReconfigurationRecord) -> Figure:
    """Plot the prohibited circle, its tangent half-plane, and the half-plane of a whole step."""
    radius = record.mission.collision_radius
    encounter = _find_closest_encounter(record) or _make_example_encounter(radius)
    figure = Figure(figsize=(9.0, 3.9), layout="constrained")
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    for i, draw in enumerate((_draw_circle, _draw_tangent, _draw_hull)):
        ax = axes[i]
        ax.set_title(f"{panel_letter(i)} {draw(ax, encounter)}")
        ax.set(aspect="equal", xlabel="[m]" if i == 1 else "")
    reach = 1.1 * max(2.0 * encounter.radius, float(np.abs(encounter.control_points).max()))
    axes[0].set(xlim=(-reach, reach), ylim=(-reach, reach), ylabel="[m]")
    key = [
        Line2D([], [], ls="", marker="o", color=BLUE, label=r"agent $j$, nominal $\bar{x}_j$"),
        Line2D([], [], ls="", marker="s", color=DARK_GRAY, label=r"agent $i$, nominal $\bar{x}_i$"),
        Line2D([], [], ls="--", lw=0.9, color=BLUE, label=r"trajectory of $j$ relative to $i$"),
        Patch(**_PROHIBITED_STYLE, label=f"prohibited, $R_{{col}}$ = {encounter.radius:g} m"),
        Line2D([], [], ls="", marker="D", ms=4, color=GREEN, label="control points of a step"),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=5)
    return figure


def _draw_circle(ax: Any, encounter: Encounter) -> str:
    ax.add_patch(Circle((0, 0), encounter.radius, **_PROHIBITED_STYLE))
    ax.add_patch(Circle((0, 0), encounter.radius, fill=False, ec=RED, lw=1))
    ax.plot(
        [0, encounter.radius * np.cos(4.0)], [0, encounter.radius * np.sin(4.0)], color=RED, lw=0.8
    )
    ax.text(*(0.5 * encounter.radius * np.array([np.cos(4.5), np.sin(4.5)])), r"$R_{col}$",
            ha="center", va="center", color=RED)  # fmt: skip
    _draw_nominals(ax, encounter)
    return "prohibited circle"


def _draw_tangent(ax: Any, encounter: Encounter) -> str:
    n = encounter.control_points[0] / np.linalg.norm(encounter.control_points[0])
    _draw_half_plane(ax, encounter.radius, n)
    ax.plot(*np.array([0 * n, encounter.control_points[0]]).T, color=DARK_GRAY, lw=0.7, ls=":")
    _draw_nominals(ax, encounter)
    return "convexified: tangent half-plane"


def _draw_hull(ax: Any, encounter: Encounter) -> str:
    distance, nearest = hull_distance(encounter.control_points)
    _draw_half_plane(ax, encounter.radius, nearest / distance)
    order = _order_hull(encounter.control_points)
    ax.add_patch(Polygon(order, closed=True, fc=GREEN, alpha=0.15, ec=GREEN, lw=0.8))
    ax.plot(*encounter.path.T, color=BLUE, lw=0.9, ls="--", alpha=0.8)
    path = evaluate_bezier(
        np.broadcast_to(encounter.control_points, (40, 4, 2)), np.linspace(0, 1, 40)
    )
    ax.plot(*path.T, color=BLUE, lw=1.6)
    ax.plot(*encounter.control_points.T, "D", ms=4, color=GREEN, mew=0)
    ax.plot(0, 0, "s", ms=6, color=DARK_GRAY)
    return "half-plane of a whole step"


def _draw_nominals(ax: Any, encounter: Encounter) -> None:
    ax.plot(*encounter.path.T, color=BLUE, lw=0.9, ls="--", alpha=0.8)
    ax.plot(*encounter.control_points[0], "o", ms=7, color=BLUE)
    ax.plot(0, 0, "s", ms=6, color=DARK_GRAY)


def _draw_half_plane(ax: Any, radius: float, n: Float[Array, " 2"]) -> None:
    along, far = np.array([-n[1], n[0]]), 60 * radius
    edge = radius * n
    ends = [edge + far * along, edge - far * along]
    corners = [*ends, ends[1] - far * n, ends[0] - far * n]
    ax.add_patch(Polygon(corners, closed=True, **_PROHIBITED_STYLE))
    ax.plot(*np.array(ends).T, color=RED, lw=1.2)
    ax.add_patch(Circle((0, 0), radius, fill=False, ec=RED, lw=0.8, ls=":"))
    ax.annotate("", edge + 0.4 * radius * n, edge, arrowprops={"arrowstyle": "->", "color": RED})


def _order_hull(points: Float[Array, "4 2"]) -> Float[Array, "k 2"]:
    from scipy.spatial import ConvexHull, QhullError

    try:
        return np.asarray(points[ConvexHull(points).vertices])
    except QhullError:
        return points[[0, 3]]


def _find_closest_encounter(record: ReconfigurationRecord) -> Encounter | None:
    # The two agents that came closest, some steps before, if they were near enough to avoid
    # each other.
    radius, d = record.mission.collision_radius, record.axes
    found, _ = record.separations
    if not len(found.distance) or not found.minimum.distance <= 2 * radius:
        return None
    i, j = found.minimum.pair
    near = found.minimum.piece // record.pieces_per_step
    x = record.state[:, j] - record.state[:, i]
    both = record.alive[:, i] & record.alive[:, j]
    first = near - int(np.argmin(np.append(both[near::-1], False))) + 1
    distance = np.linalg.norm(x[first : near + 1, :d], axis=1)
    far = np.flatnonzero((distance >= 1.4 * radius) & (distance <= 3 * radius))
    if not len(far):
        return None
    k = first + int(far[-1])
    points = control_points(x[k : k + 2, :d], x[k : k + 2, d:], record.mission.step)[0]
    frame = _fit_plane(points)
    if not hull_distance(points @ frame.T)[0] > radius:
        return None
    around = slice(max(first, k - 12), 2 * near - k + 13)
    path = x[around, :d][both[around]]
    return Encounter(radius, points @ frame.T, path @ frame.T)


def _fit_plane(points: Float[Array, "4 d"]) -> Float[Array, "2 d"]:
    if points.shape[1] == 2:
        return np.eye(2)
    return np.asarray(np.linalg.svd(points)[2][:2])


def _make_example_encounter(radius: float) -> Encounter:
    points = radius * np.array([[1.5, 0.9], [1.1, 1.0], [0.6, 1.25], [0.2, 1.6]])
    before, after = points[0] + (points[0] - points[1]), points[3] + (points[3] - points[2])
    path = evaluate_bezier(np.broadcast_to(points, (20, 4, 2)), np.linspace(0, 1, 20))
    return Encounter(radius, points, np.vstack([before, path, after]))
