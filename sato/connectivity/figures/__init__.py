"""Figures of a connectivity run, the first five after [Bernard2023, Fig. 4–7]."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from sato.connectivity.check import ConnectivityRecord
from sato.connectivity.figures.potential import plot_potential
from sato.connectivity.figures.time_series import plot_connectivity, plot_distances, plot_edges
from sato.connectivity.figures.trajectories import plot_trajectories
from sato.connectivity.figures.weights import plot_weights
from sato.connectivity.figures.yaw_error import plot_yaw_error
from sato.connectivity.mission import Connectivity
from sato.interfaces import FigureFactories

if TYPE_CHECKING:
    import xarray

__all__ = ["FIGURES", "make_figures"]

FIGURES: dict[str, Callable[[ConnectivityRecord], Figure]] = {
    "paths": plot_trajectories,
    "connectivity": plot_connectivity,
    "edges": plot_edges,
    "yaw": plot_yaw_error,
    "distances": plot_distances,
    "weights": plot_weights,
    "potential": plot_potential,
}


def make_figures(data: "xarray.Dataset", mission: Connectivity) -> FigureFactories:
    """Return functions that draw the figures of a run, by name."""
    record = ConnectivityRecord.from_dataset(data, mission)
    return {name: partial(draw, record) for name, draw in FIGURES.items()}
