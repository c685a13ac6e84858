"""Trajectories in space and from above, among obstacles [Bernard2023, Fig. 4 and 5]."""

from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Patch, Rectangle, Wedge
from matplotlib.ticker import MaxNLocator
from numpy import ndarray as Array

from sato.connectivity.check.promises import check_distances
from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.obstacles import Obstacles
from sato.figures.axes import AxisBounds, add_axes, add_legend, add_titles, draw_ends, draw_paths
from sato.figures.panels import mark_broken
from sato.figures.style import BLUE, DARK_GRAY, GRAY, GREEN, LIGHT_GRAY, ORANGE, PURPLE, RED, SKY

DOT_INTERVAL = 5.0  # between dots on a trajectory, as in the paper [s]
LONG_ASPECT = 0.6  # height over width, seen from above, below which a flight is long
MAX_LABELED_AGENTS = 12  # largest number of robots that are labeled
FULL_WIDTH_EDGES = 60  # largest number of edges drawn at full width
BODY_AXIS_LENGTH = 0.9  # [m]
FIELD_OF_VIEW_RADIUS = 1.6  # [m]
HORIZONTAL_TOLERANCE = 1e-9  # of a normal: its horizontal part, below which the plane is a floor
OBSTACLE_STYLE: dict[str, Any] = {"fc": LIGHT_GRAY, "ec": GRAY, "lw": 0.5}


def plot_trajectories(record: ConnectivityRecord) -> Figure:
    """Plot trajectories in space and from above, with the graph and the cameras at the end.

    The bounds show all obstacles that were close enough to repel a robot.
    """
    frames, mission, obstacles = record.frames, record.mission, record.mission.obstacle_arrays
    margin = mission.repulsion.max_distance if obstacles.total else FIELD_OF_VIEW_RADIUS
    points = frames.position, mission.stick.waypoints
    space = enclose_obstacles(
        AxisBounds.enclosing(("x", "y", "z"), *points, margin=margin), obstacles
    )
    flat = AxisBounds(space.low[:2], space.high[:2], space.labels[:2])
    is_long = flat.aspect < LONG_ASPECT  # the two views are then one above the other
    rows, columns = (2, 1) if is_long else (1, 2)
    figure = Figure(figsize=(8.2, 7.4) if is_long else (8.8, 4.6))
    figure.set_layout_engine("constrained", wspace=0.15, h_pad=0.1)
    cells = (rows, columns, 1), (rows, columns, 2)
    deep, above = add_axes(figure, space, cells[0]), add_axes(figure, flat, cells[1])
    deep.computed_zorder = False
    deep.set_box_aspect(space.size, zoom=1.9 if is_long else 1.25)
    deep.zaxis.set_major_locator(MaxNLocator(3))  # a route is long and flat
    for axis in (deep.yaxis, deep.zaxis) if is_long else ():
        axis.labelpad = -8  # the distance of a label grows with the enlargement
    draw_obstacles_3d(deep, obstacles, space)
    height = float(frames.position[-1, :, 2].mean())
    draw_obstacles_above(above, obstacles, space, height)
    _draw_fields_of_view(above, record)
    for ax, bounds in ((deep, space), (above, flat)):
        _draw_trajectories(ax, record, bounds)
        _draw_graph(ax, record, bounds)
    for drawn in (*deep.lines, *deep.collections):  # a view that is enlarged leaves its frame
        drawn.set(clip_on=False, in_layout=False)
    for i in range(mission.agents if mission.agents <= MAX_LABELED_AGENTS else 0):
        at = frames.position[-1, i, :2]
        above.annotate(str(i), at, xytext=(5, -10), textcoords="offset points", zorder=8)
    add_titles((deep, above), [f"{frames.time[-1]:g} s of flight", "from above"])
    add_legend(figure, *([Patch(**OBSTACLE_STYLE, label="obstacle")] if obstacles.total else []))
    return figure


def enclose_obstacles(space: AxisBounds, obstacles: Obstacles) -> AxisBounds:
    """Widen bounds in the plane to show whole each sphere that they cut."""
    center, radius = obstacles.spheres[:, :3], obstacles.spheres[:, 3:]
    low, high = center - radius, center + radius
    cut = ((low < space.high) & (high > space.low)).all(axis=1)
    low, high = np.vstack([space.low, low[cut]]), np.vstack([space.high, high[cut]])
    plane = np.array([True, True, False])
    return space._replace(
        low=np.where(plane, low.min(axis=0), space.low),
        high=np.where(plane, high.max(axis=0), space.high),
    )


