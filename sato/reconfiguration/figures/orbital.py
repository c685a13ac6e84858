"""A swarm about its chief: instants along the way, and all paths in space."""

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
from sato.figures.snapshot import Snapshot, draw_swarm, snapshots_legend
from sato.figures.style import BLUE, DARK_GRAY, GRAY, LIGHT_GRAY, RED
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.figures.perspective import select_view
from sato.reconfiguration.figures.snapshots import (
    all_used_targets,
    plot_margin,
    read_leg_names,
    used_targets,
)

SNAPSHOT_FRACTIONS = (0, 1 / 3, 2 / 3, 1)  # of a leg, at which the swarm is shown
TRAIL_FRACTION = 1 / 6  # of a leg: how long the paths are that agents draw behind them
POINTS_PER_STEP = 6  # straight pieces in which a step is drawn
MIN_DEPTH_RATIO = 0.4  # least size of an axis of space, in that of the largest
TRAIL_COLOR, SHADOW_COLOR = "#9fb4c2", "#d9d9d9"
CHIEF_MARKER: dict[str, Any] = {"ls": "", "marker": "+", "color": DARK_GRAY, "mew": 0.9}


def plot_instants(evidence: ReconfigurationRecord) -> Figure:
    """Each leg at its start, its thirds and its end [Morgan2016, Fig. 6]."""
    legs = evidence.leg_records or (LegRecord(0, 0, len(evidence.time) - 1, None),)
    view, names = select_view(evidence), read_leg_names(evidence)
    path = view.project(interpolate_positions(evidence))
    space = AxisBounds.enclosing(
        view, path, *all_used_targets(evidence), margin=plot_margin(evidence)
    )
    many = len(legs) > 1
    size = float(np.clip(900 / len(path[0]), 5, 15))  # of the marks, smaller where it is crowded
    figure, axes = make_panels(
        len(SNAPSHOT_FRACTIONS) * len(legs), space, len(SNAPSHOT_FRACTIONS), 2.6 if many else 3.4
    )
    shots = []
    for i, ax in enumerate(axes):
        leg, share = (
            legs[i // len(SNAPSHOT_FRACTIONS)],
            SNAPSHOT_FRACTIONS[i % len(SNAPSHOT_FRACTIONS)],
        )
        k = leg.start_index + round(leg.step_count * share)
        since = max(leg.start_index, k - _trail_steps(leg))
        shot = _make_snapshot(evidence, leg, k)
        _draw_trails(ax, path[since * POINTS_PER_STEP : k * POINTS_PER_STEP + 1] / space.unit[0])
        ax.plot(0, 0, ms=5, zorder=1, **CHIEF_MARKER)
        draw_swarm(ax, shot, space, size=size, target_rings=True)
        set_panel_title(ax, f"{panel_letter(i)} {shot.title}" + many * f", {names[leg.leg_index]}")
        shots.append(shot)
    tail = "path of late" if many else _trail_label(evidence, legs[0])
    key = [
        *snapshots_legend(shots),
        Line2D([], [], ls="", marker="o", ms=6, mfc="none", mec=LIGHT_GRAY, label="target"),
        Line2D([], [], color=TRAIL_COLOR, lw=1, label=tail),
        Line2D([], [], ms=6, label="chief", **CHIEF_MARKER),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=6)
    return figure


def plot_space(evidence: ReconfigurationRecord) -> Figure:
    """The paths of all agents in the chief's frame, and their shadows on its orbital plane."""
    path = interpolate_positions(evidence)
    room = _deepen_axes(
        AxisBounds.enclosing(THREE_AXES, path, np.zeros((1, 3)), margin=plot_margin(evidence))
    )
    figure = Figure(figsize=(6.6, 5.4))
    figure.set_layout_engine("constrained", rect=(0, 0, 0.97, 1))
    ax: Any = figure.add_subplot(projection="3d")
    set_axis_bounds(ax, room)
    ax.set_box_aspect(room.high - room.low, zoom=1.0)
    scale = room.unit[0]
    lines = list(np.moveaxis(path, 1, 0) / scale)
    floor = room.low[2] / scale
    shadows = [np.column_stack([line[:, :2], np.full(len(line), floor)]) for line in lines]
    ax.add_collection(Line3DCollection(shadows, colors=SHADOW_COLOR, lw=0.6))
    ax.add_collection(Line3DCollection(lines, colors=BLUE, lw=0.8, alpha=0.7))
    first, last = (np.array([line[k] for line in _drop_missing(lines)]).T for k in (0, -1))
    ax.plot(*first, ls="", marker="o", ms=3.2, mfc="white", mec=GRAY, mew=0.7)
    ax.plot(*last, ls="", marker="o", ms=3.2, color=RED, mew=0)
    ax.plot(0, 0, 0, ms=7, **CHIEF_MARKER)
    ax.view_init(elev=28, azim=-50)
    key = [
        Line2D([], [], color=BLUE, lw=1, label="path"),
        Line2D([], [], color=SHADOW_COLOR, lw=1, label="its shadow"),
        Line2D([], [], ls="", marker="o", ms=4, mfc="white", mec=GRAY, label="start"),
        Line2D([], [], ls="", marker="o", ms=4, color=RED, mew=0, label="end"),
        Line2D([], [], ms=6, label="chief", **CHIEF_MARKER),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=5)
    return figure


def interpolate_positions(evidence: ReconfigurationRecord) -> Float[Array, "moments agents d"]:
    """Positions at `PIECES` moments a step, on cubic pieces; NaN where an agent does not fly."""
    x = np.moveaxis(evidence.position, 0, 1), np.moveaxis(evidence.velocity, 0, 1)
    pieces = np.moveaxis(control_points(*x, evidence.mission.step), 0, 1)
    pieces = np.where(evidence.alive[:-1, :, None, None], pieces, np.nan)
    moments = np.arange(POINTS_PER_STEP) / POINTS_PER_STEP
    inside = [evaluate_bezier(pieces, np.full(pieces.shape[:2], moment)) for moment in moments]
    found = np.stack(inside, axis=1).reshape(-1, *evidence.position.shape[1:])
    last = np.where(evidence.alive[-1, :, None], evidence.position[-1], np.nan)
    return np.concatenate([found, last[None]])


def _make_snapshot(evidence: ReconfigurationRecord, leg: LegRecord, k: int) -> Snapshot:
    component = evidence.component[k]
    if (
        k == leg.end_index and leg.end_event is not None
    ):  # before the losses that the next leg begins with
        _, live, _, component = evidence.leg_end(leg)
        component = np.where(live, component, -1)
    view = select_view(evidence)
    where, goals = view.project(evidence.position[k]), used_targets(evidence, leg.leg_index)
    return Snapshot(view.format_time(evidence.time[k]), where, component, goals)


def _draw_trails(ax: Any, path: Float[Array, "moments agents d"]) -> None:
    lines = list(np.moveaxis(path, 1, 0))
    ax.add_collection(LineCollection(lines, colors=TRAIL_COLOR, lw=0.8, zorder=1.5))


def _trail_label(evidence: ReconfigurationRecord, leg: LegRecord) -> str:
    return (
        f"the last {select_view(evidence).format_time(_trail_steps(leg) * evidence.mission.step)}"
    )


def _trail_steps(leg: LegRecord) -> int:
    return max(1, round(leg.step_count * TRAIL_FRACTION))


def _drop_missing(lines: list[Array]) -> list[Array]:
    flown = [line[np.isfinite(line).all(axis=1)] for line in lines]
    return [line for line in flown if len(line)]


def _deepen_axes(space: AxisBounds) -> AxisBounds:
    # A swarm that stays in its plane would be squashed to nothing.
    size = space.high - space.low
    more = np.maximum(MIN_DEPTH_RATIO * size.max() - size, 0) / 2
    return space._replace(low=space.low - more, high=space.high + more)
