"""Collision half-space of an encounter, from circle to tangent [Morgan2016, Fig. 2]."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy import ndarray as Array
from scipy.spatial import ConvexHull

from dynamics.trajectory_geometry import control_points, evaluate_bezier, hull_distance
from sato.figures.axes import add_legend, add_titles
from sato.figures.style import BLUE, DARK_GRAY, GREEN, ORANGE, RED
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.figures.scene import POINTS_PER_STEP

SEEN_DISTANCE = 1.4  # of a step that is drawn from the other agent, at least, if any [R]
SHOWN_STEPS = 12  # before the step that is drawn, and as many after the closest approach


class Encounter(NamedTuple):
    """Flown trajectory of agent j relative to i, in the plane of their encounter."""

    pair: tuple[int, int]
    radius: float  # that the two keep [m]
    start: float  # of the step that is drawn [s]
    points: Float[Array, "4 2"]  # control points of this step [m]
    path: Float[Array, "k 2"]  # of this and the steps about it [m]
    closest: Float[Array, " 2"]  # at the closest approach [m]
    distance: float  # least [m]


def plot_half_space(record: ReconfigurationRecord) -> Figure:
    """Plot the pair that came closest: prohibited circle, and half-planes by its flown step."""
    found = find_encounter(record)
    radius, points = found.radius, found.points
    unit = "[m]" if record.mission.ellipsoid is None else "[m], scaled to a ball"
    figure = Figure(figsize=(9.0, 4.1), layout="constrained")
    axes = figure.subplots(1, 3, sharex=True, sharey=True)
    circle, tangent, whole = axes
    color = {"fc": RED, "alpha": 0.18, "lw": 0, "label": f"prohibited, $R_{{col}}$ = {radius:g} m"}
    circle.add_patch(Circle((0, 0), radius, **color))
    _draw_half_plane(tangent, radius, points[0], color)
    tangent.plot(*np.array([[0, 0], points[0]]).T, color=DARK_GRAY, lw=0.7, ls=":")
    _draw_half_plane(whole, radius, hull_distance(points)[1], color)
    whole.plot(*points.T, "D", ms=4, color=GREEN, mew=0, label="control points of the step")
    hull = points[ConvexHull(points, qhull_options="QJ").vertices]
    whole.add_patch(Polygon(hull, fc=GREEN, alpha=0.15, ec=GREEN, lw=0.8))
    for ax in axes:
        ax.add_patch(Circle((0, 0), radius, fill=False, ec=RED, lw=0.8))
        ax.plot(*found.path.T, color=BLUE, lw=0.9, ls="--", label="$j$ relative to $i$, as flown")
        ax.plot(0, 0, "s", ms=6, color=DARK_GRAY, label=r"agent $i$, nominal $\bar{x}_i$")
        ax.set(aspect="equal", xlabel=unit)
    for ax in (circle, tangent):
        ax.plot(*points[0], "o", ms=7, color=BLUE, label=r"agent $j$, nominal $\bar{x}_j$")
    name = f"closest: {found.distance:.6g} m"
    name += ", a collision" * bool(found.distance < radius * (1 - 1e-6))
    mark: dict[str, Any] = {"ms": 6, "color": ORANGE, "mec": DARK_GRAY, "mew": 0.6, "zorder": 5}
    circle.plot(*found.closest, "v", **mark, label=name)
    reach = 1.1 * max(2.0 * radius, float(np.abs(points).max()))
    circle.set(xlim=(-reach, reach), ylim=(-reach, reach), ylabel=unit)
    titles = [
        "prohibited circle",
        "convexified: tangent half-plane",
        "half-plane for the whole step",
    ]
    add_titles(axes, titles)
    i, j = found.pair
    text = (
        f"closest pair of the run, i = {i} and j = {j}; half-planes by the step that it flew from"
    )
    figure.suptitle(f"{text} {found.start:g} s on", fontsize=9)
    add_legend(figure)
    return figure


def _draw_half_plane(
    ax: Any, radius: float, direction: Float[Array, " 2"], color: dict[str, Any]
) -> None:
    """Draw the half-plane that is tangent to the circle in a direction; none for zero."""
    if not direction.any():
        return
    n = direction / np.linalg.norm(direction)
    edge, along, far = radius * n, np.array([-n[1], n[0]]), 60 * radius
    ends = np.array([edge + far * along, edge - far * along])
    ax.add_patch(Polygon([*ends, *(ends[::-1] - far * n)], **color))
    ax.plot(*ends.T, color=RED, lw=1.2)
    ax.annotate("", edge + 0.4 * radius * n, edge, arrowprops={"arrowstyle": "->", "color": RED})


def find_encounter(record: ReconfigurationRecord) -> Encounter:
    """Find the closest approach of all, and the last step before it that is well outside R.

    Where there is none, it is the step that stays farthest outside. In space, all is projected
    on the plane that fits the step and the closest approach best.
    """
    mission, d = record.mission, record.mission.axes
    is_relative = mission.has_own_separations
    least = (record.relative_separations if is_relative else record.separations)[0].minimum
    i, j = least.pair
    radius, near = float(mission.radii[[i, j]].mean()), least.piece // record.pieces_per_step
    x = record.state[:, j] - record.state[:, i]
    p, v = mission.scale_separations(x[:, :d]), mission.scale_separations(x[:, d:])
    pieces = control_points(p, v, mission.step)
    is_there = np.isfinite(pieces).all(axis=(1, 2))
    is_there &= (record.frames.alive | record.is_adrift)[:-1][:, [i, j]].all(axis=1)
    first = int(np.flatnonzero(~is_there[:near]).max(initial=-1)) + 1
    away, _ = hull_distance(pieces[first : near + 1])
    clear = np.flatnonzero(away >= SEEN_DISTANCE * radius)
    k = first + int(clear[-1] if len(clear) else away.argmax())
    part = (least.piece % record.pieces_per_step + least.fraction) / record.pieces_per_step
    closest = evaluate_bezier(pieces[near], float(part))
    plane = np.eye(2) if d == 2 else np.linalg.svd([*pieces[k], closest])[2][:2]
    shown = np.arange(max(first, k - SHOWN_STEPS), min(2 * near - k + SHOWN_STEPS, len(pieces)))
    shown = shown[is_there[shown]]
    parts = np.tile(np.arange(POINTS_PER_STEP) / POINTS_PER_STEP, len(shown))
    path = evaluate_bezier(pieces[np.repeat(shown, POINTS_PER_STEP)], parts)
    distance = least.distance * radius if is_relative else least.distance
    return Encounter(
        (i, j), radius, float(record.time[k]), pieces[k] @ plane.T, path @ plane.T,
        closest @ plane.T, distance,
    )  # fmt: skip
