"""The figures of a run. What they show is the system's; how they are drawn is the same for all."""

from pathlib import Path

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg

from sato.figures.style import STYLE
from sato.record import Run
from sato.systems import load_system
from sato.verify import rebuild_mission

__all__ = ["plot"]


def plot(run: Run, directory: str | Path, pdf: bool = False) -> list[Path]:
    """Draw every figure of a run.

    Args:
        run: The run.
        directory: Where the files go; made if it is missing.
        pdf: PDF instead of PNG.

    Returns:
        The files, in the order of the system's figures.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    figures = load_system(str(run.data.attrs["system"])).figures(
        run.data, rebuild_mission(run.data)
    )
    paths = []
    for name, draw in figures.items():
        path = directory / f"{name}.{'pdf' if pdf else 'png'}"
        with matplotlib.rc_context(STYLE):
            figure = draw()
            FigureCanvasAgg(figure)
            figure.savefig(path)
        paths.append(path)
    return paths
