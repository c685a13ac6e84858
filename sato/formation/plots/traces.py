"""Where vehicles went at the end of each leg [Lusk2020, Fig. 5]."""

from math import ceil
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from matplotlib.collections import EllipseCollection, LineCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy import ndarray as Array

from problems.alignment import align
from problems.formation import Formation
from sato.formation.check import Evidence
from sato.formation.check.replay import Stretch
from sato.formation.plots.phases import called, thinned, under_way
from sato.formation.shape import likeness
from sato.plots.look import BLUE, DARK, GREY, ORANGE, PALE, RED
from sato.plots.view import letter

LAST = 40.0  # of a leg, shown [s]
DIAMETER = 0.5  # of a vehicle [Lusk2020, sec. V] [m]
PIECES = 300  # of a trace, at most
FEW = 60  # edges, up to which they are drawn
PALEST = 0.2  # of a trace where it begins, against where it ends
ROOM = 1.0  # around what is shown [m]
COLUMNS = 3
WIDTHS = {1: 6.6, 2: 4.4, 3: 3.4}  # of a panel among so many [in]
HIGHEST = 6.5  # of a panel and the one below [in]
TALL = 1.35  # a panel's height over its width, at most
AXES = {"top": (0, 1), "side": (0, 2)}


class Scene(NamedTuple):
    """The end of a leg, in the axes of its shape: as if the shape had not been turned."""

    title: str
    formation: Formation
    path: Float[Array, "instants agents 3"]  # [m]
    turns: Float[Array, "turns 3"]  # where somebody under way took another point [m]
    avoiding: Bool[Array, " agents"]  # at the end


def traces(evidence: Evidence) -> Figure:
    """The last 40 s of each leg from above, and from the side where the shape is not flat.

    All panels have one scale, and vehicles are as large as they are. Each is drawn in the axes
    of its shape, which lies where it fits the vehicles best at the end.
    """
    last = len(evidence.time) - 1
    stretches = evidence.replay.stretches or (Stretch(0, 0, last, last, settled=False),)
    scenes = [_scene(evidence, stretch, i) for i, stretch in enumerate(stretches)]
    columns = min(len(scenes), COLUMNS) if len(scenes) != 4 else 2
    views = ["top", "side"] if any(_deep(s) for s in scenes) else ["top"]
    size = _size(scenes)
    figure, axes = _panels(len(scenes), columns, views, size)
    for scene, own in zip(scenes, axes, strict=True):
        for view, ax in zip(views, own, strict=True):
            _frame(ax, scene, AXES[view], size)
            _draw(ax, scene, AXES[view])
        own[0].set_title(scene.title)
    figure.legend(handles=_key(scenes), loc="outside lower center", ncols=min(2 * columns, 5))
    return figure


def _scene(evidence: Evidence, stretch: Stretch, number: int) -> Scene:
    formation = evidence.mission.shapes[stretch.leg].formation
    first = np.searchsorted(evidence.time, evidence.time[stretch.last] - LAST)
    window = np.arange(max(stretch.first, int(first)), stretch.last + 1)
    held, end = formation.points[evidence.point[stretch.last]], evidence.position[stretch.last]
    pose, fit = align(held, end), likeness(end, held)
    x, y, z = np.moveaxis(evidence.position[window] - pose.r, -1, 0)
    flat = (x + 1j * y) * np.exp(-1j * float(pose.yaw))
    path = np.stack([flat.real, flat.imag, z], axis=-1)
    before = np.maximum(window - 1, stretch.first)
    changed = evidence.point[window] != evidence.point[before]
    changed &= under_way(evidence)[before, None]  # not those with whom it begins
    how = "" if stretch.settled else "not settled, "
    name = ", ".join(filter(None, (f"leg {stretch.leg + 1}", called(evidence, stretch.leg))))
    degrees = round(float(np.degrees(pose.yaw))) % 360
    title = (
        f"{letter(number)} {name}\n{how}"
        f"{fit.error:.3f} m off, turned by {degrees}°{', upside down' * fit.inverted}"
    )
    return Scene(
        title,
        formation,
        path[thinned(len(path), PIECES)],
        path[changed],
        evidence.avoiding[stretch.last],
    )


def _deep(scene: Scene) -> bool:
    return not scene.formation.flat


def _size(scenes: list[Scene]) -> Float[Array, " 3"]:
    # What the largest scene needs; all get as much, so that all have one scale.
    sizes = [np.ptp(s.path.reshape(-1, 3), axis=0) for s in scenes]
    sizes += [np.ptp(s.formation.points, axis=0) for s in scenes]
    size = np.max(sizes, axis=0) + 2 * ROOM
    size[0] = max(size[0], size[1] / TALL)
    return np.asarray(size)


