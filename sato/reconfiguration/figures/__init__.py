"""The figures of this system, in the manner of the paper's [Morgan2016, Figs. 2, 4, 5 and 6]."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from sato.interfaces import Animation, FigureFactories
from sato.reconfiguration.check import ReconfigurationRecord
from sato.reconfiguration.figures.animation import SwarmAnimation
from sato.reconfiguration.figures.half_space import plot_half_space
from sato.reconfiguration.figures.measures import plot_delta_v, plot_fuel, plot_separation
from sato.reconfiguration.figures.orbital import plot_instants, plot_space
from sato.reconfiguration.figures.perspective import has_chief
from sato.reconfiguration.figures.snapshots import plot_first_leg, plot_stages, plot_trajectories
from sato.reconfiguration.mission import Reconfiguration

if TYPE_CHECKING:
    import xarray

__all__ = ["FIGURES", "ORBIT_FIGURES", "make_animation", "make_figures"]

FIGURES: dict[str, Callable[[ReconfigurationRecord], Figure]] = {
    "stages": plot_stages,
    "first-leg": plot_first_leg,
    "trajectories": plot_trajectories,
    "half-space": plot_half_space,
    "separation": plot_separation,
    "fuel": plot_fuel,
}
ORBIT_FIGURES: dict[str, Callable[[ReconfigurationRecord], Figure]] = {
    "instants": plot_instants,
    "space": plot_space,
    "delta-v": plot_delta_v,
}


def make_figures(data: "xarray.Dataset", mission: Reconfiguration) -> FigureFactories:
    """The figures of a run; those of `IN_ORBIT` only of a run about a chief."""
    evidence = ReconfigurationRecord.from_dataset(data, mission)
    drawn = FIGURES | ORBIT_FIGURES if has_chief(evidence) else FIGURES
    return {name: partial(draw, evidence) for name, draw in drawn.items()}


def make_animation(data: "xarray.Dataset", mission: Reconfiguration) -> Animation:
    """Prepare the animation of a run."""
    return SwarmAnimation(ReconfigurationRecord.from_dataset(data, mission))
