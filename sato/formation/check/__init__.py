"""Judges a run of this system: recomputes what it promises and what is said of it."""

from typing import TYPE_CHECKING

import numpy as np

from sato.check.report import Report
from sato.formation.check.evidence import FormationRecord
from sato.formation.check.promises import check_promises
from sato.formation.check.summary import summarize
from sato.formation.mission import Formation

if TYPE_CHECKING:
    import xarray

__all__ = ["FormationRecord", "check_run"]


def check_run(
    data: "xarray.Dataset", mission: Formation, rng: np.random.Generator | None = None
) -> Report:
    """Judge a run's data against a mission.

    Args:
        data: The run's.
        mission: What was to be flown.
        rng: Not asked: what was drawn in flight is judged by what it did.
    """
    evidence = FormationRecord.from_dataset(data, mission)
    return Report(check_promises(evidence), summarize(evidence))
