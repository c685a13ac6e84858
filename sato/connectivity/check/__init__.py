"""Judges a run of this system: recomputes what it promises and what is said of it."""

from typing import TYPE_CHECKING

import numpy as np

from sato.check.report import Report
from sato.connectivity.check.evidence import ConnectivityRecord
from sato.connectivity.check.promises import check_promises
from sato.connectivity.check.summary import summarize
from sato.connectivity.mission import Connectivity

if TYPE_CHECKING:
    import xarray

__all__ = ["ConnectivityRecord", "check_run"]


def check_run(
    data: "xarray.Dataset", mission: Connectivity, rng: np.random.Generator | None = None
) -> Report:
    """Judge a run's data against a mission.

    Args:
        data: The run's.
        mission: What was to be flown.
        rng: Not asked: what was drawn in flight is judged by what it did.
    """
    evidence = ConnectivityRecord.from_dataset(data, mission)
    return Report(check_promises(evidence), summarize(evidence))
