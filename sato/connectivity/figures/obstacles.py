"""Obstacles in space and from above, clipped to the bounds of the axes."""

from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.patches import Circle, Rectangle
from numpy import ndarray as Array

from sato.connectivity.obstacles import Obstacles
from sato.figures.axes import AxisBounds
from sato.figures.style import GRAY, LIGHT_GRAY

BOX_STYLE: dict[str, Any] = {"color": LIGHT_GRAY, "edgecolor": GRAY, "lw": 0.5}
HORIZONTAL_TOLERANCE = 1e-9  # of a normal: its horizontal part, below which the plane is a floor


def draw_obstacles_3d(ax: Any, obstacles: Obstacles, space: AxisBounds) -> None:
    """Draw obstacles in three dimensions."""
    low, high = space.low, space.high
    turn, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    ball = np.stack([np.cos(turn) * np.sin(rise), np.sin(turn) * np.sin(rise), np.cos(rise)], -1)
    for *center, radius in obstacles.spheres:
        shown = np.clip(np.array(center) + radius * ball, low, high)
        if _has_volume(shown):
            x, y, z = np.moveaxis(shown, -1, 0)
            ax.plot_surface(x, y, z, shade=False, color=LIGHT_GRAY, ec=GRAY, lw=0.15)
    for box in obstacles.boxes:
        shown = np.clip(box.reshape(2, 3), low, high)
        if _has_volume(shown):
            ax.bar3d(*shown[0], *np.ptp(shown, axis=0), shade=False, alpha=0.35, **BOX_STYLE)
    for *normal, level in obstacles.planes:
        section = _plane_section(np.array(normal), level, space)
        fan = [(0, k, k + 1) for k in range(1, len(section) - 1)]
        if fan:
            ax.plot_trisurf(*section.T, triangles=fan, shade=False, color=LIGHT_GRAY, alpha=0.35)


def draw_obstacles_from_above(
    ax: Any, obstacles: Obstacles, space: AxisBounds, height: float
) -> None:
    """Draw obstacles from above, and the sections of planes at a height."""
    for x, y, _, radius in obstacles.spheres:
        ax.add_patch(Circle((x, y), radius, zorder=1, fc=LIGHT_GRAY, ec=GRAY, lw=0.5))
    for box in obstacles.boxes:
        ax.add_patch(
            Rectangle(
                tuple(box[:2]), *(box[3:5] - box[:2]), zorder=0.9, fc=LIGHT_GRAY, ec=GRAY, lw=0.5
            )
        )
    (x, y), (X, Y) = space.low[:2], space.high[:2]
    u, v = np.meshgrid([x, X], [y, Y])
    for a, b, c, level in obstacles.planes:
        if np.hypot(a, b) > HORIZONTAL_TOLERANCE:
            ax.contourf(u, v, a * u + b * v + c * height - level, [-np.inf, 0], colors=[LIGHT_GRAY])


def _has_volume(points: Float[Array, "*k 3"]) -> bool:
    return bool((np.ptp(points.reshape(-1, 3), axis=0) > 0).all())


def _plane_section(
    normal: Float[Array, " 3"], level: float, space: AxisBounds
) -> Float[Array, "corners 3"]:
    """Compute the corners of a plane's section with the bounds, in order about the middle."""
    found = []
    for axis, ends in product(range(3), product((0, 1), repeat=3)):
        if ends[axis] == 0 and abs(normal[axis]) > HORIZONTAL_TOLERANCE:
            at = np.where(ends, space.high, space.low)
            at[axis] += (level - normal @ at) / normal[axis]
            if space.low[axis] <= at[axis] <= space.high[axis]:
                found.append(at)
    corners = np.array(found).reshape(-1, 3)
    across, along = np.linalg.svd(np.eye(3) - np.outer(normal, normal))[0][:, :2].T
    away = corners - corners.mean(axis=0) if found else corners
    return corners[np.argsort(np.arctan2(away @ across, away @ along))]
