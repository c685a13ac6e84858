"""Swarm about its chief: snapshots of each leg, and trajectories in space."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]
from numpy import ndarray as Array

from dynamics.trajectory_geometry import control_points, evaluate_bezier
from sato.figures.axes import (
    THREE_AXES,
    AxisBounds,
    make_panels,
    panel_letter,
    set_axis_bounds,
    set_panel_title,
)
from sato.figures.snapshot import draw_swarm, snapshots_legend
from sato.figures.style import BLUE, DARK_GRAY, GRAY, LIGHT_GRAY, RED
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.figures.snapshots import (
    all_used_targets,
    begun_legs,
    endpoint_legend,
    make_snapshot,
    plot_margin,
    read_leg_names,
    select_view,
)

SNAPSHOT_FRACTIONS = (0, 1 / 3, 2 / 3, 1)  # of a leg
TRAIL_FRACTION = 1 / 6  # of a leg: length of the trails
POINTS_PER_STEP = 6  # of the trajectory
MIN_DEPTH_RATIO = 0.4  # least size of an axis, relative to the largest
TRAIL_COLOR, PROJECTION_COLOR = "#9fb4c2", "#d9d9d9"
CHIEF_MARKER: dict[str, Any] = {"ls": "", "marker": "+", "color": DARK_GRAY, "mew": 0.9}


def plot_instants(record: ReconfigurationRecord) -> Figure:
    """Plot the swarm at the start, thirds and end of each leg [Morgan2016, Fig. 6]."""
    legs, view, names = begun_legs(record), select_view(record), read_leg_names(record)
    path = view.project(interpolate_positions(record))
    space = AxisBounds.enclosing(view, path, *all_used_targets(record), margin=plot_margin(record))
    many = len(legs) > 1
    size = float(np.clip(900 / len(path[0]), 5, 15))  # of the markers, smaller for many agents
    columns = len(SNAPSHOT_FRACTIONS)
    figure, axes = make_panels(columns * len(legs), space, columns, 2.6 if many else 3.4)
    snapshots = []
    for i, ax in enumerate(axes):
        leg, share = legs[i // columns], SNAPSHOT_FRACTIONS[i % columns]
        k = leg.start_index + round(leg.step_count * share)
        since = max(leg.start_index, k - _trail_steps(leg))
        snapshot = make_snapshot(record, leg, k, view.format_time(record.time[k]))
        _draw_trails(ax, path[since * POINTS_PER_STEP : k * POINTS_PER_STEP + 1] / space.unit[0])
        ax.plot(0, 0, ms=5, zorder=1, **CHIEF_MARKER)
        draw_swarm(ax, snapshot, space, size=size, target_rings=True)
        set_panel_title(
            ax, f"{panel_letter(i)} {snapshot.title}" + many * f", {names[leg.leg_index]}"
        )
        snapshots.append(snapshot)
    trail = "recent trajectory" if many else _trail_label(record, legs[0])
    key = [
        *snapshots_legend(snapshots),
        Line2D([], [], ls="", marker="o", ms=6, mfc="none", mec=LIGHT_GRAY, label="target"),
        Line2D([], [], color=TRAIL_COLOR, lw=1, label=trail),
        Line2D([], [], ms=6, label="chief", **CHIEF_MARKER),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=6)
    return figure


def plot_space(record: ReconfigurationRecord) -> Figure:
    """Plot all trajectories about the chief, and their projections on its orbital plane."""
    path = interpolate_positions(record)
    room = _deepen_axes(
        AxisBounds.enclosing(THREE_AXES, path, np.zeros((1, 3)), margin=plot_margin(record))
    )
    figure = Figure(figsize=(6.6, 5.4))
    figure.set_layout_engine("constrained", rect=(0, 0, 0.97, 1))
    ax: Any = figure.add_subplot(projection="3d")
    set_axis_bounds(ax, room)
    ax.set_box_aspect(room.high - room.low, zoom=1.0)
    scale = room.unit[0]
    lines = list(np.moveaxis(path, 1, 0) / scale)
    floor = room.low[2] / scale
    projections = [np.column_stack([line[:, :2], np.full(len(line), floor)]) for line in lines]
    ax.add_collection(Line3DCollection(projections, colors=PROJECTION_COLOR, lw=0.6))
    ax.add_collection(Line3DCollection(lines, colors=BLUE, lw=0.8, alpha=0.7))
    first, last = (np.array([line[k] for line in _drop_missing(lines)]).T for k in (0, -1))
    ax.plot(*first, ls="", marker="o", ms=3.2, mfc="white", mec=GRAY, mew=0.7)
    ax.plot(*last, ls="", marker="o", ms=3.2, color=RED, mew=0)
    ax.plot(0, 0, 0, ms=7, **CHIEF_MARKER)
    ax.view_init(elev=28, azim=-50)
    key = [
        Line2D([], [], color=BLUE, lw=1, label="trajectory"),
        Line2D([], [], color=PROJECTION_COLOR, lw=1, label="projection"),
        *endpoint_legend(RED),
        Line2D([], [], ms=6, label="chief", **CHIEF_MARKER),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=5)
    return figure


def interpolate_positions(record: ReconfigurationRecord) -> Float[Array, "instants agents d"]:
    """Interpolate positions at `POINTS_PER_STEP` instants a step; NaN where not alive."""
    x = np.moveaxis(record.position, 0, 1), np.moveaxis(record.velocity, 0, 1)
    pieces = np.moveaxis(control_points(*x, record.mission.step), 0, 1)
    pieces = np.where(record.alive[:-1, :, None, None], pieces, np.nan)
    parts = np.arange(POINTS_PER_STEP) / POINTS_PER_STEP
    inside = [evaluate_bezier(pieces, np.full(pieces.shape[:2], part)) for part in parts]
    found = np.stack(inside, axis=1).reshape(-1, *record.position.shape[1:])
    last = np.where(record.alive[-1, :, None], record.position[-1], np.nan)
    return np.concatenate([found, last[None]])


def _draw_trails(ax: Any, path: Float[Array, "instants agents d"]) -> None:
    lines = list(np.moveaxis(path, 1, 0))
    ax.add_collection(LineCollection(lines, colors=TRAIL_COLOR, lw=0.8, zorder=1.5))


def _trail_label(record: ReconfigurationRecord, leg: LegRecord) -> str:
    time = select_view(record).format_time(_trail_steps(leg) * record.mission.step)
    return f"last {time} of the trajectory"


def _trail_steps(leg: LegRecord) -> int:
    return max(1, round(leg.step_count * TRAIL_FRACTION))


def _drop_missing(lines: list[Array]) -> list[Array]:
    flown = [line[np.isfinite(line).all(axis=1)] for line in lines]
    return [line for line in flown if len(line)]


def _deepen_axes(space: AxisBounds) -> AxisBounds:
    # Otherwise a swarm that stays in its plane has no depth.
    size = space.high - space.low
    more = np.maximum(MIN_DEPTH_RATIO * size.max() - size, 0) / 2
    return space._replace(low=space.low - more, high=space.high + more)
