"""Figures and animations of a run: PNG or PDF, and MP4, or GIF where ffmpeg is missing."""

import shutil
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from subprocess import CalledProcessError
from typing import Any

from matplotlib.animation import AbstractMovieWriter, FFMpegWriter, PillowWriter
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from dynamics.doors import checked
from sato.atomic import replace_atomically, replace_together
from sato.figures.axes import styled
from sato.film import SwarmFilm
from sato.record import MAX_FRAMES, drawn_mark, find_drawn
from sato.run_data import RunData
from sato.scenario.definition import Amount
from sato.scene import SwarmScene
from sato.systems import load_system

FIGURE_FORMATS = (".png", ".pdf")


@checked
def draw_figures(data: RunData, mission: Any) -> dict[str, Figure]:
    """Draw every figure of a run, by name, of the drawn mission that was flown."""
    with styled():
        figures = load_system(data.attrs["system"]).figures(data, mission)
        return {name: draw() for name, draw in figures.items()}


@checked
def write_figures(
    figures: Mapping[str, Figure], directory: Path, pdf: bool = False, digest: object = ""
) -> list[Path]:
    """Write figures by name into a directory, in place of all that were written before.

    The directory is made if it is missing. Where one cannot be written, all that were there are
    kept. The metadata of the files hold the digest of the data of their run.
    """
    old = [path for path in find_drawn(directory) if path.suffix in FIGURE_FORMATS]
    names = [f"{name}.{'pdf' if pdf else 'png'}" for name in figures]
    metadata = {"Creator" if pdf else "Software": drawn_mark(digest)}
    with replace_together(directory, old) as new, styled():
        for name, figure in zip(names, figures.values(), strict=True):
            FigureCanvasAgg(figure)
            figure.savefig(new / name, metadata=metadata)
    return [directory / name for name in names]


@checked
def animate(
    scene: SwarmScene,
    directory: Path,
    digest: object = "",
    fps: Amount = 20,
    frames: Amount = MAX_FRAMES,
    progress: Callable[[int, int], object] | None = None,
) -> Path:
    """Animate a run in `run.mp4` or `run.gif`; a file that was there is kept if that fails.

    The film has at most so many frames, evenly spaced in time, so many a second; its metadata hold
    the digest of the data of the run. Progress is called with the frames drawn so far and of all.
    """
    # Browsers and slides play even sizes and yuv420p.
    even = ["-pix_fmt", "yuv420p", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white"]
    mark = drawn_mark(digest)
    if shutil.which("ffmpeg") is not None:
        movie = FFMpegWriter(fps, extra_args=even, metadata={"comment": mark})
        try:
            with replace_atomically(directory / "run.mp4") as file:
                _write_film(movie, file, scene, frames, progress)
            return directory / "run.mp4"
        except (BrokenPipeError, CalledProcessError) as error:
            if isinstance(error.__context__, KeyboardInterrupt):  # ffmpeg got it too
                raise error.__context__ from None
            warnings.warn("ffmpeg could not write MP4, and GIF stands in", stacklevel=2)
    with replace_atomically(directory / "run.gif") as file:
        _write_film(PillowWriter(fps), file, scene, frames, progress)
        _add_comment(file, mark.encode())
    return directory / "run.gif"


def _write_film(
    writer: AbstractMovieWriter,
    file: Path,
    scene: SwarmScene,
    frames: int,
    progress: Callable[[int, int], object] | None,
) -> None:
    with styled():
        film = SwarmFilm(scene)
        figure, times = film.canvas.figure, film.frame_times(frames)
        with writer.saving(figure, str(file), dpi=figure.dpi):
            for i, time in enumerate(times, 1):
                film.draw_frame(float(time))
                writer.grab_frame()
                if progress is not None:
                    progress(i, len(times))


def _add_comment(gif: Path, text: bytes) -> None:
    """Add a comment of at most 255 bytes to a GIF, before its last byte, which ends it."""
    contents = gif.read_bytes()
    gif.write_bytes(contents[:-1] + b"\x21\xfe" + bytes([len(text)]) + text + b"\0" + contents[-1:])
