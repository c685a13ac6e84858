"""Trajectories at the end of each leg [Lusk2020, Fig. 5], and the frames that vehicles keep."""

from math import ceil
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy import ndarray as Array

from problems.alignment import align, compute_shape_error
from problems.desired_formation import DesiredFormation
from sato.figures import panels
from sato.figures.axes import AxisBounds, add_legend, add_titles
from sato.figures.style import BLUE, DARK_GRAY, GRAY, LIGHT_GRAY, ORANGE, RED, SKY
from sato.formation.check.promises import check_separation
from sato.formation.check.recorded import FormationLegRecord, FormationRecord
from sato.formation.figures.time_series import (
    VEHICLE_DIAMETER,
    formation_name,
    is_leg_active,
    subsample,
)

SHOWN_TIME = 40.0  # at the end of a leg [s]
MAX_PIECES = 300  # of a trace
MAX_DRAWN_EDGES = 60  # up to which edges are drawn
MARGIN = 1.0  # around agents and points [m]
MAX_COLUMNS = 3
PANEL_WIDTHS = {1: 6.6, 2: 4.4, 3: 3.4}  # by the number of columns [in]
MAX_ROW_HEIGHT = 6.5  # of a panel and the one below [in]
TOP, SIDE = (0, 1), (0, 2)  # axes of the two views
AXIS_LENGTH = 0.3  # of a drawn axis of a frame, relative to the mean spacing


class LegScene(NamedTuple):
    """End of a leg, in the axes of its formation."""

    title: str
    formation: DesiredFormation
    path: Float[Array, "instants agents 3"]  # [m]
    missed: Float[Array, "agents 3"]  # points of the agents; none where the leg converged [m]
    reassignment_positions: Float[Array, "changes 3"]  # at new assignments under way [m]
    is_avoiding: Bool[Array, " agents"]  # at the end
    bounds: AxisBounds
    close: Float[Array, "agents 3"]  # where two come too near; none where they do not [m]


def plot_paths(record: FormationRecord, shown_time: float = SHOWN_TIME) -> Figure:
    """Plot the last 40 s of each leg from above, and from the side unless all are flat.

    All panels have one scale, in which vehicles are to scale too. Each leg is drawn in the
    axes of its formation, aligned with the vehicles at the end. A leg that did not converge has
    lines from its vehicles to their points.
    """
    last = len(record.time) - 1
    legs = record.replay.legs or (FormationLegRecord(0, 0, last, last, completed=False),)
    scenes = [_make_scene(record, leg, shown_time) for leg in legs]
    views = [TOP] if all(s.formation.is_flat for s in scenes) else [TOP, SIDE]
    size = np.max([s.bounds.size for s in scenes], axis=0)
    size[0] = max(size[0], 0.75 * size[1])
    columns = min(len(scenes), MAX_COLUMNS) if len(scenes) != 4 else 2
    rows, shares = ceil(len(scenes) / columns), [size[b] / size[0] for _, b in views]
    width = min(PANEL_WIDTHS[columns], MAX_ROW_HEIGHT / sum(shares))
    height = rows * (width * sum(shares) + 1.25) + 0.6
    figure = Figure(figsize=(columns * (width + 0.5) + 0.2, height), layout="constrained")
    grid = figure.subplots(rows * len(views), columns, squeeze=False, height_ratios=shares * rows)
    cells = grid.reshape(rows, len(views), columns).swapaxes(1, 2).reshape(-1, len(views))
    for ax in cells[len(scenes) :].flat:
        ax.remove()
    for scene, own in zip(scenes, cells, strict=False):
        for ax, view in zip(own, views, strict=True):
            _draw_scene(ax, scene, view, size)
    add_titles(cells[:, 0], [scene.title for scene in scenes])
    disc: dict[str, Any] = {"ls": "", "marker": "o", "ms": 5, "mew": 0}
    path = f"last {shown_time:g} s, paler is earlier"
    key = [
        Line2D([], [], color=BLUE, lw=1.2, label=path),
        Line2D([], [], **disc, color=DARK_GRAY, label=f"vehicle, {VEHICLE_DIAMETER:g} m wide"),
    ]
    if any(s.is_avoiding.any() for s in scenes):
        key.append(Line2D([], [], **disc, color=ORANGE, label="avoids others at the end"))
    add_legend(figure, *key)
    return figure


def _make_scene(record: FormationRecord, leg: FormationLegRecord, shown_time: float) -> LegScene:
    formation = record.mission.gains[leg.leg].formation
    first = np.searchsorted(record.time, record.time[leg.last_instant] - shown_time)
    window = np.arange(max(leg.first_instant, int(first)), leg.last_instant + 1)
    assignment, position = record.frames.point_index, record.frames.position
    held, end = formation.points[assignment[leg.last_instant]], position[leg.last_instant]
    pose, fit = align(held, end), compute_shape_error(end, held)
    x, y, z = np.moveaxis(position[window] - pose.translation, -1, 0)
    flat = (x + 1j * y) * np.exp(-1j * float(pose.yaw))
    path = np.stack([flat.real, flat.imag, z], axis=-1)
    before = np.maximum(window - 1, leg.first_instant)
    changed = assignment[window] != assignment[before]
    changed &= is_leg_active(record)[before, None]  # not the first assignment
    state = "" if leg.completed else "not converged, "
    name = ", ".join(filter(None, (f"leg {leg.leg + 1}", formation_name(record, leg.leg))))
    degrees = round(float(np.degrees(pose.yaw))) % 360
    turned = f"turned by {degrees}°{', upside down' * fit.inverted}"
    title = f"{name}\n{state}{fit.error:.3f} m off, {turned}"
    is_avoiding = record.frames.avoiding[leg.last_instant]
    kept = path[subsample(len(path), MAX_PIECES)]
    bounds = AxisBounds.enclosing(("x", "y", "z"), kept, formation.points, margin=MARGIN)
    missed = held if not leg.completed else held[:0]
    near, k = record.closest_approach, record.closest_approach.instant - int(window[0])
    is_close = not check_separation(record).kept and 0 <= k < len(path)
    close = path[k, list(near.pair)] if is_close else path[0, :0]
    return LegScene(title, formation, kept, missed, path[changed], is_avoiding, bounds, close)