def _draw_trajectories(ax: Any, record: ConnectivityRecord, space: AxisBounds) -> None:
    frames, axes = record.frames, len(space.low)
    place = frames.position[..., :axes]
    path = np.where(frames.alive[..., None], place, np.nan)
    dots = np.flatnonzero(np.diff(frames.time // DOT_INTERVAL, prepend=0))
    draw_paths(ax, space, path[:, 1:], BLUE, zorder=3, label="another robot")
    draw_paths(ax, space, path[:, :1], ORANGE, lw=2.0, zorder=3, label="leader")
    name = f"every {DOT_INTERVAL:g} s"
    ax.plot(*path[dots].reshape(-1, axes).T, ".", color=DARK_GRAY, ms=3, zorder=4, label=name)
    draw_ends(ax, space, path[:, 1:], BLUE, ms=5.5)
    draw_ends(ax, space, path[:, :1], ORANGE, ms=5.5)
    lost = place[-1, ~frames.alive[-1]].T
    if lost.size:
        ax.plot(*lost, "X", ms=7, mew=0, color=RED, zorder=7, label="lost here")
    for promise in check_distances(record):
        if not promise.kept and promise.time is not None:
            k = int(np.searchsorted(frames.time, promise.time))
            mark_broken(ax, space.unit[0], place[k, list(promise.agents)], promise.name)
    ways = record.mission.stick.waypoints[:, :axes].T
    if ways.size:
        ax.plot(*ways, "*", ms=10, mfc="none", mec=PURPLE, zorder=5, label="waypoint")


def _draw_graph(ax: Any, record: ConnectivityRecord, space: AxisBounds) -> None:
    """Draw the edges, body axes and optical axes at the end."""
    alive, weight = record.frames.alive[-1], record.frames.edge_weight[-1]
    end = record.frames.position[-1, :, : len(space.low)]
    pairs = np.argwhere(np.triu(weight) > 0).T
    finer = np.clip(FULL_WIDTH_EDGES / max(pairs.shape[1], 1), 0.3, 1.0)
    if pairs.size:
        widths, name = finer * (0.3 + 1.1 * weight[*pairs]), "edge at the end, wider weighs more"
        draw_paths(ax, space, end[pairs], GREEN, lw=widths, zorder=2, label=name)
    body = record.frames.yaw[-1]
    x, y, _ = record.mission.camera.optical_axis
    camera = body + np.arctan2(y, x)
    for turn, color, name in ((body, DARK_GRAY, "x of the body"), (camera, RED, "optical axis")):
        ways = np.stack([np.cos(turn), np.sin(turn), np.zeros(len(turn))], axis=1)
        tips = end + BODY_AXIS_LENGTH * ways[:, : len(space.low)]
        draw_paths(ax, space, np.stack([end, tips])[:, alive], color, lw=1.2, zorder=6, label=name)


def _draw_fields_of_view(ax: Any, record: ConnectivityRecord) -> None:
    """Draw the section of each field of view at the height of its camera."""
    x, y, _ = record.mission.camera.optical_axis
    level = np.hypot(x, y)
    if level <= abs(record.mission.camera.a_min):
        return  # the cone around a vertical axis has no sector
    half = np.degrees(np.arccos(record.mission.camera.a_min / level))
    style: dict[str, Any] = {"fc": SKY, "alpha": 0.25, "lw": 0, "label": "field of view"}
    for i in np.flatnonzero(record.frames.alive[-1]):
        middle = np.degrees(record.frames.yaw[-1, i] + np.arctan2(y, x))
        at = tuple(record.frames.position[-1, i, :2])
        ax.add_patch(Wedge(at, FIELD_OF_VIEW_RADIUS, middle - half, middle + half, **style))


def draw_obstacles_3d(ax: Any, obstacles: Obstacles, space: AxisBounds) -> None:
    """Draw obstacles in three dimensions, clipped to the bounds of the axes."""
    turn, rise = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    ball = np.stack([np.cos(turn) * np.sin(rise), np.sin(turn) * np.sin(rise), np.cos(rise)], -1)
    for *center, radius in obstacles.spheres:
        shown = np.clip(np.array(center) + radius * ball, space.low, space.high)
        if np.ptp(shown, axis=(0, 1)).all():
            x, y, z = np.moveaxis(shown, -1, 0)
            ax.plot_surface(x, y, z, shade=False, color=LIGHT_GRAY, ec=GRAY, lw=0.15)
    for box in obstacles.boxes:
        shown = np.clip(box.reshape(2, 3), space.low, space.high)
        if np.ptp(shown, axis=0).all():
            style = {"color": LIGHT_GRAY, "edgecolor": GRAY, "lw": 0.5, "alpha": 0.35}
            ax.bar3d(*shown[0], *np.ptp(shown, axis=0), shade=False, **style)
    for *normal, level in obstacles.planes:
        section = _plane_section(np.array(normal), level, space)
        fan = [(0, k, k + 1) for k in range(1, len(section) - 1)]
        if fan:
            ax.plot_trisurf(*section.T, triangles=fan, shade=False, color=LIGHT_GRAY, alpha=0.35)


def draw_obstacles_above(ax: Any, obstacles: Obstacles, space: AxisBounds, height: float) -> None:
    """Draw obstacles from above, and the sections of planes at a height."""
    for x, y, _, radius in obstacles.spheres:
        ax.add_patch(Circle((x, y), radius, zorder=1, **OBSTACLE_STYLE))
    for box in obstacles.boxes:
        size = box[3:5] - box[:2]
        ax.add_patch(Rectangle(tuple(box[:2]), *size, zorder=0.9, **OBSTACLE_STYLE))
    (x, y), (X, Y) = space.low[:2], space.high[:2]
    u, v = np.meshgrid([x, X], [y, Y])
    for a, b, c, level in obstacles.planes:
        if np.hypot(a, b) > HORIZONTAL_TOLERANCE:
            ax.contourf(u, v, a * u + b * v + c * height - level, [-np.inf, 0], colors=[LIGHT_GRAY])


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
