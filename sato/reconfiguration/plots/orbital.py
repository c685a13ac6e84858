"""A swarm about its chief: instants along the way, and all paths in space."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]
from numpy import ndarray as Array

from dynamics.path import at, controls
from sato.plots.look import BLUE, DARK, GREY, PALE, RED
from sato.plots.swarm import Snapshot, draw_swarm, key_of_components
from sato.plots.view import IN_SPACE, Space, entitle, letter, panels, set_space
from sato.reconfiguration.check.evidence import Evidence, Stretch
from sato.reconfiguration.check.words import at_end
from sato.reconfiguration.plots.perspective import view_of
from sato.reconfiguration.plots.stages import all_goals, believed_goals, leg_names, margin

SHARES = (0, 1 / 3, 2 / 3, 1)  # of a leg, at which the swarm is shown
TAIL = 1 / 6  # of a leg: how long the paths are that agents draw behind them
PIECES = 6  # straight pieces in which a step is drawn
DEPTH = 0.4  # least size of an axis of space, in that of the largest
TRACE, SHADOW = "#9fb4c2", "#d9d9d9"
CHIEF: dict[str, Any] = {"ls": "", "marker": "+", "color": DARK, "mew": 0.9}


def instants(evidence: Evidence) -> Figure:
    """Each leg at its start, its thirds and its end [Morgan2016, Fig. 6]."""
    legs = evidence.stretches or (Stretch(0, 0, len(evidence.time) - 1, None),)
    view, names = view_of(evidence), leg_names(evidence)
    path = view.of(smooth(evidence))
    space = Space.around(view, path, *all_goals(evidence), margin=margin(evidence))
    many = len(legs) > 1
    size = float(np.clip(900 / len(path[0]), 5, 15))  # of the marks, smaller where it is crowded
    figure, axes = panels(len(SHARES) * len(legs), space, len(SHARES), 2.6 if many else 3.4)
    shots = []
    for i, ax in enumerate(axes):
        leg, share = legs[i // len(SHARES)], SHARES[i % len(SHARES)]
        k = leg.first + round(leg.steps * share)
        since = max(leg.first, k - _steps(leg))
        shot = _shot(evidence, leg, k)
        _tails(ax, path[since * PIECES : k * PIECES + 1] / space.unit[0])
        ax.plot(0, 0, ms=5, zorder=1, **CHIEF)
        draw_swarm(ax, shot, space, size=size, rings=True)
        entitle(ax, f"{letter(i)} {shot.title}" + many * f", {names[leg.leg]}")
        shots.append(shot)
    tail = "path of late" if many else _tail(evidence, legs[0])
    key = [
        *key_of_components(shots),
        Line2D([], [], ls="", marker="o", ms=6, mfc="none", mec=PALE, label="target"),
        Line2D([], [], color=TRACE, lw=1, label=tail),
        Line2D([], [], ms=6, label="chief", **CHIEF),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=6)
    return figure


def space(evidence: Evidence) -> Figure:
    """The paths of all agents in the chief's frame, and their shadows on its orbital plane."""
    path = smooth(evidence)
    room = _room(Space.around(IN_SPACE, path, np.zeros((1, 3)), margin=margin(evidence)))
    figure = Figure(figsize=(6.6, 5.4))
    figure.set_layout_engine("constrained", rect=(0, 0, 0.97, 1))
    ax: Any = figure.add_subplot(projection="3d")
    set_space(ax, room)
    ax.set_box_aspect(room.high - room.low, zoom=1.0)
    scale = room.unit[0]
    lines = list(np.moveaxis(path, 1, 0) / scale)
    floor = room.low[2] / scale
    shadows = [np.column_stack([line[:, :2], np.full(len(line), floor)]) for line in lines]
    ax.add_collection(Line3DCollection(shadows, colors=SHADOW, lw=0.6))
    ax.add_collection(Line3DCollection(lines, colors=BLUE, lw=0.8, alpha=0.7))
    first, last = (np.array([line[k] for line in _flown(lines)]).T for k in (0, -1))
    ax.plot(*first, ls="", marker="o", ms=3.2, mfc="white", mec=GREY, mew=0.7)
    ax.plot(*last, ls="", marker="o", ms=3.2, color=RED, mew=0)
    ax.plot(0, 0, 0, ms=7, **CHIEF)
    ax.view_init(elev=28, azim=-50)
    key = [
        Line2D([], [], color=BLUE, lw=1, label="path"),
        Line2D([], [], color=SHADOW, lw=1, label="its shadow"),
        Line2D([], [], ls="", marker="o", ms=4, mfc="white", mec=GREY, label="start"),
        Line2D([], [], ls="", marker="o", ms=4, color=RED, mew=0, label="end"),
        Line2D([], [], ms=6, label="chief", **CHIEF),
    ]
    figure.legend(handles=key, loc="outside lower center", ncols=5)
    return figure


def smooth(evidence: Evidence) -> Float[Array, "moments agents d"]:
    """Positions at `PIECES` moments a step, on cubic pieces; NaN where an agent does not fly."""
    x = np.moveaxis(evidence.position, 0, 1), np.moveaxis(evidence.velocity, 0, 1)
    pieces = np.moveaxis(controls(*x, evidence.mission.step), 0, 1)
    pieces = np.where(evidence.alive[:-1, :, None, None], pieces, np.nan)
    moments = np.arange(PIECES) / PIECES
    inside = [at(pieces, np.full(pieces.shape[:2], moment)) for moment in moments]
    found = np.stack(inside, axis=1).reshape(-1, *evidence.position.shape[1:])
    last = np.where(evidence.alive[-1, :, None], evidence.position[-1], np.nan)
    return np.concatenate([found, last[None]])


def _shot(evidence: Evidence, leg: Stretch, k: int) -> Snapshot:
    component = evidence.component[k]
    if k == leg.last and leg.end is not None:  # before the losses that the next leg begins with
        _, live, _, component = at_end(evidence, leg)
        component = np.where(live, component, -1)
    view = view_of(evidence)
    where, goals = view.of(evidence.position[k]), believed_goals(evidence, leg.leg)
    return Snapshot(view.when(evidence.time[k]), where, component, goals)


def _tails(ax: Any, path: Float[Array, "moments agents d"]) -> None:
    lines = list(np.moveaxis(path, 1, 0))
    ax.add_collection(LineCollection(lines, colors=TRACE, lw=0.8, zorder=1.5))


def _tail(evidence: Evidence, leg: Stretch) -> str:
    return f"the last {view_of(evidence).when(_steps(leg) * evidence.mission.step)}"


def _steps(leg: Stretch) -> int:
    return max(1, round(leg.steps * TAIL))


def _flown(lines: list[Array]) -> list[Array]:
    flown = [line[np.isfinite(line).all(axis=1)] for line in lines]
    return [line for line in flown if len(line)]


def _room(space: Space) -> Space:
    # A swarm that stays in its plane would be squashed to nothing.
    size = space.high - space.low
    more = np.maximum(DEPTH * size.max() - size, 0) / 2
    return space._replace(low=space.low - more, high=space.high + more)
