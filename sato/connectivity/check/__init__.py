"""Judges a run of this system: recomputes what it promises and what is said of it."""

from typing import TYPE_CHECKING

import numpy as np

from sato.check.report import Report
from sato.connectivity.check.evidence import Evidence
from sato.connectivity.check.promises import promises
from sato.connectivity.check.words import summarise
from sato.connectivity.mission import ConnectivityFlight

if TYPE_CHECKING:
    import xarray

__all__ = ["Evidence", "examine"]


def examine(
    data: "xarray.Dataset", mission: ConnectivityFlight, rng: np.random.Generator | None = None
) -> Report:
    """Judge a run's data against a mission.

    Args:
        data: The run's.
        mission: What was to be flown.
        rng: Not asked: what was drawn in flight is judged by what it did.
    """
    evidence = Evidence.of(data, mission)
    return Report(promises(evidence), summarise(evidence))
