"""The figures of a run, in the manner of the paper's [Morgan2016, Figs. 2, 4, 5 and 6]."""

from collections.abc import Callable
from pathlib import Path

import matplotlib
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from sato.check import Evidence, rebuild
from sato.plots.half_space import half_space
from sato.plots.look import STYLE
from sato.plots.measures import delta_v, fuel, separation
from sato.plots.orbital import instants, space
from sato.plots.swarm import first_leg, stages, trajectories
from sato.plots.view import in_orbit
from sato.record import Run

__all__ = ["FIGURES", "IN_ORBIT", "plot"]

FIGURES: dict[str, Callable[[Evidence], Figure]] = {
    "stages": stages,
    "first-leg": first_leg,
    "trajectories": trajectories,
    "half-space": half_space,
    "separation": separation,
    "fuel": fuel,
}
IN_ORBIT: dict[str, Callable[[Evidence], Figure]] = {
    "instants": instants,
    "space": space,
    "delta-v": delta_v,
}


def plot(run: Run, directory: str | Path, pdf: bool = False) -> list[Path]:
    """Draw every figure of a run.

    Args:
        run: The run.
        directory: Where the files go; made if it is missing.
        pdf: PDF instead of PNG.

    Returns:
        The files, `stages` first; those of `IN_ORBIT` only of a run about a chief.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    evidence = Evidence.of(run.data, rebuild(run.data))
    figures = FIGURES | IN_ORBIT if in_orbit(evidence) else FIGURES
    paths = []
    for name, draw in figures.items():
        path = directory / f"{name}.{'pdf' if pdf else 'png'}"
        with matplotlib.rc_context(STYLE):
            figure = draw(evidence)
            FigureCanvasAgg(figure)
            figure.savefig(path)
        paths.append(path)
    return paths
