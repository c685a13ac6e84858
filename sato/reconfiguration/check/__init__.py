"""Check of a reconfiguration: promises and summary, recomputed from the recorded data."""

from typing import TYPE_CHECKING

import numpy as np

from sato.check.report import Report
from sato.reconfiguration.check.prediction import redraw_disturbances
from sato.reconfiguration.check.promises import check_promises
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.check.summary import summarize
from sato.reconfiguration.mission import Reconfiguration

if TYPE_CHECKING:
    import xarray

__all__ = ["LegRecord", "ReconfigurationRecord", "check_run"]


def check_run(data: "xarray.Dataset", mission: Reconfiguration, rng: np.random.Generator) -> Report:
    """Check a run's data against its drawn mission.

    Args:
        data: Data of the run.
        mission: Drawn mission.
        rng: Generator as the drawing of the mission left it.
    """
    record = ReconfigurationRecord.from_dataset(data, mission)
    promises = check_promises(record, redraw_disturbances(record, rng))
    return Report(promises, summarize(record))
