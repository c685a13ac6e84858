"""Swarm as figures and animations show it: projected, between control instants too."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from matplotlib.collections import EllipseCollection
from matplotlib.patches import Polygon
from numpy import ndarray as Array
from scipy.spatial import ConvexHull

from dynamics.trajectory_geometry import control_points, evaluate_bezier
from sato.figures.axes import ORBITAL_PLANE, AxisBounds, Projection, as_label
from sato.figures.style import DARK_GRAY, GRAY, ISOLATED, LIGHT_GRAY, style_components
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord

POINTS_PER_STEP = 6  # of a trajectory
TRAIL_COLOR = "#9fb4c2"
OBSTACLE_STYLE: dict[str, Any] = {"fc": "#e4e4e4", "ec": GRAY, "lw": 0.5}
LOST_STYLE: dict[str, Any] = {"color": DARK_GRAY, "mew": 1.1}


class Snapshot(NamedTuple):
    """Swarm at an instant, in projected coordinates."""

    title: str
    position: Float[Array, "agents d"]  # [m]
    component: Int[Array, " agents"]  # −1 while not alive
    targets: Float[Array, "targets d"]  # [m]
    outlines: tuple[Float[Array, "_ d"], ...]  # points on the surface of each obstacle [m]
    lost: Float[Array, "_ d"]  # agents that are lost and coast [m]


class Scene:
    """A run in the projection of its figures, with the targets and names of its legs.

    Without an orbit all axes are shown, else the orbital plane unless another view is given.
    """

    def __init__(self, record: ReconfigurationRecord, view: Projection | None = None) -> None:
        d = record.mission.axes
        everything = Projection(tuple(range(d)), ("x", "y", "z")[:d])
        self.record = record
        self.view = view or (everything if record.variables.chief is None else ORBITAL_PLANE)
        self.leg_names = [as_label(name) for name in record.leg_names]
        self.legs = record.leg_records
        parts = np.arange(POINTS_PER_STEP * (len(record.time) - 1) + 1) / POINTS_PER_STEP
        self.path = self.positions_at(parts)
        self.targets = [self.view.project(used) for used in record.used_targets]
        spacing = record.mission.target_spacing
        self.margin = 0.6 * spacing if np.isfinite(spacing) else 1.0

    def positions_at(self, instants: Float[Array, " k"]) -> Float[Array, "k agents d"]:
        """Return projected positions at instants, counted in control steps."""
        return self.view.project(interpolate_positions(self.record, instants))

    def path_between(self, first: int, last: int) -> Float[Array, "k agents d"]:
        """Return the trajectories between two control instants."""
        return self.path[first * POINTS_PER_STEP : last * POINTS_PER_STEP + 1]

    def enclose(self, *points: Float[Array, "... d"]) -> AxisBounds:
        """Return bounds of axes about some points, with a margin."""
        return AxisBounds.enclosing(self.view.labels, *points, margin=self.margin)

    def snapshot(self, leg: LegRecord, k: int, title: str) -> Snapshot:
        """Return the swarm at an instant of a leg; at its end, before losses of the next leg."""
        record, component = self.record, self.record.frames.component[k]
        if k == leg.end_index and leg.end_event is not None:
            component = np.where(leg.alive, leg.component, -1)
        position = self.view.project(record.frames.position[k])
        outlines = self.outlines_at(k * record.mission.step)
        lost = position[record.is_adrift[k] & (component < 0)]
        return Snapshot(title, position, component, self.targets[leg.leg_index], outlines, lost)

    def outlines_at(self, time: float) -> tuple[Float[Array, "_ d"], ...]:
        """Return points on the surface of each obstacle at a time [s], projected."""
        obstacles = self.record.mission.obstacles
        return tuple(self.view.project(one.place_at(time) + one.surface) for one in obstacles)


def interpolate_positions(
    record: ReconfigurationRecord, instants: Float[Array, " k"]
) -> Float[Array, "k agents d"]:
    """Interpolate positions at instants, counted in control steps; NaN where not alive."""
    x, v = np.moveaxis(record.frames.position, 0, 1), np.moveaxis(record.frames.velocity, 0, 1)
    pieces = np.moveaxis(control_points(x, v, record.mission.step), 0, 1)
    pieces = np.concatenate([pieces, np.repeat(record.frames.position[-1:, :, None], 4, axis=2)])
    k = instants.astype(int)
    fraction = np.repeat((instants - k)[:, None], record.frames.position.shape[1], axis=1)
    is_there = record.frames.alive[k] | record.is_adrift[k]
    return np.where(is_there[..., None], evaluate_bezier(pieces[k], fraction), np.nan)


def draw_swarm(
    ax: Any, shot: Snapshot, space: AxisBounds, size: float = 3.7, radius: float | None = None
) -> None:
    """Draw agents marked by component, targets as light crosses, and circles of a radius [m].

    The size is that of the marks [points]. Without a radius there are no circles.
    """
    scale, _ = space.unit
    draw_obstacles(ax, shot.outlines, space)
    mark = {"ls": "", "marker": "x", "color": LIGHT_GRAY, "mew": 0.6, "zorder": 1}
    ax.plot(*shot.targets.T / scale, ms=0.9 * size, **mark, label="target")
    for members, look, name in style_components(shot.component):
        style = look | {"ls": "", "ms": 0.75 * size if look == ISOLATED else size, "mew": 0}
        ax.plot(*shot.position[members].T / scale, **style, zorder=3, label=name)
    if len(shot.lost):
        ax.plot(*shot.lost.T / scale, "x", ms=1.2 * size, **LOST_STYLE, zorder=2, label="lost")
    if radius is not None:
        at = shot.position[shot.component >= 0] / scale
        wide = np.full(len(at), 2 * radius / scale)
        circles = EllipseCollection(wide, wide, 0 * wide, units="xy", offsets=at,
                                    offset_transform=ax.transData, facecolors="none",
                                    edgecolors=GRAY, linestyles=":", linewidths=0.5)  # fmt: skip
        ax.add_collection(circles)


def draw_obstacles(
    ax: Any, outlines: tuple[Float[Array, "_ d"], ...], space: AxisBounds, **style: Any
) -> None:
    """Draw convex obstacles by points on their surfaces, cut off at the bounds."""
    scale, _ = space.unit
    for points in outlines:
        shown = np.clip(points, space.low, space.high)
        if not np.ptp(shown, axis=0).all():
            continue
        hull, at = ConvexHull(shown), shown / scale
        if at.shape[1] == 2:
            look = OBSTACLE_STYLE | {"label": "obstacle"} | style
            ax.add_patch(Polygon(at[hull.vertices], zorder=0.8, **look))
        else:
            look = {"shade": False, "color": LIGHT_GRAY, "ec": GRAY, "lw": 0.1, "alpha": 0.5}
            ax.plot_trisurf(*at.T, triangles=hull.simplices, **(look | style))


def pluralize(count: int, noun: str) -> str:
    """Return a number with its noun."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"
