"""Animation of a run: between control instants agents move on cubic pieces."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy import ndarray as Array

from sato.figures.axes import add_axes, draw_paths, set_axis_bounds
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.figures.scene import TRAIL_COLOR, Scene, draw_swarm, pluralize

TRAIL_STEPS, TRAIL_POINTS = 12, 49  # control steps behind an agent, and points in them
FRAMES_PER_STEP = 8  # frames a control step, at most
DPI = 110


class SwarmAnimation:
    """Animation of a swarm, with trails behind the agents."""

    def __init__(self, record: ReconfigurationRecord) -> None:
        self._record, self._scene = record, Scene(record)
        self._space = self._scene.enclose(self._scene.path, *self._scene.targets)
        height = 5.4 * min(self._space.aspect, 1.6) + 0.6
        figure = Figure(figsize=(6.0, height), dpi=DPI, layout="constrained")
        self.canvas = FigureCanvasAgg(figure)
        self.axes: Any = add_axes(figure, self._space)
        # Laid out once: nothing that is shown later needs more room.
        self.draw_frame(0.0)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")

    def frame_positions(self, most: int) -> Float[Array, " frames"]:
        """Return evenly spaced instants, counted in control steps, at most so many."""
        steps = len(self._record.time) - 1
        return np.linspace(0, steps, min(most, FRAMES_PER_STEP * steps + 1))

    def draw_frame(self, instant: float) -> None:
        """Draw the swarm at an instant, counted in control steps."""
        record, scene, ax = self._record, self._scene, self.axes
        k = int(instant)
        leg, component = int(record.leg_index[k]), record.frames.component[k]
        begin = max(0, instant - TRAIL_STEPS)
        trail = scene.positions_at(np.linspace(begin, instant, TRAIL_POINTS))
        ax.clear()
        set_axis_bounds(ax, self._space)
        draw_paths(ax, self._space, trail, TRAIL_COLOR)
        draw_swarm(ax, scene.snapshot_at("", instant, component, leg), self._space)
        time = scene.view.format_time(round(instant) * record.mission.step)
        count = len(np.unique(component[component >= 0]))
        ax.set_title(
            f"leg {leg + 1}, {scene.leg_names[leg]}     t = {time}     "
            f"{int(record.frames.alive[k].sum())} agents in {pluralize(count, 'component')}"
        )
