"""Trajectories at the end of each leg [Lusk2020, Fig. 5]."""

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
from problems.desired_formation import DesiredFormation
from sato.figures.axes import panel_letter
from sato.figures.style import BLUE, DARK_GRAY, GRAY, LIGHT_GRAY, ORANGE, RED
from sato.formation.check import FormationRecord
from sato.formation.check.recorded import FormationLegRecord
from sato.formation.figures.phases import formation_name, is_leg_active, subsample
from sato.formation.shape_error import compute_shape_error

SHOWN_TIME = 40.0  # at the end of a leg [s]
VEHICLE_DIAMETER = 0.5  # of a vehicle [Lusk2020, sec. V] [m]
MAX_PIECES = 300  # of a trace
MAX_DRAWN_EDGES = 60  # up to which edges are drawn
MIN_OPACITY = 0.2  # of a trace at its beginning, relative to its end
MARGIN = 1.0  # around agents and points [m]
MAX_COLUMNS = 3
PANEL_WIDTHS = {1: 6.6, 2: 4.4, 3: 3.4}  # by the number of columns [in]
MAX_ROW_HEIGHT = 6.5  # of a panel and the one below [in]
MAX_ASPECT = 1.35  # height of a panel over its width
VIEW_AXES = {"top": (0, 1), "side": (0, 2)}


class LegScene(NamedTuple):
    """End of a leg, in the axes of its formation."""

    title: str
    formation: DesiredFormation
    positions: Float[Array, "instants agents 3"]  # [m]
    reassignment_positions: Float[Array, "changes 3"]  # at new assignments under way [m]
    is_avoiding: Bool[Array, " agents"]  # at the end


def plot_paths(record: FormationRecord) -> Figure:
    """Plot the last 40 s of each leg from above, and from the side unless all are flat.

    All panels have one scale, in which vehicles are to scale too. Each leg is drawn in the
    axes of its formation, aligned with the vehicles at the end.
    """
    last = len(record.time) - 1
    legs = record.replay.legs or (FormationLegRecord(0, 0, last, last, completed=False),)
    scenes = [_make_scene(record, leg, i) for i, leg in enumerate(legs)]
    columns = min(len(scenes), MAX_COLUMNS) if len(scenes) != 4 else 2
    views = ["top", "side"] if any(not s.formation.is_flat for s in scenes) else ["top"]
    size = _scene_size(scenes)
    figure, axes = _make_panels(len(scenes), columns, views, size)
    for scene, own in zip(scenes, axes, strict=True):
        for view, ax in zip(views, own, strict=True):
            _set_limits(ax, scene, VIEW_AXES[view], size)
            _draw_scene(ax, scene, VIEW_AXES[view])
        own[0].set_title(scene.title)
    figure.legend(
        handles=_legend_handles(scenes), loc="outside lower center", ncols=min(2 * columns, 5)
    )
    return figure


def _make_scene(record: FormationRecord, leg: FormationLegRecord, number: int) -> LegScene:
    formation = record.mission.gains[leg.leg].formation
    first = np.searchsorted(record.time, record.time[leg.last_instant] - SHOWN_TIME)
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
    title = (
        f"{panel_letter(number)} {name}\n{state}"
        f"{fit.error:.3f} m off, turned by {degrees}°{', upside down' * fit.inverted}"
    )
    return LegScene(
        title,
        formation,
        path[subsample(len(path), MAX_PIECES)],
        path[changed],
        record.frames.avoiding[leg.last_instant],
    )


def _scene_size(scenes: list[LegScene]) -> Float[Array, " 3"]:
    # All scenes have the size of the largest, so that all have one scale.
    sizes = [np.ptp(s.positions.reshape(-1, 3), axis=0) for s in scenes]
    sizes += [np.ptp(s.formation.points, axis=0) for s in scenes]
    size = np.max(sizes, axis=0) + 2 * MARGIN
    size[0] = max(size[0], size[1] / MAX_ASPECT)
    return np.asarray(size)


def _make_panels(
    count: int, columns: int, views: list[str], size: Float[Array, " 3"]
) -> tuple[Figure, list[list[Any]]]:
    rows, shares = ceil(count / columns), [float(size[VIEW_AXES[v][1]] / size[0]) for v in views]
    width = min(PANEL_WIDTHS[columns], MAX_ROW_HEIGHT / sum(shares))
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


