"""Snapshots of a swarm, with agents marked by their component."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from matplotlib.collections import EllipseCollection
from matplotlib.lines import Line2D
from numpy import ndarray as Array

from sato.figures.axes import AxisBounds
from sato.figures.style import ISOLATED, LIGHT_GRAY, component_legend, style_components


class Snapshot(NamedTuple):
    """Swarm at an instant, in projected coordinates."""

    title: str
    position: Float[Array, "agents d"]  # [m]
    component: Int[Array, " agents"]  # −1 while not alive
    targets: Float[Array, "targets d"]  # [m]


def draw_swarm(
    ax: Any,
    shot: Snapshot,
    space: AxisBounds,
    radius: float | None = None,
    size: float = 14.0,
    target_rings: bool = False,
) -> None:
    """Draw agents marked by component, and targets as light crosses.

    Args:
        ax: Axes to draw on.
        shot: Swarm to draw.
        space: Bounds of the axes.
        radius: Radius of circles about the agents [m], or None for no circles.
        size: Size of the marks [points²].
        target_rings: Draw targets as light rings, which an agent fills on arrival.
    """
    scale, _ = space.unit
    goals = shot.targets / scale
    depth = {} if space.axes == 2 else {"depthshade": False}
    if target_rings:
        ax.scatter(*goals.T, s=size * 3, lw=0.7, fc="none", ec=LIGHT_GRAY, zorder=1, **depth)
    else:
        ax.scatter(*goals.T, marker="x", s=size * 0.8, lw=0.6, color=LIGHT_GRAY, zorder=1, **depth)
    for members, look in style_components(shot.component):
        at = shot.position[members] / scale
        if radius is not None and space.axes == 2:
            wide = np.full(len(at), 2 * radius / scale)
            circles = EllipseCollection(
                wide,
                wide,
                0 * wide,
                units="xy",
                offsets=at,
                offset_transform=ax.transData,
                facecolors="none",
                edgecolors=look.color,
                linestyles=":",
                linewidths=0.5,
                alpha=0.45,
                zorder=2,
            )
            ax.add_collection(circles)
        s = size * 0.6 if look is ISOLATED else size
        s = s * 1.7 if look.marker == "*" else s  # which fills little of its square
        ax.scatter(*at.T, marker=look.marker, s=s, color=look.color, lw=0, zorder=3, **depth)


def snapshots_legend(shots: list[Snapshot]) -> list[Line2D]:
    """Return legend entries of the components in any of the snapshots."""
    groups = [style_components(s.component) for s in shots]
    ranks = max(sum(look is not ISOLATED for _, look in g) for g in groups)
    return component_legend(ranks, any(look is ISOLATED for g in groups for _, look in g))
