"""Snapshots and trajectories: of each leg, of the first one, and about a chief in orbit."""

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from sato.figures.axes import (
    ORBITAL_SPACE,
    add_axes,
    add_legend,
    draw_ends,
    draw_paths,
    make_panels,
)
from sato.figures.panels import mark_broken
from sato.figures.style import BLUE, DARK_GRAY, GRAY, RED
from sato.reconfiguration.check.promises import check_obstacles, check_separation
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.figures.scene import (
    LOST_STYLE,
    TRAIL_COLOR,
    Scene,
    Snapshot,
    draw_obstacles,
    draw_swarm,
    pluralize,
)

MAX_CIRCLE_RATIO = 0.2  # of the axes, above which communication circles hide too much
SNAPSHOT_FRACTIONS = (0, 1 / 3, 2 / 3, 1)  # of a leg
TRAIL_FRACTION = 1 / 6  # of a leg: length of the trails
MIN_DEPTH_RATIO = 0.4  # least size of an axis of space, relative to the largest
CHIEF_STYLE: dict[str, Any] = {"marker": "+", "ms": 6, "color": DARK_GRAY, "label": "chief"}


def plot_stages(record: ReconfigurationRecord) -> Figure:
    """Plot the swarm at the start, after each leg and after each loss [Morgan2016, Fig. 4]."""
    scene, losses = Scene(record), record.events.of_kind("loss")
    snapshots = [scene.snapshot(scene.legs[0], 0, "start")]
    for leg in record.leg_records:
        lost = sum(len(event["agents"]) for k, event in losses if k == leg.start_index)
        if lost and leg.start_index:
            shot = scene.snapshot(leg, leg.start_index, f"{pluralize(lost, 'agent')} lost")
            snapshots.append(shot._replace(targets=snapshots[-1].targets))
        name = f"leg {leg.leg_index + 1}, {scene.leg_names[leg.leg_index]}"
        title = f"{name}, not ended" if leg.end_event is None else f"after {name}"
        snapshots.append(scene.snapshot(leg, leg.end_index, title))
    return _plot_snapshots(scene, snapshots)


def plot_first_leg(record: ReconfigurationRecord) -> Figure:
    """Plot six instants of the first leg [Morgan2016, Fig. 5]."""
    scene = Scene(record)
    leg = scene.legs[0]
    # Closer together at the start, where components merge.
    steps = np.unique(np.round(leg.step_count * np.linspace(0, 1, 6) ** 1.3).astype(int))
    instants = (steps + leg.start_index).tolist()
    titles = [f"t = {scene.view.format_time(record.time[k])}" for k in instants]
    shots = [scene.snapshot(leg, k, title) for k, title in zip(instants, titles, strict=True)]
    return _plot_snapshots(scene, shots)


def _plot_snapshots(scene: Scene, snapshots: list[Snapshot]) -> Figure:
    space = scene.enclose(
        *[s.position[s.component >= 0] for s in snapshots], *[s.targets for s in snapshots]
    )
    radius = scene.record.mission.comm_radius / 2
    has_circles = space.is_flat and radius < MAX_CIRCLE_RATIO * space.size.max()
    counts = [len(np.unique(s.component[s.component >= 0])) for s in snapshots]
    titles = [
        f"{shot.title}\n{pluralize(count, 'component')}"
        for shot, count in zip(snapshots, counts, strict=True)
    ]
    figure, axes = make_panels(titles, space)
    for ax, shot in zip(axes, snapshots, strict=True):
        draw_swarm(ax, shot, space, radius=radius if has_circles else None)
    circle = Line2D([], [], ls=":", color=GRAY, lw=0.8, label="half the communication radius")
    add_legend(figure, *([circle] if has_circles else []))
    return figure


