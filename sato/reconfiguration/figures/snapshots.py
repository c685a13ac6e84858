"""The swarm from above: stage by stage, along the first leg, and the paths it flew."""

import tomllib

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy import ndarray as Array

from sato.figures.axes import AxisBounds, make_panels, panel_letter, set_panel_title
from sato.figures.snapshot import Snapshot, draw_swarm, snapshots_legend
from sato.figures.style import BLUE, GRAY, LIGHT_GRAY, RED
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.figures.perspective import select_view

_LEGEND_COLUMNS = {1: 1, 2: 3, 3: 4}  # of a legend under so many panels
MAX_CIRCLE_RATIO = 0.2  # of what is shown: circles from this radius on hide more than they show


def plot_stages(evidence: ReconfigurationRecord) -> Figure:
    """The swarm at the start, after each leg and after each loss [Morgan2016, Fig. 4]."""
    names = read_leg_names(evidence)
    shots = [_make_snapshot(evidence, 0, "start")]
    for stretch in evidence.leg_records:
        lost = _count_lost(evidence, stretch.start_index)
        if lost and stretch.start_index:
            before = shots[-1].targets
            title = f"{_pluralize(lost, 'agent')} lost"
            shots.append(
                _make_snapshot(evidence, stretch.start_index, title)._replace(targets=before)
            )
        _, live, believed, component = evidence.leg_end(stretch)
        title = f"after leg {stretch.leg_index + 1}, {names[stretch.leg_index]}"
        if stretch.end_event is None:
            title = f"leg {stretch.leg_index + 1}, {names[stretch.leg_index]}, not ended"
        goals = _first_targets(evidence, stretch.leg_index, int(believed[live].max(initial=0)))
        where = select_view(evidence).project(evidence.position[stretch.end_index])
        shots.append(Snapshot(title, where, np.where(live, component, -1), goals))
    return _plot_snapshots(evidence, shots)


def plot_first_leg(evidence: ReconfigurationRecord) -> Figure:
    """Six instants of the first leg [Morgan2016, Fig. 5]."""
    view = select_view(evidence)
    [stretch] = evidence.leg_records[:1] or [LegRecord(0, 0, len(evidence.time) - 1, None)]
    # Closer together where most happens: networks merge early.
    when = np.unique(np.round(stretch.step_count * np.linspace(0, 1, 6) ** 1.3).astype(int))
    shots: list[Snapshot] = []
    for k in when + stretch.start_index:
        shot = _make_snapshot(evidence, int(k), f"t = {view.format_time(evidence.time[k])}")
        if k == stretch.end_index and stretch.end_event is not None:
            _, live, _, component = evidence.leg_end(stretch)
            shot = shot._replace(component=np.where(live, component, -1))
        shots.append(shot._replace(targets=shots[0].targets if shots else shot.targets))
    return _plot_snapshots(evidence, shots)


def plot_trajectories(evidence: ReconfigurationRecord) -> Figure:
    """The paths of each leg; those of agents that changed their mind stand out."""
    legs = [s for s in evidence.leg_records if s.step_count]
    view = select_view(evidence)
    position, goals = view.project(evidence.position), all_used_targets(evidence)
    space = AxisBounds.enclosing(view, position, *goals, margin=plot_margin(evidence))
    figure, axes = make_panels(max(len(legs), 1), space, columns=2, width=3.8)
    scale, _ = space.unit
    names, some = read_leg_names(evidence), False
    for i, (ax, stretch) in enumerate(zip(axes, legs, strict=False)):
        window = slice(stretch.start_index, stretch.end_index + 1)
        path = position[window] / scale
        flies = evidence.alive[stretch.start_index : stretch.end_index]
        target = np.where(flies, evidence.target_index[stretch.start_index : stretch.end_index], -1)
        turned = np.array([len(np.unique(t[t >= 0])) > 1 for t in target.T])
        some |= bool(turned.any())
        for a in np.flatnonzero(flies.any(axis=0)):
            there = np.append(flies[:, a], flies[-1, a])
            colour = RED if turned[a] else BLUE
            ax.plot(
                *path[there, a].T, lw=0.7, color=colour, alpha=0.75, zorder=3 if turned[a] else 2
            )
        first, last = flies.any(axis=0), flies[-1]
        start = path[np.argmax(flies[:, first], axis=0), np.flatnonzero(first)]
        ax.plot(*start.T, ls="", marker="o", ms=2.6, mfc="white", mec=GRAY, mew=0.6, zorder=4)
        ax.plot(*path[-1, last].T, ls="", marker="o", ms=2.6, color="black", mew=0, zorder=5)
        set_panel_title(
            ax, f"{panel_letter(i)} leg {stretch.leg_index + 1}, {names[stretch.leg_index]}"
        )
    key = [Line2D([], [], color=BLUE, lw=1, label="kept its target")]
    if some:
        key.append(Line2D([], [], color=RED, lw=1, label="changed its target on the way"))
    key += [
        Line2D([], [], ls="", marker="o", ms=4, mfc="white", mec=GRAY, label="start"),
        Line2D([], [], ls="", marker="o", ms=4, color="black", mew=0, label="end"),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=4 if len(axes) > 1 else 2)
    return figure


