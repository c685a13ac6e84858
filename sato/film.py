"""Frames of the film of a run, in its plane or in space, drawn from its scene."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from mpl_toolkits.mplot3d.art3d import Poly3DCollection  # type: ignore[import-untyped]  # no stubs
from numpy import ndarray as Array
from scipy.interpolate import CubicHermiteSpline

from sato.figures.axes import (
    ORBITAL_PLANE,
    ORBITAL_SPACE,
    AxisBounds,
    Projection,
    add_axes,
    add_legend,
    as_label,
    draw_paths,
    set_axis_bounds,
)
from sato.figures.panels import mark_broken
from sato.figures.style import BLUE, DARK_GRAY, GRAY, LIGHT_GRAY
from sato.scene import ABSENT, ALIVE, LOST, ORBIT, Coloring, SwarmScene, list_links

TRAIL_SHARE, TRAIL_POINTS = 0.08, 40  # of the flight behind a vehicle, and points in it
TRAIL_COLOR = "#9fb4c2"
MARKERS = ("o", "s", "^", "D", "v", "P")  # of categories, in order
MAX_LINKS, SAMPLES = 400, 20  # links that do not hide the vehicles, at some instants
FRAMES_PER_INSTANT = 8  # at most, where instants are far apart
TURN, AZIMUTH, ELEVATION = 50.0, -70.0, 24.0  # of the view of space over the film [°]
DPI = 110


class SwarmFilm:
    """Film of a scene: trails behind the vehicles, links, targets and obstacles.

    Flat scenes are seen from above, or in the orbital plane; others in space, which turns slowly.
    """

    def __init__(self, scene: SwarmScene) -> None:
        self._scene, d = scene, scene.position.shape[2]
        shown = tuple(range(2 if scene.is_flat else d))
        self._view = Projection(shown, ("x", "y", "z")[: len(shown)])
        if scene.viewpoint is ORBIT:
            self._view = ORBITAL_PLANE if scene.is_flat else ORBITAL_SPACE
        alike = Coloring("kind", np.zeros(scene.status.shape), categories=(("vehicle", BLUE),))
        self._coloring = next((one for one in scene.colorings if one.categories), alike)
        targets = self._view.project(scene.targets.position)
        there = self._view.project(scene.position[scene.status != ABSENT])
        margin = float(scene.diameter.max())
        self._space = AxisBounds.enclosing(self._view.labels, there, targets, margin=margin)
        some = np.linspace(0, len(scene.time) - 1, SAMPLES).astype(int)
        self._has_links = max(len(list_links(scene, int(k))) for k in some) <= MAX_LINKS
        states = scene.time, scene.position, scene.velocity
        self._cubic = CubicHermiteSpline(*states) if len(scene.time) > 1 else None
        height = 5.4 * min(self._space.aspect, 1.6) + 1.1
        figure = Figure(figsize=(6.4, height), dpi=DPI)
        # The room that the labels of a view of space take is not all seen by the layout.
        width = 1.0 if self._space.is_flat else 0.88
        figure.set_layout_engine("constrained", rect=(0, 0, width, 1))
        self.canvas = FigureCanvasAgg(figure)
        self.axes: Any = add_axes(figure, self._space)
        self._add_legend(figure)
        # Laid out once: nothing that is shown later needs more room.
        self.draw_frame(float(scene.time[0]))
        figure.draw_without_rendering()
        figure.set_layout_engine("none")

    def frame_times(self, most: int) -> Float[Array, " frames"]:
        """Return evenly spaced times [s], at most so many."""
        time = self._scene.time
        count = min(most, FRAMES_PER_INSTANT * (len(time) - 1) + 1)
        return np.linspace(time[0], time[-1], count)

    def draw_frame(self, time: float) -> None:
        """Draw the swarm at a time [s]."""
        scene, ax, space, scale = self._scene, self.axes, self._space, self._space.unit[0]
        k = int(np.searchsorted(scene.time, time, side="right")) - 1
        first, last = scene.time[[0, -1]]
        begin = max(first, time - TRAIL_SHARE * (last - first))
        behind = np.linspace(begin, time, TRAIL_POINTS)
        since = np.searchsorted(scene.time, behind, side="right") - 1
        path = np.where(scene.status[since, :, None] == ABSENT, np.nan, self._positions_at(behind))
        trail, status = self._view.project(path), scene.status[k]
        ax.clear()
        set_axis_bounds(ax, space)
        self._draw_obstacles(time)
        draw_paths(ax, space, trail, TRAIL_COLOR)
        place = self._view.project(self._positions_at(np.array([time]))[0])
        if self._has_links:
            ends = place[list_links(scene, k).T]
            draw_paths(ax, space, ends, LIGHT_GRAY, lw=0.6, zorder=0.9, label=scene.links.name)
        targets = self._view.project(scene.targets.position[scene.targets.stage[k]]) / scale
        ax.plot(*targets.T, "x", color=LIGHT_GRAY, ms=3.3, mew=0.6, zorder=1)
        values = np.where(status == ALIVE, self._coloring.values[k], np.nan)
        for number, (_, color) in enumerate(self._coloring.categories):
            style = {"marker": MARKERS[number], "color": color, "ls": "", "ms": 4.2, "mew": 0}
            ax.plot(*place[values == number].T / scale, **style, zorder=3)
        ax.plot(*place[status == LOST].T / scale, "x", color=DARK_GRAY, ms=4.5, mew=1.1, zorder=2)
        stage = [as_label(name) for start, name in scene.stages if start <= time]
        words = [*stage[-1:], f"t = {self._view.format_time(round(time, 1))}"]
        words.append(f"{int((status == ALIVE).sum())} vehicles")
        for promise in scene.broken:
            if promise.time is not None and promise.time <= time:
                at = self._positions_at(np.array([promise.time]))[0][list(promise.agents)]
                mark_broken(ax, scale, self._view.project(at), promise.name)
                words = [*words[:3], f"broken: {promise.name}"]
        ax.set_title("     ".join(words))
        if not space.is_flat:
            turned = TURN * (time - first) / max(last - first, 1e-9)
            ax.view_init(elev=ELEVATION, azim=AZIMUTH + turned)

    def _positions_at(self, times: Float[Array, " k"]) -> Float[Array, "k agents d"]:
        """Return positions on cubic pieces between the instants [m]."""
        if self._cubic is None:
            return np.repeat(self._scene.position, len(times), axis=0)
        return np.asarray(self._cubic(times))

    def _draw_obstacles(self, time: float) -> None:
        kind = PolyCollection if self._space.is_flat else Poly3DCollection
        low, high = self._space.low, self._space.high
        for hull in self._scene.obstacles:
            at = self._view.project(hull.vertices + time * hull.velocity)
            corners = np.clip(at, low, high)[hull.triangles] / self._space.unit[0]
            if np.ptp(np.clip(at, low, high), axis=0).any():
                look: dict[str, Any] = {"facecolors": LIGHT_GRAY, "alpha": 0.5, "lw": 0}
                self.axes.add_collection(kind(list(corners), zorder=0.8, **look))

    def _add_legend(self, figure: Figure) -> None:
        scene, used = self._scene, np.unique(self._coloring.values)
        dot: dict[str, Any] = {"ls": "", "ms": 4.5, "mew": 0}
        entries = [
            Line2D([], [], marker=MARKERS[n], color=color, label=name, **dot)
            for n, (name, color) in enumerate(self._coloring.categories)
            if n in used
        ]
        if (scene.status == LOST).any():
            entries.append(Line2D([], [], marker="x", color=DARK_GRAY, ls="", ms=4.5, label="lost"))
        if np.isfinite(scene.targets.position).any():
            look: dict[str, Any] = {"marker": "x", "color": LIGHT_GRAY, "ls": "", "ms": 4}
            entries.append(Line2D([], [], **look, label=scene.targets.name))
        if self._has_links:
            entries.append(Line2D([], [], color=GRAY, lw=0.8, label=scene.links.name))
        add_legend(figure, *entries, title=self._coloring.name)