def plot_trajectories(record: ReconfigurationRecord) -> Figure:
    """Plot the trajectories of each leg; those with a change of target in another color."""
    scene = Scene(record)
    space = scene.enclose(scene.path, *scene.targets)
    titles = [f"leg {leg.leg_index + 1}, {scene.leg_names[leg.leg_index]}" for leg in scene.legs]
    figure, axes = make_panels(titles, space, columns=2, width=3.8)
    for ax, leg in zip(axes, scene.legs, strict=True):
        path = scene.path_between(leg.start_index, leg.end_index)
        steps = slice(leg.start_index, leg.end_index)
        target = np.where(record.frames.alive[steps], record.frames.target_index[steps], -1)
        changes = np.array([len(np.unique(t[t >= 0])) > 1 for t in target.T])
        draw_paths(ax, space, path[:, ~changes], BLUE, label="kept its target")
        if changes.any():
            draw_paths(ax, space, path[:, changes], RED, label="changed its target")
        draw_ends(ax, space, path, "black")
        begin, end = (k * record.mission.step for k in (leg.start_index, leg.end_index))
        draw_obstacles(ax, scene.outlines_at(begin), space)
        if any(one.drift.any() for one in record.mission.obstacles):
            draw_obstacles(ax, scene.outlines_at(end), space, alpha=0.5)
        lost = path[-1, record.is_adrift[leg.end_index]] / space.unit[0]
        if len(lost):
            ax.plot(*lost.T, "x", ms=4, **LOST_STYLE, zorder=4, label="lost")
        for promise in (check_separation(record), check_obstacles(record)):
            if not promise.kept and promise.time is not None and begin <= promise.time <= end:
                (at,) = scene.positions_at(np.array([promise.time / record.mission.step]))
                mark_broken(ax, space.unit[0], at[list(promise.agents)], promise.name)
    add_legend(figure)
    return figure


def plot_instants(record: ReconfigurationRecord) -> Figure:
    """Plot the swarm at the start, thirds and end of each leg [Morgan2016, Fig. 6]."""
    scene = Scene(record)
    space = scene.enclose(scene.path, *scene.targets)
    shots, trails = [], []
    for leg in scene.legs:
        for share in SNAPSHOT_FRACTIONS:
            k = leg.start_index + round(leg.step_count * share)
            title = f"{scene.view.format_time(record.time[k])}, {scene.leg_names[leg.leg_index]}"
            shots.append(scene.snapshot(leg, k, title))
            since = max(leg.start_index, k - max(1, round(leg.step_count * TRAIL_FRACTION)))
            trails.append(scene.path_between(since, k))
    width = 2.6 if len(scene.legs) > 1 else 3.4
    figure, axes = make_panels([s.title for s in shots], space, len(SNAPSHOT_FRACTIONS), width)
    size = float(np.clip(30 / len(record.frames.alive[0]) ** 0.5, 2.2, 3.9))  # smaller for many
    for ax, shot, trail in zip(axes, shots, trails, strict=True):
        draw_paths(ax, space, trail, TRAIL_COLOR, label="recent trajectory")
        ax.plot(0, 0, **CHIEF_STYLE, ls="", zorder=1)
        draw_swarm(ax, shot, space, size)
    add_legend(figure)
    return figure


def plot_space(record: ReconfigurationRecord) -> Figure:
    """Plot all trajectories about the chief, and their projections on its orbital plane."""
    scene = Scene(record, ORBITAL_SPACE)
    space = scene.enclose(scene.path, np.zeros((1, 3)))
    # Otherwise a swarm that stays in its plane has no depth.
    more = np.maximum(MIN_DEPTH_RATIO * space.size.max() - space.size, 0) / 2
    space = space._replace(low=space.low - more, high=space.high + more)
    figure = Figure(figsize=(6.6, 5.4))
    figure.set_layout_engine("constrained", rect=(0, 0, 0.97, 1))
    ax = add_axes(figure, space)
    ax.view_init(elev=28, azim=-50)
    floor = scene.path * [1, 1, 0] + [0, 0, space.low[2]]
    draw_paths(ax, space, floor, "#d9d9d9", label="projection")
    draw_paths(ax, space, scene.path, BLUE, alpha=0.7, label="trajectory")
    draw_ends(ax, space, scene.path, RED)
    ax.plot(0, 0, 0, **CHIEF_STYLE, ls="")
    add_legend(figure)
    return figure
