"""Figures of a formation flight; the first follows [Lusk2020, Fig. 5]."""

from functools import partial

from sato.formation.check.recorded import FormationRecord
from sato.formation.figures import gains, time_series, trajectories
from sato.formation.mission import Formation
from sato.interfaces import FigureFactories
from sato.run_data import RunData

FIGURES = {
    "traces": trajectories.plot_paths,
    "gains": gains.plot_gains,
    "convergence": time_series.plot_convergence,
    "speeds": time_series.plot_speeds,
    "separation": time_series.plot_separation,
    "frames": trajectories.plot_coordinate_frames,
}
AUCTION_FIGURES = {"assignments": time_series.plot_assignments}


def make_figures(data: RunData, mission: Formation) -> FigureFactories:
    """Return the figures of a run; those of auctions only where there are any."""
    record = FormationRecord.from_data(data, mission)
    auctions = mission.assignment.method in ("cbaa", "vsdaa")
    drawn = FIGURES | AUCTION_FIGURES if auctions else FIGURES
    return {name: partial(draw, record) for name, draw in drawn.items()}
