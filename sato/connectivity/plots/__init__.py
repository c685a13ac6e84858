"""The figures of this system, the first five in the manner of [Bernard2023, Fig. 4–7]."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from sato.connectivity.check import Evidence
from sato.connectivity.mission import ConnectivityFlight
from sato.connectivity.plots.measures import connectivity, distances, edges
from sato.connectivity.plots.paths import paths
from sato.connectivity.plots.potential import potential
from sato.connectivity.plots.weights import weights
from sato.connectivity.plots.yaw import yaw
from sato.system import Figures

if TYPE_CHECKING:
    import xarray

__all__ = ["FIGURES", "figures"]

FIGURES: dict[str, Callable[[Evidence], Figure]] = {
    "paths": paths,
    "connectivity": connectivity,
    "edges": edges,
    "yaw": yaw,
    "distances": distances,
    "weights": weights,
    "potential": potential,
}


def figures(data: "xarray.Dataset", mission: ConnectivityFlight) -> Figures:
    """The figures of a run."""
    evidence = Evidence.of(data, mission)
    return {name: partial(draw, evidence) for name, draw in FIGURES.items()}
