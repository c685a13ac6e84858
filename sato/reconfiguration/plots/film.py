"""A run as it is filmed: between control instants the agents are on their cubic pieces."""

from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]
from numpy import ndarray as Array

from dynamics.path import at, controls
from sato.plots.swarm import Snapshot, draw_swarm
from sato.plots.view import Space, entitle, set_space
from sato.reconfiguration.check.evidence import Evidence
from sato.reconfiguration.plots.perspective import view_of
from sato.reconfiguration.plots.stages import all_goals, leg_names, margin

TRAIL = 12  # control steps
SMOOTH = 8  # frames a control step, at most
DPI = 110


class Film:
    """The axes, and all that is known before the first frame."""

    def __init__(self, evidence: Evidence) -> None:
        self._evidence, self._view = evidence, view_of(evidence)
        self._names, self._goals = leg_names(evidence), all_goals(evidence)
        self._position = self._view.of(evidence.position)
        x = np.moveaxis(self._position, 0, 1), np.moveaxis(self._view.of(evidence.velocity), 0, 1)
        self._pieces = np.moveaxis(controls(*x, evidence.mission.step), 0, 1)
        shown = np.where(evidence.alive[..., None], self._position, np.nan)
        self._space = Space.around(self._view, shown, *self._goals, margin=margin(evidence))
        height = 5.4 * min(self._space.aspect, 1.6) + 0.6
        figure = Figure(figsize=(6.0, height), dpi=DPI, layout="constrained")
        self.canvas = FigureCanvasAgg(figure)
        flat = self._space.axes == 2
        self.axes: Any = figure.add_subplot(**({} if flat else {"projection": "3d"}))
        # Laid out once, for nothing that is shown later needs more room.
        self.show(0.0)
        figure.draw_without_rendering()
        figure.set_layout_engine("none")

    def moments(self, most: int) -> Float[Array, " moments"]:
        """So many moments at most, evenly spaced, counted in control steps."""
        steps = len(self._evidence.time) - 1
        return np.linspace(0, steps, max(2, min(most, SMOOTH * steps + 1)) if steps else 1)

    def show(self, moment: float) -> None:
        """Draw the swarm at a moment, counted in control steps."""
        evidence, ax = self._evidence, self.axes
        k = min(int(moment), len(evidence.time) - 1)
        ax.clear()
        set_space(ax, self._space)
        leg, component = int(evidence.leg[k]), evidence.component[k]
        shot = Snapshot("", self._where(moment), component, self._goals[leg])
        self._trails(moment, k)
        draw_swarm(ax, shot, self._space, size=16)
        count = len(np.unique(component[component >= 0]))
        entitle(
            ax,
            f"leg {leg + 1}, {self._names[leg]}     t = {self._clock(moment)}"
            f"     {int(evidence.alive[k].sum())} agents in {count} "
            f"{'component' if count == 1 else 'components'}",
        )

    def _clock(self, moment: float) -> str:
        view, seconds = self._view, moment * self._evidence.mission.step
        return f"{seconds * view.second:.{1 if view.time == 'min' else 0}f} {view.time}"

    def _where(self, moment: float) -> Float[Array, "agents d"]:
        k = int(moment)
        if k >= len(self._pieces):
            return np.asarray(self._position[-1])
        return np.asarray(at(self._pieces[k], np.full(len(self._pieces[k]), moment - k)))

    def _trails(self, moment: float, k: int) -> None:
        evidence = self._evidence
        scale, _ = self._space.unit
        since = max(0, k - TRAIL)
        path = np.concatenate([self._position[since : k + 1], self._where(moment)[None]]) / scale
        lines = path[:, evidence.alive[since : k + 1].all(axis=0)].swapaxes(0, 1)
        kind = LineCollection if self._space.axes == 2 else Line3DCollection
        self.axes.add_collection(kind(list(lines), colors="#b9cbd8", lw=0.8, zorder=1.5))