def read_leg_names(evidence: ReconfigurationRecord) -> list[str]:
    """What each leg forms, in the words of the scenario."""
    try:
        said = tomllib.loads(str(evidence.attributes["scenario"])).get("leg", [])
    except tomllib.TOMLDecodeError:
        said = []
    names = []
    for i in range(len(evidence.mission.legs)):
        shape = said[i].get("shape", {}) if i < len(said) else {}
        text = shape.get("text")
        names.append(f"‘{text}’" if text else str(shape.get("kind", "shape")))
    return names


def _plot_snapshots(evidence: ReconfigurationRecord, shots: list[Snapshot]) -> Figure:
    there = [s.position[s.component >= 0] for s in shots]
    shown = [*there, *(s.targets for s in shots)]
    view, room = select_view(evidence), plot_margin(evidence)
    space = AxisBounds.enclosing(view, *shown, margin=room)
    radius = evidence.mission.comm_radius / 2
    circles = space.axes == 2 and radius < MAX_CIRCLE_RATIO * float((space.high - space.low).max())
    if circles:
        space = AxisBounds.enclosing(view, *shown, margin=min(radius, 4 * room))
    figure, axes = make_panels(len(shots), space)
    for i, (ax, shot) in enumerate(zip(axes, shots, strict=True)):
        draw_swarm(ax, shot, space, radius if circles else None)
        count = len(np.unique(shot.component[shot.component >= 0]))
        set_panel_title(ax, f"{panel_letter(i)} {shot.title}\n{_pluralize(count, 'component')}")
    key = snapshots_legend(shots)
    key.append(Line2D([], [], ls="", marker="x", color=LIGHT_GRAY, ms=4.5, label="target"))
    if circles:
        key.append(
            Line2D([], [], ls=":", color=GRAY, lw=0.8, label="half the communication radius")
        )
    figure.legend(handles=key, loc="outside lower center", ncols=_LEGEND_COLUMNS[min(len(axes), 3)])
    return figure


def _make_snapshot(evidence: ReconfigurationRecord, k: int, title: str) -> Snapshot:
    leg = int(evidence.leg[k])
    m = int(evidence.final_target_count[leg].max(initial=0)) or int(evidence.alive[k].sum())
    where = select_view(evidence).project(evidence.position[k])
    return Snapshot(title, where, evidence.component[k], _first_targets(evidence, leg, m))


def _first_targets(evidence: ReconfigurationRecord, leg: int, m: int) -> Float[Array, "targets d"]:
    goals = evidence.targets[leg]
    goals = goals[np.isfinite(goals).all(axis=1)]
    return select_view(evidence).project(goals[: m or len(goals)])


def used_targets(evidence: ReconfigurationRecord, leg: int) -> Float[Array, "targets d"]:
    """The targets of a leg that anybody believed in, as shown; all if it never ended."""
    return _first_targets(evidence, leg, int(evidence.final_target_count[leg].max(initial=0)))


def all_used_targets(evidence: ReconfigurationRecord) -> list[Float[Array, "targets d"]]:
    """The believed targets of every leg, as shown."""
    return [used_targets(evidence, leg) for leg in range(len(evidence.targets))]


def plot_margin(evidence: ReconfigurationRecord) -> float:
    """Room around what is shown [m]."""
    return (
        0.6 * evidence.mission.target_spacing
        if np.isfinite(evidence.mission.target_spacing)
        else 1.0
    )


def _count_lost(evidence: ReconfigurationRecord, k: int) -> int:
    return sum(len(e["agents"]) for at, e in evidence.events.of_kind("loss") if at == k)


def _pluralize(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