def _panels(
    count: int, columns: int, views: list[str], size: Float[Array, " 3"]
) -> tuple[Figure, list[list[Any]]]:
    rows, shares = ceil(count / columns), [float(size[AXES[v][1]] / size[0]) for v in views]
    width = min(WIDTHS[columns], HIGHEST / sum(shares))
    heights = [width * share for share in shares]
    figure = Figure(figsize=(columns * (width + 0.5) + 0.2, rows * (sum(heights) + 1.25) + 0.6))
    figure.set_layout_engine("constrained", h_pad=0.06)
    grid = figure.add_gridspec(rows * len(views), columns, height_ratios=heights * rows)
    axes = []
    for i in range(count):
        row, column = divmod(i, columns)
        cells = [grid[row * len(views) + k, column] for k in range(len(views))]
        axes.append([figure.add_subplot(cell) for cell in cells])
    return figure, axes


def _frame(ax: Any, scene: Scene, shown: tuple[int, int], size: Float[Array, " 3"]) -> None:
    every = np.concatenate([scene.path.reshape(-1, 3), scene.formation.points])
    middle = (every.min(axis=0) + every.max(axis=0)) / 2
    low, high = middle - size / 2, middle + size / 2
    a, b = shown
    ax.set(xlim=(low[a], high[a]), ylim=(low[b], high[b]), aspect="equal")
    ax.set(xlabel=f"{'xyz'[a]} [m]", ylabel=f"{'xyz'[b]} [m]")


def _draw(ax: Any, scene: Scene, shown: tuple[int, int]) -> None:
    points, path = scene.formation.points[:, shown], scene.path[..., shown]
    pairs = np.argwhere(np.triu(scene.formation.graph))
    if len(pairs) <= FEW:
        ax.add_collection(LineCollection(list(points[pairs]), colors=PALE, lw=0.6, zorder=1))
    ax.scatter(*points.T, marker="+", s=22, lw=0.7, color=GREY, zorder=1.2)
    ax.add_collection(_fading(path))
    at, colours = path[-1], np.where(scene.avoiding, ORANGE, DARK)
    if shown == AXES["side"]:
        half = np.array([DIAMETER / 2, 0.0])
        edge_on = np.stack([at - half, at + half], axis=1)
        ax.add_collection(LineCollection(list(edge_on), colors=colours, lw=2.4, zorder=4))
        return
    ax.plot(*scene.turns[:, shown].T, "o", ms=2.2, mew=0.6, mfc="white", mec=RED, zorder=3)
    wide = np.full(len(at), DIAMETER)
    ax.add_collection(
        EllipseCollection(
            wide, wide, 0 * wide, units="xy", offsets=at, offset_transform=ax.transData,
            facecolors=colours, edgecolors="white", linewidths=0.3, zorder=4,
        )
    )  # fmt: skip


def _fading(path: Float[Array, "k agents 2"]) -> LineCollection:
    # One piece after the other in time, so that what is later lies above what is earlier.
    pieces = np.stack([path[:-1], path[1:]], axis=2).reshape(-1, 2, 2)
    age = np.linspace(1, 0, max(len(path) - 1, 1))[: len(path) - 1, None]
    strength = 1 - (1 - PALEST) * age**2
    colours = np.repeat(1 - strength * (1 - np.array(to_rgb(BLUE))), path.shape[1], axis=0)
    return LineCollection(list(pieces), colors=colours, lw=0.9, capstyle="round", zorder=2)


def _key(scenes: list[Scene]) -> list[Any]:
    disc: dict[str, Any] = {"ls": "", "marker": "o", "ms": 5, "mew": 0}
    key = [
        Line2D([], [], color=BLUE, lw=1.2, label=f"path of the last {LAST:g} s, paler is earlier")
    ]
    if any(len(s.turns) for s in scenes):
        ring: dict[str, Any] = {
            "ls": "",
            "marker": "o",
            "ms": 3.5,
            "mew": 0.9,
            "mfc": "white",
            "mec": RED,
        }
        key.append(Line2D([], [], **ring, label="takes another point here"))
    key.append(Line2D([], [], **disc, color=DARK, label=f"vehicle, {DIAMETER:g} m wide"))
    if any(s.avoiding.any() for s in scenes):
        key.append(Line2D([], [], **disc, color=ORANGE, label="avoids others at the end"))
    key.append(Line2D([], [], ls="", marker="+", ms=5, color=GREY, label="point of the shape"))
    if any(s.formation.graph.sum() / 2 <= FEW for s in scenes):
        key.append(Line2D([], [], color=PALE, lw=0.8, label="who measure each other"))
    return key
