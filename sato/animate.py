"""A run as a film: MP4 where ffmpeg is at hand, else GIF."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection  # type: ignore[import-untyped]
from numpy import ndarray as Array
from PIL import Image

from dynamics.path import at, controls
from sato.check import Evidence, rebuild
from sato.plots.look import STYLE
from sato.plots.swarm import Snapshot, all_goals, draw_swarm, leg_names, margin
from sato.plots.view import Space, entitle, set_space, view_of
from sato.record import Run

FRAMES = 300
TRAIL = 12  # control steps
SMOOTH = 8  # frames a control step, at most
DPI = 110
COLOURS = 64  # of a GIF

Progress = Callable[[int, int], object]


def animate(
    run: Run,
    directory: str | Path,
    fps: int = 20,
    frames: int = FRAMES,
    progress: Progress | None = None,
) -> Path:
    """Film a run.

    Args:
        run: The run.
        directory: Where the film goes; made if it is missing.
        fps: Frames a second.
        frames: At most so many frames, evenly spaced in time; between control instants
            the agents are on their cubic pieces.
        progress: Called with the frames drawn so far and their number.

    Returns:
        The film, `run.mp4` or `run.gif`.

    Raises:
        ValueError: There is nothing to film at that rate.
    """
    if fps < 1 or frames < 1:
        raise ValueError(f"a film needs frames and a rate, got {frames} frames at {fps} a second")
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    evidence = Evidence.of(run.data, rebuild(run.data))
    name = "run.mp4" if shutil.which("ffmpeg") else "run.gif"
    with matplotlib.rc_context(STYLE):
        scene = Scene(evidence)
        shown = _shown(scene, _moments(evidence, frames), progress)
        (_mp4 if name == "run.mp4" else _gif)(scene.canvas, shown, directory / name, fps)
    return directory / name


def _shown(
    scene: "Scene", moments: Float[Array, " frames"], progress: Progress | None
) -> Iterator[None]:
    for i, moment in enumerate(moments):
        scene.show(float(moment))
        yield
        if progress is not None:
            progress(i + 1, len(moments))


def _mp4(canvas: FigureCanvasAgg, shown: Iterator[None], path: Path, fps: int) -> None:
    # Even sizes and yuv420p: what browsers and slides play.
    even = "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white"
    writer = FFMpegWriter(fps=fps, extra_args=["-pix_fmt", "yuv420p", "-vf", even])
    with writer.saving(canvas.figure, str(path), dpi=DPI):
        for _ in shown:
            writer.grab_frame()


def _gif(canvas: Any, shown: Iterator[None], path: Path, fps: int) -> None:
    def images() -> Iterator[Image.Image]:
        for _ in shown:
            canvas.draw()
            image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
            yield image.quantize(COLOURS, dither=Image.Dither.NONE)

    film = images()
    first = next(film)
    first.save(path, save_all=True, append_images=film, duration=round(1000 / fps), loop=0)


class Scene:
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


def _moments(evidence: Evidence, frames: int) -> Float[Array, " frames"]:
    steps = len(evidence.time) - 1
    return np.linspace(0, steps, max(2, min(frames, SMOOTH * steps + 1)) if steps else 1)
