"""Trajectories in space and from above [Bernard2023, Fig. 4 and 5]."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Wedge
from matplotlib.patheffects import withStroke

from sato.connectivity.check import ConnectivityRecord
from sato.connectivity.figures.obstacles import draw_obstacles_3d, draw_obstacles_from_above
from sato.figures.axes import AxisBounds, Projection, panel_letter, set_axis_bounds
from sato.figures.style import BLUE, DARK_GRAY, GRAY, GREEN, LIGHT_GRAY, ORANGE, PURPLE, RED, SKY

MAX_POINTS = 800  # per trajectory, at most
DOT_INTERVAL = 5.0  # between dots on a trajectory, as in the paper [s]
MAX_LABELED_AGENTS = 12  # largest number of robots that are labeled
FULL_WIDTH_EDGES = 60  # largest number of edges drawn at full width
BODY_AXIS_LENGTH = 0.9  # [m]
FIELD_OF_VIEW_RADIUS = 1.6  # [m]
START_STYLE: dict[str, Any] = {"ls": "", "marker": "o", "ms": 4.5, "mew": 0.9, "mfc": "white"}
END_STYLE: dict[str, Any] = {"ls": "", "marker": "o", "ms": 6.5, "mew": 0}
LOST_STYLE: dict[str, Any] = {"ls": "", "marker": "X", "ms": 7, "mew": 0, "color": RED}
WAYPOINT_STYLE: dict[str, Any] = {"ls": "", "marker": "*", "ms": 10, "mfc": "none", "mec": PURPLE}
VIEW = Projection((0, 1, 2), ("x", "y", "z"))


def plot_trajectories(record: ConnectivityRecord) -> Figure:
    """Plot trajectories in space and from above, with the graph and the cameras at the end.

    The bounds show all obstacles that were close enough to repel a robot.
    """
    space = _picture_bounds(record)
    flat = AxisBounds(space.low[:2], space.high[:2], space.labels[:2])
    figure = Figure(figsize=(10.4, 5.4))  # automatic layouts misjudge the size of 3D axes
    deep: Any = figure.add_axes((0.0, 0.13, 0.54, 0.85), projection="3d", computed_zorder=False)
    above = figure.add_axes((0.61, 0.2, 0.37, 0.73))
    obstacles = record.mission.obstacle_arrays
    set_axis_bounds(deep, space)
    deep.set_box_aspect(space.high - space.low, zoom=1.0)
    draw_obstacles_3d(deep, obstacles, space)
    set_axis_bounds(above, flat)
    draw_obstacles_from_above(
        above, obstacles, space, float(record.frames.position[-1, :, 2].mean())
    )
    _draw_fields_of_view(above, record)
    for ax, axes in ((deep, [0, 1, 2]), (above, [0, 1])):
        _draw_trajectories(ax, record, axes)
        _draw_edges(ax, record, axes)
    _label_agents(above, record)
    deep.set_title(f"{panel_letter(0)} {record.frames.time[-1]:g} s of flight", y=0.98)
    above.set_title(f"{panel_letter(1)} from above")
    figure.legend(handles=_legend_handles(record), loc="lower center", ncols=6)
    return figure


def _picture_bounds(record: ConnectivityRecord) -> AxisBounds:
    obstacles, between = record.mission.obstacle_arrays, record.mission.repulsion
    points = [record.frames.position, record.mission.stick.waypoints]
    margin = between.max_distance if obstacles.total else FIELD_OF_VIEW_RADIUS
    return AxisBounds.enclosing(VIEW, *points, margin=margin)


def _draw_trajectories(ax: Any, record: ConnectivityRecord, axes: list[int]) -> None:
    alive, last = record.frames.alive, len(record.frames.time) - 1
    kept = np.unique(np.linspace(0, last, min(last + 1, MAX_POINTS)).astype(int))
    there = np.where(alive[..., None], record.frames.position, np.nan)[..., axes]
    dots = np.flatnonzero(np.diff(record.frames.time // DOT_INTERVAL, prepend=0))
    for i in reversed(range(record.mission.agents)):
        color, width, z = (ORANGE, 2.0, 4) if i == 0 else (BLUE, 0.9, 3)
        end = int(np.flatnonzero(alive[:, i]).max(initial=0))
        ax.plot(*there[kept, i].T, color=color, lw=width, zorder=z)
        ax.plot(*there[dots, i].T, ".", ms=4 + 2 * width, mew=0, color=color, zorder=z)
        ax.plot(*there[:1, i].T, **START_STYLE, mec=color, zorder=z + 2)
        look = {**END_STYLE, "color": color} if alive[last, i] else LOST_STYLE
        ax.plot(*record.frames.position[[end], i][:, axes].T, **look, zorder=z + 3)
    ways = record.mission.stick.waypoints[:, axes]
    ax.plot(*ways.T, **WAYPOINT_STYLE, zorder=5)


def _draw_edges(ax: Any, record: ConnectivityRecord, axes: list[int]) -> None:
    """Draw the edges, body axes and optical axes at the end."""
    alive, weight = record.frames.alive[-1], record.frames.edge_weight[-1]
    end = record.frames.position[-1][:, axes]
    pairs = np.argwhere(np.triu(weight) > 0)
    finer = np.clip(FULL_WIDTH_EDGES / max(len(pairs), 1), 0.3, 1.0)
    for i, j in pairs:
        width = finer * (0.3 + 1.1 * weight[i, j])
        ax.plot(*end[[i, j]].T, color=GREEN, lw=width, zorder=2)
    body = record.frames.yaw[-1]
    x, y, _ = record.mission.camera.optical_axis
    camera = body + np.arctan2(y, x)
    for turn, color in ((body, DARK_GRAY), (camera, RED)):
        ways = np.stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))], axis=1)[:, axes]
        for i in np.flatnonzero(alive):
            ax.plot(
                *np.array([end[i], end[i] + BODY_AXIS_LENGTH * ways[i]]).T,
                color=color,
                lw=1.2,
                zorder=6,
            )


def _draw_fields_of_view(ax: Any, record: ConnectivityRecord) -> None:
    """Draw the section of each field of view at the height of its camera."""
    x, y, _ = record.mission.camera.optical_axis
    level = np.hypot(x, y)
    if level <= abs(record.mission.camera.a_min):
        return  # the cone around a vertical axis has no sector
    half = np.degrees(np.arccos(record.mission.camera.a_min / level))
    for i in np.flatnonzero(record.frames.alive[-1]):
        middle = np.degrees(record.frames.yaw[-1, i] + np.arctan2(y, x))
        at = tuple(record.frames.position[-1, i, :2])
        ax.add_patch(
            Wedge(at, FIELD_OF_VIEW_RADIUS, middle - half, middle + half, fc=SKY, alpha=0.25, lw=0)
        )


def _label_agents(ax: Any, record: ConnectivityRecord) -> None:
    if record.mission.agents > MAX_LABELED_AGENTS:
        return
    for i, at in enumerate(record.frames.position[-1, :, :2]):
        ax.annotate(
            str(i),
            at,
            xytext=(5, -10),
            textcoords="offset points",
            fontsize=8,
            color=DARK_GRAY,
            zorder=8,
            path_effects=[withStroke(linewidth=2, foreground="white")],
        )


def _legend_handles(record: ConnectivityRecord) -> list[Any]:
    key: list[Any] = [
        Line2D([], [], color=ORANGE, lw=2.0, label="leader"),
        Line2D(
            [],
            [],
            color=BLUE,
            lw=0.9,
            marker=".",
            ms=5.8,
            label=f"another, dots every {DOT_INTERVAL:g} s",
        ),
        Line2D([], [], **START_STYLE, mec=DARK_GRAY, label="start"),
        Line2D([], [], **END_STYLE, color=DARK_GRAY, label="end"),
        Line2D([], [], color=GREEN, lw=1.2, label="edge at the end, wider weighs more"),
        Line2D([], [], color=DARK_GRAY, lw=1.2, label="x of the body"),
        Line2D([], [], color=RED, lw=1.2, label="optical axis"),
        Patch(fc=SKY, alpha=0.25, lw=0, label="field of view"),
    ]
    if len(record.mission.stick.waypoints):
        key.append(Line2D([], [], **WAYPOINT_STYLE, label="waypoint"))
    if not record.frames.alive[-1].all():
        key.append(Line2D([], [], **LOST_STYLE, label="lost here"))
    if record.mission.obstacle_arrays.total:
        key.append(Patch(fc=LIGHT_GRAY, ec=GRAY, lw=0.5, label="obstacle"))
    return key
