"""Obstacles, in space and from above; what is beyond the picture is cut off."""

from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.patches import Circle, Rectangle
from numpy import ndarray as Array

from sato.connectivity.obstacles import Obstacles
from sato.plots.look import GREY, PALE
from sato.plots.view import Space

EDGED: dict[str, Any] = {"color": PALE, "edgecolor": GREY, "lw": 0.5}
LEVEL = 1e-9  # a normal that leans no more belongs to a floor


def in_space(ax: Any, obstacles: Obstacles, space: Space) -> None:
    """Draw obstacles into a view of space."""
    low, high = space.low, space.high
    turn, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    ball = np.stack([np.cos(turn) * np.sin(rise), np.sin(turn) * np.sin(rise), np.cos(rise)], -1)
    for *centre, radius in obstacles.spheres:
        shown = np.clip(np.array(centre) + radius * ball, low, high)
        if _has_volume(shown):
            x, y, z = np.moveaxis(shown, -1, 0)
            ax.plot_surface(x, y, z, shade=False, color=PALE, ec=GREY, lw=0.15)
    for box in obstacles.boxes:
        shown = np.clip(box.reshape(2, 3), low, high)
        if _has_volume(shown):
            ax.bar3d(*shown[0], *np.ptp(shown, axis=0), shade=False, alpha=0.35, **EDGED)
    for *normal, level in obstacles.planes:
        section = _section(np.array(normal), level, space)
        fan = [(0, k, k + 1) for k in range(1, len(section) - 1)]
        if fan:
            ax.plot_trisurf(*section.T, triangles=fan, shade=False, color=PALE, alpha=0.35)


def from_above(ax: Any, obstacles: Obstacles, space: Space, height: float) -> None:
    """Draw obstacles as they are seen from above, and planes where they are cut at a height."""
    for x, y, _, radius in obstacles.spheres:
        ax.add_patch(Circle((x, y), radius, zorder=1, fc=PALE, ec=GREY, lw=0.5))
    for box in obstacles.boxes:
        ax.add_patch(
            Rectangle(tuple(box[:2]), *(box[3:5] - box[:2]), zorder=0.9, fc=PALE, ec=GREY, lw=0.5)
        )
    (x, y), (X, Y) = space.low[:2], space.high[:2]
    u, v = np.meshgrid([x, X], [y, Y])
    for a, b, c, level in obstacles.planes:
        if np.hypot(a, b) > LEVEL:
            ax.contourf(u, v, a * u + b * v + c * height - level, [-np.inf, 0], colors=[PALE])


def _has_volume(points: Float[Array, "*k 3"]) -> bool:
    return bool((np.ptp(points.reshape(-1, 3), axis=0) > 0).all())


def _section(normal: Float[Array, " 3"], level: float, space: Space) -> Float[Array, "corners 3"]:
    """Where a plane cuts the edges of the picture, in order about the middle."""
    found = []
    for axis, ends in product(range(3), product((0, 1), repeat=3)):
        if ends[axis] == 0 and abs(normal[axis]) > LEVEL:
            at = np.where(ends, space.high, space.low)
            at[axis] += (level - normal @ at) / normal[axis]
            if space.low[axis] <= at[axis] <= space.high[axis]:
                found.append(at)
    corners = np.array(found).reshape(-1, 3)
    across, along = np.linalg.svd(np.eye(3) - np.outer(normal, normal))[0][:, :2].T
    away = corners - corners.mean(axis=0) if found else corners
    return corners[np.argsort(np.arctan2(away @ across, away @ along))]