def _draw_scene(ax: Any, scene: LegScene, view: tuple[int, int], size: Float[Array, " 3"]) -> None:
    points, path = scene.formation.points[:, view], scene.path[..., view]
    pairs = np.argwhere(np.triu(scene.formation.graph))
    if len(pairs) <= MAX_DRAWN_EDGES:
        edges: dict[str, Any] = {"colors": LIGHT_GRAY, "lw": 0.6, "zorder": 1, "label": "neighbors"}
        ax.add_collection(LineCollection(list(points[pairs]), **edges))
    ax.plot(*points.T, "+", ms=4.7, mew=0.7, color=GRAY, zorder=1.2, label="point of the formation")
    ax.add_collection(_fading_paths(path))
    if len(scene.close):
        panels.mark_broken(ax, 1.0, scene.close[:, view], "separation")
    if len(scene.missed):
        ways: dict[str, Any] = {"colors": RED, "lw": 0.8, "ls": ":", "label": "to its own point"}
        ends = np.stack([path[-1], scene.missed[:, view]], axis=1)
        ax.add_collection(LineCollection(list(ends), zorder=2.5, **ways))
    colors = np.where(scene.is_avoiding, ORANGE, DARK_GRAY)
    if view == SIDE:
        half = np.array([VEHICLE_DIAMETER / 2, 0.0])
        edge_on = np.stack([path[-1] - half, path[-1] + half], axis=1)
        ax.add_collection(LineCollection(list(edge_on), colors=colors, lw=2.4, zorder=4))
    else:
        if len(scene.reassignment_positions):
            ring = {"ms": 2.2, "mew": 0.6, "mfc": "white", "mec": RED, "zorder": 3}
            rings = scene.reassignment_positions[:, view].T
            ax.plot(*rings, "o", **ring, label="assigned another point here")
        wide = np.full(len(colors), VEHICLE_DIAMETER)
        discs = EllipseCollection(wide, wide, 0 * wide, units="xy", offsets=path[-1], zorder=4,
                                  offset_transform=ax.transData, facecolors=colors)  # fmt: skip
        ax.add_collection(discs)
    middle = (scene.bounds.low + scene.bounds.high) / 2
    low, high = middle - size / 2, middle + size / 2
    a, b = view
    ax.set(xlim=(low[a], high[a]), ylim=(low[b], high[b]), aspect="equal")
    ax.set(xlabel=f"{'xyz'[a]} [m]", ylabel=f"{'xyz'[b]} [m]")


def _fading_paths(path: Float[Array, "k agents 2"]) -> LineCollection:
    # Pieces in the order of time, so that later ones lie above earlier ones.
    pieces = np.stack([path[:-1], path[1:]], axis=2).reshape(-1, 2, 2)
    age = np.linspace(1, 0, len(path))[1:, None]
    colors = np.repeat(1 - (1 - 0.8 * age**2) * (1 - np.array(to_rgb(BLUE))), path.shape[1], axis=0)
    return LineCollection(list(pieces), colors=colors, lw=0.9, zorder=2)


def plot_coordinate_frames(record: FormationRecord) -> Figure:
    """Plot the pose of each agent's frame, and its odometry drift over time [Lusk2020, Fig. 2]."""
    figure = Figure(figsize=(8.6, 3.9), layout="constrained")
    poses, drift = figure.subplots(1, 2, width_ratios=(1, 1.35))
    frames, start = record.mission.coordinate_frames, record.mission.initial_positions[:, :2]
    origin = frames.origin[:, :2]
    extent = np.ptp(np.concatenate([origin, start]), axis=0).max()
    length = AXIS_LENGTH * max(float(extent), 1.0) / len(start) ** 0.5
    poses.plot(*start.T, "o", ms=3, color=GRAY, mew=0, alpha=0.6, label="vehicle at the start")
    for turn, color, name in ((1, BLUE, "x"), (1j, ORANGE, "y")):
        way = length * turn * frames.rotation
        ends = np.stack([origin, origin + np.stack([way.real, way.imag], axis=1)], axis=2)
        poses.plot(*ends.transpose(1, 2, 0), color=color, lw=1.2, label=f"{name} of a frame")
    poses.margins(0.06)
    poses.set_aspect("equal", adjustable="datalim")
    poses.set(xlabel="x [m]", ylabel="y [m]")
    far = 100 * np.linalg.norm(record.frames.frame_drift, axis=2)
    drift.plot(record.time, far, color=SKY, lw=0.6, alpha=0.8, label="a vehicle")
    drift.plot(record.time, np.median(far, axis=1), color=BLUE, lw=1.8, label="median")
    panels.set_time_axis(drift, record.time)
    drift.set(ylabel="drift [cm]", ylim=(0, max(1.05 * float(far.max()), 1.0)))
    noise = f"odometry drift; noise {100 * record.mission.frames.noise:g} cm on top"
    add_titles((poses, drift), ["frames and starts", noise], loc="left")
    add_legend(figure)
    return figure
