"""Figures and animations of a run: PNG or PDF, and MP4, or GIF where ffmpeg is missing."""

import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.animation import FFMpegWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy import ndarray as Array
from PIL import Image

from sato.atomic import replace_atomically
from sato.figures.style import STYLE
from sato.interfaces import Animation
from sato.scenario.errors import InputError
from sato.systems import load_system

if TYPE_CHECKING:
    import xarray

MAX_FRAMES = 300
GIF_COLORS = 64
_MARK = "figure of a run, by sato"  # in the metadata of a figure, by which old ones are found

ProgressCallback = Callable[[int, int], object]


def draw_figures(data: "xarray.Dataset", mission: Any) -> dict[str, Figure]:
    """Draw every figure of a run.

    Args:
        data: Dataset of the run.
        mission: Mission that was flown, drawn.

    Returns:
        Figures by name, in the order of the system.
    """
    figures = {}
    for name, draw in load_system(data.attrs["system"]).figures(data, mission).items():
        with matplotlib.rc_context(STYLE):
            figures[name] = draw()
    return figures


def plot(data: "xarray.Dataset", mission: Any, directory: Path, pdf: bool = False) -> list[Path]:
    """Draw every figure of a run into a directory; figures of earlier runs there are removed.

    Args:
        data: Dataset of the run.
        mission: Mission that was flown, drawn.
        directory: Made if it is missing.
        pdf: PDF instead of PNG.

    Returns:
        The files, in the order of the system's figures.
    """
    figures = draw_figures(data, mission)
    directory.mkdir(parents=True, exist_ok=True)
    for old in (path for end in ("png", "pdf") for path in directory.glob(f"*.{end}")):
        if _MARK.encode() in old.read_bytes():
            old.unlink()
    paths = []
    for name, figure in figures.items():
        path = directory / f"{name}.{'pdf' if pdf else 'png'}"
        FigureCanvasAgg(figure)
        with matplotlib.rc_context(STYLE):
            figure.savefig(path, metadata={"Creator" if pdf else "Software": _MARK})
        paths.append(path)
    return paths


def animate(
    data: "xarray.Dataset",
    mission: Any,
    directory: Path,
    fps: int = 20,
    frames: int = MAX_FRAMES,
    progress: ProgressCallback | None = None,
) -> Path:
    """Animate a run.

    Args:
        data: Dataset of the run.
        mission: Mission that was flown, drawn.
        directory: Made if it is missing.
        fps: Frames per second.
        frames: At most so many frames, evenly spaced in time.
        progress: Called with the frames drawn so far and their number.

    Returns:
        The file, `run.mp4` or `run.gif`.

    Raises:
        InputError: The system has no animation, or there are no frames at that rate.
    """
    if fps < 1 or frames < 1:
        raise InputError("", f"frames and fps must be positive, got {frames} frames at {fps} fps")
    system = load_system(data.attrs["system"])
    if system.animation is None:
        raise InputError(
            "", f"runs of {system.name} have no animation, only figures, which `sato plot` draws"
        )
    path = directory / ("run.mp4" if shutil.which("ffmpeg") else "run.gif")
    with matplotlib.rc_context(STYLE), replace_atomically(path) as file:
        animation = system.animation(data, mission)
        drawn = _draw_frames(animation, animation.frame_positions(frames), progress)
        (_write_mp4 if path.suffix == ".mp4" else _write_gif)(animation.canvas, drawn, file, fps)
    return path


def _draw_frames(
    animation: Animation, positions: Float[Array, " frames"], progress: ProgressCallback | None
) -> Iterator[None]:
    for i, position in enumerate(positions):
        animation.draw_frame(float(position))
        yield
        if progress is not None:
            progress(i + 1, len(positions))


def _write_mp4(canvas: FigureCanvasAgg, drawn: Iterator[None], path: Path, fps: int) -> None:
    # Browsers and slides play even sizes and yuv420p.
    even = "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white"
    writer = FFMpegWriter(fps=fps, extra_args=["-pix_fmt", "yuv420p", "-vf", even])
    with writer.saving(canvas.figure, str(path), dpi=canvas.figure.dpi):
        for _ in drawn:
            writer.grab_frame()


def _write_gif(canvas: Any, drawn: Iterator[None], path: Path, fps: int) -> None:
    def images() -> Iterator[Image.Image]:
        for _ in drawn:
            canvas.draw()
            image = Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")
            yield image.quantize(GIF_COLORS, dither=Image.Dither.NONE)

    film = images()
    first = next(film)
    first.save(path, save_all=True, append_images=film, duration=round(1000 / fps), loop=0)
