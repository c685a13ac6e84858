"""Snapshots of the swarm after each leg and along the first one, and its trajectories."""

import tomllib
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy import ndarray as Array

from sato.figures.axes import (
    ORBITAL_PLANE,
    AxisBounds,
    Projection,
    make_panels,
    panel_letter,
    set_panel_title,
)
from sato.figures.snapshot import Snapshot, draw_swarm, snapshots_legend
from sato.figures.style import BLUE, GRAY, LIGHT_GRAY, RED
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord

_LEGEND_COLUMNS = {1: 1, 2: 3, 3: 4}  # by the number of panels beside each other
MAX_CIRCLE_RATIO = 0.2  # of the axes, above which communication circles hide too much


def plot_stages(record: ReconfigurationRecord) -> Figure:
    """Plot the swarm at the start, after each leg and after each loss [Morgan2016, Fig. 4]."""
    names = read_leg_names(record)
    snapshots = [make_snapshot(record, begun_legs(record)[0], 0, "start")]
    for leg in record.leg_records:
        lost = _count_lost(record, leg.start_index)
        if lost and leg.start_index:
            title = f"{pluralize(lost, 'agent')} lost"
            snapshot = make_snapshot(record, leg, leg.start_index, title)
            snapshots.append(snapshot._replace(targets=snapshots[-1].targets))
        title = f"leg {leg.leg_index + 1}, {names[leg.leg_index]}"
        title = f"{title}, not ended" if leg.end_event is None else f"after {title}"
        snapshots.append(make_snapshot(record, leg, leg.end_index, title))
    return _plot_snapshots(record, snapshots)


def plot_first_leg(record: ReconfigurationRecord) -> Figure:
    """Plot six instants of the first leg [Morgan2016, Fig. 5]."""
    view, leg = select_view(record), begun_legs(record)[0]
    # Closer together at the start, where components merge.
    steps = np.unique(np.round(leg.step_count * np.linspace(0, 1, 6) ** 1.3).astype(int))
    snapshots = [
        make_snapshot(record, leg, k, f"t = {view.format_time(record.time[k])}")
        for k in (steps + leg.start_index).tolist()
    ]
    return _plot_snapshots(record, snapshots)


def plot_trajectories(record: ReconfigurationRecord) -> Figure:
    """Plot the trajectories of each leg; those with a change of target in another color."""
    legs = [leg for leg in record.leg_records if leg.step_count]
    view, names = select_view(record), read_leg_names(record)
    position, targets = view.project(record.position), all_used_targets(record)
    space = AxisBounds.enclosing(view, position, *targets, margin=plot_margin(record))
    figure, axes = make_panels(max(len(legs), 1), space, columns=2, width=3.8)
    has_changes = False
    for i, (ax, leg) in enumerate(zip(axes, legs, strict=False)):
        has_changes |= _plot_leg(ax, record, leg, position / space.unit[0])
        set_panel_title(ax, f"{panel_letter(i)} leg {leg.leg_index + 1}, {names[leg.leg_index]}")
    key = [Line2D([], [], color=BLUE, lw=1, label="kept its target")]
    if has_changes:
        key.append(Line2D([], [], color=RED, lw=1, label="changed its target"))
    key += endpoint_legend("black")
    figure.legend(handles=key, loc="outside lower center", ncols=4 if len(axes) > 1 else 2)
    return figure


def _plot_leg(
    ax: Any, record: ReconfigurationRecord, leg: LegRecord, position: Float[Array, "k agents d"]
) -> bool:
    """Plot one leg, and tell whether any agent changed its target."""
    steps = slice(leg.start_index, leg.end_index)
    path = position[leg.start_index : leg.end_index + 1]
    is_flying = record.alive[steps]
    target = np.where(is_flying, record.target_index[steps], -1)
    is_changed = np.array([len(np.unique(t[t >= 0])) > 1 for t in target.T])
    for i in np.flatnonzero(is_flying.any(axis=0)):
        shown = np.append(is_flying[:, i], is_flying[-1, i])
        color, zorder = (RED, 3) if is_changed[i] else (BLUE, 2)
        ax.plot(*path[shown, i].T, lw=0.7, color=color, alpha=0.75, zorder=zorder)
    first, last = is_flying.any(axis=0), is_flying[-1]
    start = path[np.argmax(is_flying[:, first], axis=0), np.flatnonzero(first)]
    ax.plot(*start.T, ls="", marker="o", ms=2.6, mfc="white", mec=GRAY, mew=0.6, zorder=4)
    ax.plot(*path[-1, last].T, ls="", marker="o", ms=2.6, color="black", mew=0, zorder=5)
    return bool(is_changed.any())


