"""A swarm at an instant: agents marked by the component that they are in."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from matplotlib.collections import EllipseCollection
from matplotlib.lines import Line2D
from numpy import ndarray as Array

from sato.plots.look import ALONE, PALE, key_of, marked
from sato.plots.view import Space


class Snapshot(NamedTuple):
    """The swarm at an instant, in the coordinates that are shown."""

    title: str
    position: Float[Array, "agents d"]  # [m]
    component: Int[Array, " agents"]  # −1 while not alive
    goals: Float[Array, "targets d"]  # [m]


def draw_swarm(
    ax: Any,
    shot: Snapshot,
    space: Space,
    radius: float | None = None,
    size: float = 14.0,
    rings: bool = False,
) -> None:
    """Agents marked by component, and targets as light crosses.

    Args:
        ax: Where to draw.
        shot: What is drawn.
        space: What of space the axes show.
        radius: Of circles about the agents, if there are any [m].
        size: Of the marks.
        rings: Light rings for targets, which an agent fills when it is there.
    """
    scale, _ = space.unit
    goals = shot.goals / scale
    depth = {} if space.axes == 2 else {"depthshade": False}
    if rings:
        ax.scatter(*goals.T, s=size * 3, lw=0.7, fc="none", ec=PALE, zorder=1, **depth)
    else:
        ax.scatter(*goals.T, marker="x", s=size * 0.8, lw=0.6, color=PALE, zorder=1, **depth)
    for members, look in marked(shot.component):
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
                edgecolors=look.colour,
                linestyles=":",
                linewidths=0.5,
                alpha=0.45,
                zorder=2,
            )
            ax.add_collection(circles)
        s = size * 0.6 if look is ALONE else size
        s = s * 1.7 if look.shape == "*" else s  # which fills little of its square
        ax.scatter(*at.T, marker=look.shape, s=s, color=look.colour, lw=0, zorder=3, **depth)


def key_of_components(shots: list[Snapshot]) -> list[Line2D]:
    """Legend entries of the components that are seen in any of the snapshots."""
    groups = [marked(s.component) for s in shots]
    ranks = max(sum(look is not ALONE for _, look in g) for g in groups)
    return key_of(ranks, any(look is ALONE for g in groups for _, look in g))
