"""Check of a connectivity run: promises, recomputed from its data, and its summary."""

from typing import TYPE_CHECKING

import numpy as np

from sato.check.report import Report
from sato.connectivity.check.promises import check_promises
from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.mission import Connectivity

if TYPE_CHECKING:
    import xarray

__all__ = ["ConnectivityRecord", "check_run"]


def check_run(
    data: "xarray.Dataset", mission: Connectivity, rng: np.random.Generator | None = None
) -> Report:
    """Check the data of a run against a drawn mission.

    Args:
        data: Data of the run.
        mission: Mission that was to be flown, drawn.
        rng: Not used: noise and losses are checked by their effects.
    """
    record = ConnectivityRecord.from_dataset(data, mission)
    return Report(check_promises(record), record.summarize())