def _set_limits(ax: Any, scene: LegScene, shown: tuple[int, int], size: Float[Array, " 3"]) -> None:
    every = np.concatenate([scene.positions.reshape(-1, 3), scene.formation.points])
    middle = (every.min(axis=0) + every.max(axis=0)) / 2
    low, high = middle - size / 2, middle + size / 2
    a, b = shown
    ax.set(xlim=(low[a], high[a]), ylim=(low[b], high[b]), aspect="equal")
    ax.set(xlabel=f"{'xyz'[a]} [m]", ylabel=f"{'xyz'[b]} [m]")


def _draw_scene(ax: Any, scene: LegScene, shown: tuple[int, int]) -> None:
    points, path = scene.formation.points[:, shown], scene.positions[..., shown]
    pairs = np.argwhere(np.triu(scene.formation.graph))
    if len(pairs) <= MAX_DRAWN_EDGES:
        ax.add_collection(LineCollection(list(points[pairs]), colors=LIGHT_GRAY, lw=0.6, zorder=1))
    ax.scatter(*points.T, marker="+", s=22, lw=0.7, color=GRAY, zorder=1.2)
    ax.add_collection(_fading_paths(path))
    at, colors = path[-1], np.where(scene.is_avoiding, ORANGE, DARK_GRAY)
    if shown == VIEW_AXES["side"]:
        half = np.array([VEHICLE_DIAMETER / 2, 0.0])
        edge_on = np.stack([at - half, at + half], axis=1)
        ax.add_collection(LineCollection(list(edge_on), colors=colors, lw=2.4, zorder=4))
        return
    rings = scene.reassignment_positions[:, shown].T
    ax.plot(*rings, "o", ms=2.2, mew=0.6, mfc="white", mec=RED, zorder=3)
    wide = np.full(len(at), VEHICLE_DIAMETER)
    ax.add_collection(
        EllipseCollection(
            wide, wide, 0 * wide, units="xy", offsets=at, offset_transform=ax.transData,
            facecolors=colors, edgecolors="white", linewidths=0.3, zorder=4,
        )
    )  # fmt: skip


def _fading_paths(path: Float[Array, "k agents 2"]) -> LineCollection:
    # Pieces in the order of time, so that later ones lie above earlier ones.
    pieces = np.stack([path[:-1], path[1:]], axis=2).reshape(-1, 2, 2)
    age = np.linspace(1, 0, max(len(path) - 1, 1))[: len(path) - 1, None]
    strength = 1 - (1 - MIN_OPACITY) * age**2
    colors = np.repeat(1 - strength * (1 - np.array(to_rgb(BLUE))), path.shape[1], axis=0)
    return LineCollection(list(pieces), colors=colors, lw=0.9, capstyle="round", zorder=2)


def _legend_handles(scenes: list[LegScene]) -> list[Any]:
    disc: dict[str, Any] = {"ls": "", "marker": "o", "ms": 5, "mew": 0}
    path = f"path of the last {SHOWN_TIME:g} s, paler is earlier"
    key = [Line2D([], [], color=BLUE, lw=1.2, label=path)]
    if any(len(s.reassignment_positions) for s in scenes):
        ring: dict[str, Any] = {"ls": "", "marker": "o", "ms": 3.5, "mew": 0.9, "mfc": "white"}
        key.append(Line2D([], [], **ring, mec=RED, label="assigned another point here"))
    vehicle = f"vehicle, {VEHICLE_DIAMETER:g} m wide"
    key.append(Line2D([], [], **disc, color=DARK_GRAY, label=vehicle))
    if any(s.is_avoiding.any() for s in scenes):
        key.append(Line2D([], [], **disc, color=ORANGE, label="avoids others at the end"))
    key.append(Line2D([], [], ls="", marker="+", ms=5, color=GRAY, label="point of the formation"))
    if any(s.formation.graph.sum() / 2 <= MAX_DRAWN_EDGES for s in scenes):
        key.append(Line2D([], [], color=LIGHT_GRAY, lw=0.8, label="neighbors"))
    return key
