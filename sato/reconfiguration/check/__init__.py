"""Judges a run of this system: recomputes what it promises and what is said of it."""

from typing import TYPE_CHECKING

import numpy as np

from sato.check.report import Report
from sato.reconfiguration.check.fuel import FuelBound, compute_fuel_bound
from sato.reconfiguration.check.promises import verify
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.check.redraw import redraw_disturbances
from sato.reconfiguration.check.summary import summarize
from sato.reconfiguration.mission import Reconfiguration

if TYPE_CHECKING:
    import xarray

__all__ = ["FuelBound", "LegRecord", "ReconfigurationRecord", "check_run"]


def check_run(
    data: "xarray.Dataset", mission: Reconfiguration, rng: np.random.Generator | None = None
) -> Report:
    """Judge a run's data against a mission.

    Args:
        data: The run's.
        mission: What was to be flown.
        rng: As the drawing of the mission left it; without it, what was drawn in flight is
            judged by its size alone.
    """
    evidence = ReconfigurationRecord.from_dataset(data, mission)
    bounds = [compute_fuel_bound(evidence, s) for s in evidence.leg_records]
    chance = None if rng is None else redraw_disturbances(evidence, rng)
    return Report(verify(evidence, bounds, chance), summarize(evidence, bounds))
