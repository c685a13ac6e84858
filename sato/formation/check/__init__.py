"""Check of a formation flight: recompute what it promises and what its summary says."""

from typing import TYPE_CHECKING

import numpy as np

from sato.check.report import Report
from sato.formation.check.promises import check_promises
from sato.formation.check.recorded import FormationRecord
from sato.formation.check.summary import summarize
from sato.formation.mission import Formation

if TYPE_CHECKING:
    import xarray

__all__ = ["FormationRecord", "check_run"]


def check_run(
    data: "xarray.Dataset", mission: Formation, rng: np.random.Generator | None = None
) -> Report:
    """Check the data of a run against a drawn mission.

    Args:
        data: Data of the run.
        mission: Mission that was to be flown, drawn.
        rng: Not used: noise and losses are checked by their effects.
    """
    record = FormationRecord.from_dataset(data, mission)
    return Report(check_promises(record), summarize(record))
