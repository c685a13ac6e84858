"""Figures of a reconfiguration, after those of the paper [Morgan2016, Figs. 2, 4, 5 and 6]."""

from functools import partial

from sato.interfaces import FigureFactories
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.figures import (
    drifts,
    half_space,
    measures,
    messages,
    snapshots,
    time_series,
)
from sato.reconfiguration.mission import Reconfiguration
from sato.run_data import RunData

FIGURES = {
    "stages": snapshots.plot_stages,
    "first-leg": snapshots.plot_first_leg,
    "trajectories": snapshots.plot_trajectories,
    "time-series": time_series.plot_time_series,
    "fuel": measures.plot_fuel,
}
PAIR_FIGURES = {"separation": measures.plot_separation, "half-space": half_space.plot_half_space}
ORBIT_FIGURES = {
    "instants": snapshots.plot_instants,
    "space": snapshots.plot_space,
    "delta-v": measures.plot_delta_v,
}


def make_figures(data: RunData, mission: Reconfiguration) -> FigureFactories:
    """Prepare the figures of a run.

    Those of `PAIR_FIGURES` are only where two vehicles flew at a time, those of `ORBIT_FIGURES`
    where there is a chief, and drifts where the mission asks for passive safety.
    """
    record = ReconfigurationRecord.from_data(data, mission)
    drawn = FIGURES | (PAIR_FIGURES if record.separations[0].minimum.piece >= 0 else {})
    if record.variables.chief is not None:
        drawn = drawn | ORBIT_FIGURES
    if record.variables.received_bytes is not None and record.frames.rounds is not None:
        drawn = drawn | {"messages": messages.plot_messages}
    if mission.is_passively_safe:
        drawn = drawn | {"drifts": drifts.plot_drifts}
    return {name: partial(draw, record) for name, draw in drawn.items()}
