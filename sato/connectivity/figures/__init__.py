"""Figures of a connectivity run, the first five after [Bernard2023, Fig. 4–7]."""

from functools import partial

from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.figures import laws, time_series, trajectories
from sato.connectivity.mission import Connectivity
from sato.interfaces import FigureFactories
from sato.run_data import RunData

FIGURES = {
    "paths": trajectories.plot_trajectories,
    "connectivity": time_series.plot_connectivity,
    "edges": time_series.plot_edges,
    "yaw": time_series.plot_yaw_error,
    "distances": time_series.plot_distances,
    "following": time_series.plot_following,
    "weights": laws.plot_weights,
    "potential": laws.plot_potential,
}


def make_figures(data: RunData, mission: Connectivity) -> FigureFactories:
    """Return functions that draw the figures of a run, by name."""
    record = ConnectivityRecord.from_data(data, mission)
    return {name: partial(draw, record) for name, draw in FIGURES.items()}
