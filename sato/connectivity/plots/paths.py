"""Where everybody flew, in space and from above [Bernard2023, Fig. 4 and 5]."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Wedge
from matplotlib.patheffects import withStroke

from sato.connectivity.check import Evidence
from sato.connectivity.plots.scenery import from_above, in_space
from sato.plots.look import BLUE, DARK, GREEN, GREY, ORANGE, PALE, PURPLE, RED, SKY
from sato.plots.view import Space, View, letter, set_space

PIECES = 800  # of a path, at most
EVERY = 5.0  # a dot on the path, as in the paper [s]
NAMED = 12  # robots, up to which they are numbered
FEW = 60  # edges, up to which they are as wide as they can be
LONG = 0.9  # a drawn axis [m]
FIELD = 1.6  # radius of a drawn field of view [m]
START: dict[str, Any] = {"ls": "", "marker": "o", "ms": 4.5, "mew": 0.9, "mfc": "white"}
END: dict[str, Any] = {"ls": "", "marker": "o", "ms": 6.5, "mew": 0}
LOST: dict[str, Any] = {"ls": "", "marker": "X", "ms": 7, "mew": 0, "color": RED}
WAYPOINT: dict[str, Any] = {"ls": "", "marker": "*", "ms": 10, "mfc": "none", "mec": PURPLE}
VIEW = View((0, 1, 2), ("x", "y", "z"))


def paths(evidence: Evidence) -> Figure:
    """Paths in space and from above, and the graph and the cameras at the end.

    Of obstacles those are seen that can have pushed somebody, and what else lies that near.
    """
    space = _space(evidence)
    flat = Space(space.low[:2], space.high[:2], space.names[:2])
    figure = Figure(figsize=(10.4, 5.4))  # what a layout takes a view of space for is not its size
    deep: Any = figure.add_axes((0.0, 0.13, 0.54, 0.85), projection="3d", computed_zorder=False)
    above = figure.add_axes((0.61, 0.2, 0.37, 0.73))
    obstacles = evidence.mission.obstacles
    set_space(deep, space)
    deep.set_box_aspect(space.high - space.low, zoom=1.0)
    in_space(deep, obstacles, space)
    set_space(above, flat)
    from_above(above, obstacles, space, float(evidence.position[-1, :, 2].mean()))
    _fields(above, evidence)
    for ax, axes in ((deep, [0, 1, 2]), (above, [0, 1])):
        _fly(ax, evidence, axes)
        _join(ax, evidence, axes)
    _number(above, evidence)
    deep.set_title(f"{letter(0)} {evidence.time[-1]:g} s of flight", y=0.98)
    above.set_title(f"{letter(1)} from above")
    figure.legend(handles=_key(evidence), loc="lower center", ncols=6)
    return figure


def _space(evidence: Evidence) -> Space:
    obstacles, between = evidence.mission.obstacles, evidence.mission.repulsion
    points = [evidence.position, evidence.mission.stick.waypoints]
    margin = between.farthest if obstacles.total else FIELD
    return Space.around(VIEW, *points, margin=margin)


def _fly(ax: Any, evidence: Evidence, axes: list[int]) -> None:
    alive, last = evidence.alive, len(evidence.time) - 1
    kept = np.unique(np.linspace(0, last, min(last + 1, PIECES)).astype(int))
    there = np.where(alive[..., None], evidence.position, np.nan)[..., axes]
    dots = np.flatnonzero(np.diff(evidence.time // EVERY, prepend=0))
    for i in reversed(range(evidence.mission.agents)):
        colour, width, z = (ORANGE, 2.0, 4) if i == 0 else (BLUE, 0.9, 3)
        end = int(np.flatnonzero(alive[:, i]).max(initial=0))
        ax.plot(*there[kept, i].T, color=colour, lw=width, zorder=z)
        ax.plot(*there[dots, i].T, ".", ms=4 + 2 * width, mew=0, color=colour, zorder=z)
        ax.plot(*there[:1, i].T, **START, mec=colour, zorder=z + 2)
        look = {**END, "color": colour} if alive[last, i] else LOST
        ax.plot(*evidence.position[[end], i][:, axes].T, **look, zorder=z + 3)
    ways = evidence.mission.stick.waypoints[:, axes]
    ax.plot(*ways.T, **WAYPOINT, zorder=5)


def _join(ax: Any, evidence: Evidence, axes: list[int]) -> None:
    """The edges and the axes at the end."""
    alive, weight = evidence.alive[-1], evidence.weight[-1]
    end = evidence.position[-1][:, axes]
    pairs = np.argwhere(np.triu(weight) > 0)
    finer = np.clip(FEW / max(len(pairs), 1), 0.3, 1.0)
    for i, j in pairs:
        width = finer * (0.3 + 1.1 * weight[i, j])
        ax.plot(*end[[i, j]].T, color=GREEN, lw=width, zorder=2)
    body = evidence.yaw[-1]
    camera = body + np.arctan2(*evidence.mission.camera.axis[1::-1])
    for turn, colour in ((body, DARK), (camera, RED)):
        ways = np.stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))], axis=1)[:, axes]
        for i in np.flatnonzero(alive):
            ax.plot(*np.array([end[i], end[i] + LONG * ways[i]]).T, color=colour, lw=1.2, zorder=6)


def _fields(ax: Any, evidence: Evidence) -> None:
    """What each camera sees at its own height: the slice of a cone."""
    x, y, _ = evidence.mission.camera.axis
    level = np.hypot(x, y)
    if level <= abs(evidence.mission.camera.a_min):
        return  # it looks up or down, and sees all about or nothing
    half = np.degrees(np.arccos(evidence.mission.camera.a_min / level))
    for i in np.flatnonzero(evidence.alive[-1]):
        middle = np.degrees(evidence.yaw[-1, i] + np.arctan2(y, x))
        at = tuple(evidence.position[-1, i, :2])
        ax.add_patch(Wedge(at, FIELD, middle - half, middle + half, fc=SKY, alpha=0.25, lw=0))


def _number(ax: Any, evidence: Evidence) -> None:
    if evidence.mission.agents > NAMED:
        return
    for i, at in enumerate(evidence.position[-1, :, :2]):
        ax.annotate(
            str(i),
            at,
            xytext=(5, -10),
            textcoords="offset points",
            fontsize=8,
            color=DARK,
            zorder=8,
            path_effects=[withStroke(linewidth=2, foreground="white")],
        )


def _key(evidence: Evidence) -> list[Any]:
    key: list[Any] = [
        Line2D([], [], color=ORANGE, lw=2.0, label="leader"),
        Line2D(
            [], [], color=BLUE, lw=0.9, marker=".", ms=5.8, label=f"another, dots every {EVERY:g} s"
        ),
        Line2D([], [], **START, mec=DARK, label="start"),
        Line2D([], [], **END, color=DARK, label="end"),
        Line2D([], [], color=GREEN, lw=1.2, label="edge at the end, wider weighs more"),
        Line2D([], [], color=DARK, lw=1.2, label="x of the body"),
        Line2D([], [], color=RED, lw=1.2, label="optical axis"),
        Patch(fc=SKY, alpha=0.25, lw=0, label="field of view"),
    ]
    if len(evidence.mission.stick.waypoints):
        key.append(Line2D([], [], **WAYPOINT, label="waypoint"))
    if not evidence.alive[-1].all():
        key.append(Line2D([], [], **LOST, label="lost here"))
    if evidence.mission.obstacles.total:
        key.append(Patch(fc=PALE, ec=GREY, lw=0.5, label="obstacle"))
    return key
