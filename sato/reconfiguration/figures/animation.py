"""Animation of a run: between control instants agents move on cubic pieces."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]
from numpy import ndarray as Array

from dynamics.trajectory_geometry import control_points, evaluate_bezier
from sato.figures.axes import AxisBounds, set_axis_bounds, set_panel_title
from sato.figures.snapshot import Snapshot, draw_swarm
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.figures.snapshots import (
    all_used_targets,
    plot_margin,
    pluralize,
    read_leg_names,
    select_view,
)

TRAIL_STEPS = 12  # control steps
FRAMES_PER_STEP = 8  # frames a control step, at most
DPI = 110


class SwarmAnimation:
    """Animation of a swarm, with trails behind the agents."""

    def __init__(self, record: ReconfigurationRecord) -> None:
        self._record, self._view = record, select_view(record)
        self._leg_names, self._targets = read_leg_names(record), all_used_targets(record)
        self._position = self._view.project(record.position)
        x = np.moveaxis(self._position, 0, 1)
        v = np.moveaxis(self._view.project(record.velocity), 0, 1)
        self._control_points = np.moveaxis(control_points(x, v, record.mission.step), 0, 1)
        shown = np.where(record.alive[..., None], self._position, np.nan)
        self._space = AxisBounds.enclosing(
            self._view, shown, *self._targets, margin=plot_margin(record)
        )
        height = 5.4 * min(self._space.aspect, 1.6) + 0.6
        figure = Figure(figsize=(6.0, height), dpi=DPI, layout="constrained")
        self.canvas = FigureCanvasAgg(figure)
        flat = self._space.axes == 2
        self.axes: Any = figure.add_subplot(**({} if flat else {"projection": "3d"}))
        # Laid out once: nothing that is shown later needs more room.
        self.draw_frame(0.0)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")

    def frame_positions(self, most: int) -> Float[Array, " frames"]:
        """Return evenly spaced instants, counted in control steps, at most so many."""
        steps = len(self._record.time) - 1
        return np.linspace(0, steps, max(2, min(most, FRAMES_PER_STEP * steps + 1)) if steps else 1)

    def draw_frame(self, instant: float) -> None:
        """Draw the swarm at an instant, counted in control steps."""
        record, ax = self._record, self.axes
        k = min(int(instant), len(record.time) - 1)
        ax.clear()
        set_axis_bounds(ax, self._space)
        leg, component = int(record.leg[k]), record.component[k]
        snapshot = Snapshot("", self._positions_at(instant), component, self._targets[leg])
        self._draw_trails(instant, k)
        draw_swarm(ax, snapshot, self._space, size=16)
        count = len(np.unique(component[component >= 0]))
        set_panel_title(
            ax,
            f"leg {leg + 1}, {self._leg_names[leg]}     t = {self._format_time(instant)}"
            f"     {int(record.alive[k].sum())} agents in {pluralize(count, 'component')}",
        )

    def _format_time(self, instant: float) -> str:
        view, time = self._view, instant * self._record.mission.step
        digits = 1 if view.time_unit == "min" else 0
        return f"{time * view.time_scale:.{digits}f} {view.time_unit}"

    def _positions_at(self, instant: float) -> Float[Array, "agents d"]:
        k = int(instant)
        if k >= len(self._control_points):
            return np.asarray(self._position[-1])
        pieces = self._control_points[k]
        return np.asarray(evaluate_bezier(pieces, np.full(len(pieces), instant - k)))

    def _draw_trails(self, instant: float, k: int) -> None:
        record = self._record
        since = max(0, k - TRAIL_STEPS)
        path = np.concatenate([self._position[since : k + 1], self._positions_at(instant)[None]])
        path = path / self._space.unit[0]
        lines = path[:, record.alive[since : k + 1].all(axis=0)].swapaxes(0, 1)
        kind = LineCollection if self._space.axes == 2 else Line3DCollection
        self.axes.add_collection(kind(list(lines), colors="#b9cbd8", lw=0.8, zorder=1.5))
