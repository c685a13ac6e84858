"""The swarm from above: stage by stage, along the first leg, and the paths it flew."""

import tomllib

import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy import ndarray as Array

from sato.plots.look import BLUE, GREY, PALE, RED
from sato.plots.swarm import Snapshot, draw_swarm, key_of_components
from sato.plots.view import Space, entitle, letter, panels
from sato.reconfiguration.check.evidence import Evidence, Stretch
from sato.reconfiguration.check.words import at_end
from sato.reconfiguration.plots.perspective import view_of

_COLUMNS = {1: 1, 2: 3, 3: 4}  # of a legend under so many panels
WIDE = 0.2  # of what is shown: circles from this radius on hide more than they show


def stages(evidence: Evidence) -> Figure:
    """The swarm at the start, after each leg and after each loss [Morgan2016, Fig. 4]."""
    names = leg_names(evidence)
    shots = [_at(evidence, 0, "start")]
    for stretch in evidence.stretches:
        lost = _lost_at(evidence, stretch.first)
        if lost and stretch.first:
            before = shots[-1].goals
            title = f"{_many(lost, 'agent')} lost"
            shots.append(_at(evidence, stretch.first, title)._replace(goals=before))
        _, live, believed, component = at_end(evidence, stretch)
        title = f"after leg {stretch.leg + 1}, {names[stretch.leg]}"
        if stretch.end is None:
            title = f"leg {stretch.leg + 1}, {names[stretch.leg]}, not ended"
        goals = _first(evidence, stretch.leg, int(believed[live].max(initial=0)))
        where = view_of(evidence).of(evidence.position[stretch.last])
        shots.append(Snapshot(title, where, np.where(live, component, -1), goals))
    return _draw(evidence, shots)


def first_leg(evidence: Evidence) -> Figure:
    """Six instants of the first leg [Morgan2016, Fig. 5]."""
    view = view_of(evidence)
    [stretch] = evidence.stretches[:1] or [Stretch(0, 0, len(evidence.time) - 1, None)]
    # Closer together where most happens: networks merge early.
    when = np.unique(np.round(stretch.steps * np.linspace(0, 1, 6) ** 1.3).astype(int))
    shots: list[Snapshot] = []
    for k in when + stretch.first:
        shot = _at(evidence, int(k), f"t = {view.when(evidence.time[k])}")
        if k == stretch.last and stretch.end is not None:
            _, live, _, component = at_end(evidence, stretch)
            shot = shot._replace(component=np.where(live, component, -1))
        shots.append(shot._replace(goals=shots[0].goals if shots else shot.goals))
    return _draw(evidence, shots)


def trajectories(evidence: Evidence) -> Figure:
    """The paths of each leg; those of agents that changed their mind stand out."""
    legs = [s for s in evidence.stretches if s.steps]
    view = view_of(evidence)
    position, goals = view.of(evidence.position), all_goals(evidence)
    space = Space.around(view, position, *goals, margin=margin(evidence))
    figure, axes = panels(max(len(legs), 1), space, columns=2, width=3.8)
    scale, _ = space.unit
    names, some = leg_names(evidence), False
    for i, (ax, stretch) in enumerate(zip(axes, legs, strict=False)):
        window = slice(stretch.first, stretch.last + 1)
        path = position[window] / scale
        flies = evidence.alive[stretch.first : stretch.last]
        target = np.where(flies, evidence.target[stretch.first : stretch.last], -1)
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
        ax.plot(*start.T, ls="", marker="o", ms=2.6, mfc="white", mec=GREY, mew=0.6, zorder=4)
        ax.plot(*path[-1, last].T, ls="", marker="o", ms=2.6, color="black", mew=0, zorder=5)
        entitle(ax, f"{letter(i)} leg {stretch.leg + 1}, {names[stretch.leg]}")
    key = [Line2D([], [], color=BLUE, lw=1, label="kept its target")]
    if some:
        key.append(Line2D([], [], color=RED, lw=1, label="changed its target on the way"))
    key += [
        Line2D([], [], ls="", marker="o", ms=4, mfc="white", mec=GREY, label="start"),
        Line2D([], [], ls="", marker="o", ms=4, color="black", mew=0, label="end"),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=4 if len(axes) > 1 else 2)
    return figure


def leg_names(evidence: Evidence) -> list[str]:
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


def _draw(evidence: Evidence, shots: list[Snapshot]) -> Figure:
    there = [s.position[s.component >= 0] for s in shots]
    shown = [*there, *(s.goals for s in shots)]
    view, room = view_of(evidence), margin(evidence)
    space = Space.around(view, *shown, margin=room)
    radius = evidence.mission.comm_radius / 2
    circles = space.axes == 2 and radius < WIDE * float((space.high - space.low).max())
    if circles:
        space = Space.around(view, *shown, margin=min(radius, 4 * room))
    figure, axes = panels(len(shots), space)
    for i, (ax, shot) in enumerate(zip(axes, shots, strict=True)):
        draw_swarm(ax, shot, space, radius if circles else None)
        count = len(np.unique(shot.component[shot.component >= 0]))
        entitle(ax, f"{letter(i)} {shot.title}\n{_many(count, 'component')}")
    key = key_of_components(shots)
    key.append(Line2D([], [], ls="", marker="x", color=PALE, ms=4.5, label="target"))
    if circles:
        key.append(
            Line2D([], [], ls=":", color=GREY, lw=0.8, label="half the communication radius")
        )
    figure.legend(handles=key, loc="outside lower center", ncols=_COLUMNS[min(len(axes), 3)])
    return figure


def _at(evidence: Evidence, k: int, title: str) -> Snapshot:
    leg = int(evidence.leg[k])
    m = int(evidence.believed[leg].max(initial=0)) or int(evidence.alive[k].sum())
    where = view_of(evidence).of(evidence.position[k])
    return Snapshot(title, where, evidence.component[k], _first(evidence, leg, m))


def _first(evidence: Evidence, leg: int, m: int) -> Float[Array, "targets d"]:
    goals = evidence.goals[leg]
    goals = goals[np.isfinite(goals).all(axis=1)]
    return view_of(evidence).of(goals[: m or len(goals)])


def believed_goals(evidence: Evidence, leg: int) -> Float[Array, "targets d"]:
    """The targets of a leg that anybody believed in, as shown; all if it never ended."""
    return _first(evidence, leg, int(evidence.believed[leg].max(initial=0)))


def all_goals(evidence: Evidence) -> list[Float[Array, "targets d"]]:
    """The believed targets of every leg, as shown."""
    return [believed_goals(evidence, leg) for leg in range(len(evidence.goals))]


def margin(evidence: Evidence) -> float:
    """Room around what is shown [m]."""
    return 0.6 * evidence.mission.spacing if np.isfinite(evidence.mission.spacing) else 1.0


def _lost_at(evidence: Evidence, k: int) -> int:
    return sum(len(e["agents"]) for at, e in evidence.happened.told("loss") if at == k)


def _many(count: int, what: str) -> str:
    return f"{count} {what}" if count == 1 else f"{count} {what}s"
