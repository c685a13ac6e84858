"""A run as it is filmed: between control instants the agents are on their cubic pieces."""

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
from sato.reconfiguration.figures.perspective import select_view
from sato.reconfiguration.figures.snapshots import all_used_targets, plot_margin, read_leg_names

TRAIL_STEPS = 12  # control steps
FRAMES_PER_STEP = 8  # frames a control step, at most
DPI = 110


class SwarmAnimation:
    """The axes, and all that is known before the first frame."""

    def __init__(self, evidence: ReconfigurationRecord) -> None:
        self._evidence, self._view = evidence, select_view(evidence)
        self._leg_names, self._targets = read_leg_names(evidence), all_used_targets(evidence)
        self._position = self._view.project(evidence.position)
        x = (
            np.moveaxis(self._position, 0, 1),
            np.moveaxis(self._view.project(evidence.velocity), 0, 1),
        )
        self._control_points = np.moveaxis(control_points(*x, evidence.mission.step), 0, 1)
        shown = np.where(evidence.alive[..., None], self._position, np.nan)
        self._space = AxisBounds.enclosing(
            self._view, shown, *self._targets, margin=plot_margin(evidence)
        )
        height = 5.4 * min(self._space.aspect, 1.6) + 0.6
        figure = Figure(figsize=(6.0, height), dpi=DPI, layout="constrained")
        self.canvas = FigureCanvasAgg(figure)
        flat = self._space.axes == 2
        self.axes: Any = figure.add_subplot(**({} if flat else {"projection": "3d"}))
        # Laid out once, for nothing that is shown later needs more room.
        self.draw_frame(0.0)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")

    def frame_positions(self, most: int) -> Float[Array, " frames"]:
        """So many moments at most, evenly spaced, counted in control steps."""
        steps = len(self._evidence.time) - 1
        return np.linspace(0, steps, max(2, min(most, FRAMES_PER_STEP * steps + 1)) if steps else 1)

    def draw_frame(self, moment: float) -> None:
        """Draw the swarm at a moment, counted in control steps."""
        evidence, ax = self._evidence, self.axes
        k = min(int(moment), len(evidence.time) - 1)
        ax.clear()
        set_axis_bounds(ax, self._space)
        leg, component = int(evidence.leg[k]), evidence.component[k]
        shot = Snapshot("", self._positions_at(moment), component, self._targets[leg])
        self._draw_trails(moment, k)
        draw_swarm(ax, shot, self._space, size=16)
        count = len(np.unique(component[component >= 0]))
        set_panel_title(
            ax,
            f"leg {leg + 1}, {self._leg_names[leg]}     t = {self._format_time(moment)}"
            f"     {int(evidence.alive[k].sum())} agents in {count} "
            f"{'component' if count == 1 else 'components'}",
        )

    def _format_time(self, moment: float) -> str:
        view, seconds = self._view, moment * self._evidence.mission.step
        return (
            f"{seconds * view.time_scale:.{1 if view.time_unit == 'min' else 0}f} {view.time_unit}"
        )

    def _positions_at(self, moment: float) -> Float[Array, "agents d"]:
        k = int(moment)
        if k >= len(self._control_points):
            return np.asarray(self._position[-1])
        return np.asarray(
            evaluate_bezier(
                self._control_points[k], np.full(len(self._control_points[k]), moment - k)
            )
        )

    def _draw_trails(self, moment: float, k: int) -> None:
        evidence = self._evidence
        scale, _ = self._space.unit
        since = max(0, k - TRAIL_STEPS)
        path = (
            np.concatenate([self._position[since : k + 1], self._positions_at(moment)[None]])
            / scale
        )
        lines = path[:, evidence.alive[since : k + 1].all(axis=0)].swapaxes(0, 1)
        kind = LineCollection if self._space.axes == 2 else Line3DCollection
        self.axes.add_collection(kind(list(lines), colors="#b9cbd8", lw=0.8, zorder=1.5))