def begun_legs(record: ReconfigurationRecord) -> tuple[LegRecord, ...]:
    """Return the legs that began; the whole run as one where none did."""
    return record.leg_records or (LegRecord(0, 0, len(record.time) - 1, None),)


def make_snapshot(record: ReconfigurationRecord, leg: LegRecord, k: int, title: str) -> Snapshot:
    """Return the swarm at an instant of a leg; at its end, before the losses of the next leg."""
    component = record.component[k]
    if k == leg.end_index and leg.end_event is not None:
        _, live, _, component = record.leg_end(leg)
        component = np.where(live, component, -1)
    position = select_view(record).project(record.position[k])
    return Snapshot(title, position, component, used_targets(record, leg.leg_index))


def endpoint_legend(end_color: str) -> list[Line2D]:
    """Return legend entries of the first and last positions of trajectories."""
    marker: dict[str, Any] = {"ls": "", "marker": "o", "ms": 4}
    return [
        Line2D([], [], mfc="white", mec=GRAY, label="start", **marker),
        Line2D([], [], color=end_color, mew=0, label="end", **marker),
    ]


def has_chief(record: ReconfigurationRecord) -> bool:
    """Tell whether the swarm moves about a chief."""
    return record.mission.flown_plant.chief_elements(0.0) is not None


def select_view(record: ReconfigurationRecord) -> Projection:
    """Return the orbital plane about a chief, else all axes."""
    d = record.axes
    names = ("x", "y", "z")[:d]
    return ORBITAL_PLANE if has_chief(record) else Projection(tuple(range(d)), names)


def read_leg_names(record: ReconfigurationRecord) -> list[str]:
    """Return the name of each leg: its text, or the kind of its shape."""
    try:
        tables = tomllib.loads(str(record.attributes["scenario"])).get("leg", [])
    except tomllib.TOMLDecodeError:
        tables = []
    names = []
    for i in range(len(record.mission.legs)):
        shape = tables[i].get("shape", {}) if i < len(tables) else {}
        text = shape.get("text")
        names.append(f"‘{text}’" if text else str(shape.get("kind", "shape")))
    return names


def _plot_snapshots(record: ReconfigurationRecord, snapshots: list[Snapshot]) -> Figure:
    there = [s.position[s.component >= 0] for s in snapshots]
    shown = [*there, *(s.targets for s in snapshots)]
    view, room = select_view(record), plot_margin(record)
    space = AxisBounds.enclosing(view, *shown, margin=room)
    radius = record.mission.comm_radius / 2
    circles = space.axes == 2 and radius < MAX_CIRCLE_RATIO * float((space.high - space.low).max())
    if circles:
        space = AxisBounds.enclosing(view, *shown, margin=min(radius, 4 * room))
    figure, axes = make_panels(len(snapshots), space)
    for i, (ax, snapshot) in enumerate(zip(axes, snapshots, strict=True)):
        draw_swarm(ax, snapshot, space, radius if circles else None)
        count = len(np.unique(snapshot.component[snapshot.component >= 0]))
        set_panel_title(ax, f"{panel_letter(i)} {snapshot.title}\n{pluralize(count, 'component')}")
    key = snapshots_legend(snapshots)
    key.append(Line2D([], [], ls="", marker="x", color=LIGHT_GRAY, ms=4.5, label="target"))
    if circles:
        key.append(
            Line2D([], [], ls=":", color=GRAY, lw=0.8, label="half the communication radius")
        )
    figure.legend(handles=key, loc="outside lower center", ncols=_LEGEND_COLUMNS[min(len(axes), 3)])
    return figure


def used_targets(record: ReconfigurationRecord, leg: int) -> Float[Array, "targets d"]:
    """Return the targets of a leg that agents bid on, as shown; all if it did not end."""
    targets = record.targets[leg]
    targets = targets[np.isfinite(targets).all(axis=1)]
    count = int(record.final_target_count[leg].max(initial=0))
    return select_view(record).project(targets[: count or len(targets)])


def all_used_targets(record: ReconfigurationRecord) -> list[Float[Array, "targets d"]]:
    """Return the targets of every leg that agents bid on, as shown."""
    return [used_targets(record, leg) for leg in range(len(record.targets))]


def plot_margin(record: ReconfigurationRecord) -> float:
    """Return the margin around agents and targets [m]."""
    spacing = record.mission.target_spacing
    return 0.6 * spacing if np.isfinite(spacing) else 1.0


def _count_lost(record: ReconfigurationRecord, k: int) -> int:
    return sum(len(e["agents"]) for at, e in record.events.of_kind("loss") if at == k)


def pluralize(count: int, noun: str) -> str:
    """Return a number with its noun."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
