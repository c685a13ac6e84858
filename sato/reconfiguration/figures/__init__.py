"""Figures of a reconfiguration, after those of the paper [Morgan2016, Figs. 2, 4, 5 and 6]."""

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
from sato.reconfiguration.figures.snapshots import (
    has_chief,
    plot_first_leg,
    plot_stages,
    plot_trajectories,
)
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
    """Prepare the figures of a run; those of `ORBIT_FIGURES` only where it has a chief."""
    record = ReconfigurationRecord.from_dataset(data, mission)
    drawn = FIGURES | ORBIT_FIGURES if has_chief(record) else FIGURES
    return {name: partial(draw, record) for name, draw in drawn.items()}


def make_animation(data: "xarray.Dataset", mission: Reconfiguration) -> Animation:
    """Prepare the animation of a run."""
    return SwarmAnimation(ReconfigurationRecord.from_dataset(data, mission))
