"""Figures of a reconfiguration, after those of the paper [Morgan2016, Figs. 2, 4, 5 and 6]."""

from functools import partial

from sato.interfaces import FigureFactories
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.figures import drifts, half_space, measures, snapshots
from sato.reconfiguration.figures.animation import SwarmAnimation
from sato.reconfiguration.mission import Reconfiguration
from sato.run_data import RunData

FIGURES = {
    "stages": snapshots.plot_stages,
    "first-leg": snapshots.plot_first_leg,
    "trajectories": snapshots.plot_trajectories,
    "half-space": half_space.plot_half_space,
    "separation": measures.plot_separation,
    "fuel": measures.plot_fuel,
}
ORBIT_FIGURES = {
    "instants": snapshots.plot_instants,
    "space": snapshots.plot_space,
    "delta-v": measures.plot_delta_v,
}


def make_figures(data: RunData, mission: Reconfiguration) -> FigureFactories:
    """Prepare the figures of a run; those of `ORBIT_FIGURES` only where it has a chief."""
    record = ReconfigurationRecord.from_data(data, mission)
    drawn = FIGURES if record.variables.chief is None else FIGURES | ORBIT_FIGURES
    if mission.is_passively_safe:
        drawn = drawn | {"drifts": drifts.plot_drifts}
    return {name: partial(draw, record) for name, draw in drawn.items()}


def make_animation(data: RunData, mission: Reconfiguration) -> SwarmAnimation:
    """Prepare the animation of a run."""
    return SwarmAnimation(ReconfigurationRecord.from_data(data, mission))
