"""Figures of a formation flight; the first follows [Lusk2020, Fig. 5]."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from sato.formation.check import FormationRecord
from sato.formation.figures.coordinate_frames import plot_coordinate_frames
from sato.formation.figures.gains import plot_gains
from sato.formation.figures.time_series import (
    plot_assignments,
    plot_convergence,
    plot_separation,
    plot_speeds,
)
from sato.formation.figures.trajectories import plot_paths
from sato.formation.mission import Formation
from sato.interfaces import FigureFactories

if TYPE_CHECKING:
    import xarray

__all__ = ["AUCTION_FIGURES", "FIGURES", "make_figures"]

FIGURES: dict[str, Callable[[FormationRecord], Figure]] = {
    "traces": plot_paths,
    "gains": plot_gains,
    "convergence": plot_convergence,
    "speeds": plot_speeds,
    "separation": plot_separation,
    "frames": plot_coordinate_frames,
}
AUCTION_FIGURES: dict[str, Callable[[FormationRecord], Figure]] = {"assignments": plot_assignments}


def make_figures(data: "xarray.Dataset", mission: Formation) -> FigureFactories:
    """Return the figures of a run; those of auctions only where there are any."""
    record = FormationRecord.from_dataset(data, mission)
    auctions = mission.assignment.method in ("cbaa", "vsdaa")
    drawn = FIGURES | AUCTION_FIGURES if auctions else FIGURES
    return {name: partial(draw, record) for name, draw in drawn.items()}
