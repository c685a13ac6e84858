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
from numpy import ndarray as Array
from PIL import Image

from sato.figures.style import STYLE
from sato.interfaces import Animation
from sato.record import Run
from sato.systems import load_system
from sato.verify import rebuild_mission

MAX_FRAMES = 300
GIF_COLORS = 64  # of a GIF

ProgressCallback = Callable[[int, int], object]


def animate(
    run: Run,
    directory: str | Path,
    fps: int = 20,
    frames: int = MAX_FRAMES,
    progress: ProgressCallback | None = None,
) -> Path:
    """Film a run.

    Args:
        run: The run.
        directory: Where the film goes; made if it is missing.
        fps: Frames a second.
        frames: At most so many frames, evenly spaced in time.
        progress: Called with the frames drawn so far and their number.

    Returns:
        The film, `run.mp4` or `run.gif`.

    Raises:
        ValueError: There is nothing to film at that rate, or no film of such a run at all.
    """
    if fps < 1 or frames < 1:
        raise ValueError(f"a film needs frames and a rate, got {frames} frames at {fps} a second")
    of = load_system(str(run.data.attrs["system"]))
    if of.animation is None:
        raise ValueError(f"{of.name} runs have no film, only figures, which `sato plot` draws")
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    name = "run.mp4" if shutil.which("ffmpeg") else "run.gif"
    with matplotlib.rc_context(STYLE):
        scene = of.animation(run.data, rebuild_mission(run.data))
        shown = _draw_frames(scene, scene.frame_positions(frames), progress)
        (_write_mp4 if name == "run.mp4" else _write_gif)(
            scene.canvas, shown, directory / name, fps
        )
    return directory / name


def _draw_frames(
    scene: Animation, moments: Float[Array, " frames"], progress: ProgressCallback | None
) -> Iterator[None]:
    for i, moment in enumerate(moments):
        scene.draw_frame(float(moment))
        yield
        if progress is not None:
            progress(i + 1, len(moments))


def _write_mp4(canvas: FigureCanvasAgg, shown: Iterator[None], path: Path, fps: int) -> None:
    # Even sizes and yuv420p: what browsers and slides play.
    even = "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white"
    writer = FFMpegWriter(fps=fps, extra_args=["-pix_fmt", "yuv420p", "-vf", even])
    with writer.saving(canvas.figure, str(path), dpi=canvas.figure.dpi):
        for _ in shown:
            writer.grab_frame()


def _write_gif(canvas: Any, shown: Iterator[None], path: Path, fps: int) -> None:
    def images() -> Iterator[Image.Image]:
        for _ in shown:
            canvas.draw()
            image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
            yield image.quantize(GIF_COLORS, dither=Image.Dither.NONE)

    film = images()
    first = next(film)
    first.save(path, save_all=True, append_images=film, duration=round(1000 / fps), loop=0)
