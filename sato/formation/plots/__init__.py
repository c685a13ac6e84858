"""The figures of this system; the first is in the manner of the paper's [Lusk2020, Fig. 5]."""

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from matplotlib.figure import Figure

from sato.formation.check import Evidence
from sato.formation.mission import FormationFlight
from sato.formation.plots.assignments import assignments
from sato.formation.plots.frames import frames
from sato.formation.plots.gains import gains
from sato.formation.plots.measures import convergence, separation, speeds
from sato.formation.plots.traces import traces
from sato.system import Figures

if TYPE_CHECKING:
    import xarray

__all__ = ["FIGURES", "WITH_AUCTIONS", "figures"]

FIGURES: dict[str, Callable[[Evidence], Figure]] = {
    "traces": traces,
    "gains": gains,
    "convergence": convergence,
    "speeds": speeds,
    "separation": separation,
    "frames": frames,
}
WITH_AUCTIONS: dict[str, Callable[[Evidence], Figure]] = {"assignments": assignments}


def figures(data: "xarray.Dataset", mission: FormationFlight) -> Figures:
    """The figures of a run; those of `WITH_AUCTIONS` only where vehicles hold auctions."""
    evidence = Evidence.of(data, mission)
    auctions = mission.assigning.kind in ("cbaa", "vsdaa")
    drawn = FIGURES | WITH_AUCTIONS if auctions else FIGURES
    return {name: partial(draw, evidence) for name, draw in drawn.items()}
