"""Judges a run of this system: recomputes what it promises and what is said of it."""

from typing import TYPE_CHECKING

import numpy as np

from sato.check.report import Report
from sato.formation.check.evidence import Evidence
from sato.formation.check.promises import promises
from sato.formation.check.words import summarise
from sato.formation.mission import FormationFlight

if TYPE_CHECKING:
    import xarray

__all__ = ["Evidence", "examine"]


def examine(
    data: "xarray.Dataset", mission: FormationFlight, rng: np.random.Generator | None = None
) -> Report:
    """Judge a run's data against a mission.

    Args:
        data: The run's.
        mission: What was to be flown.
        rng: Not asked: what was drawn in flight is judged by what it did.
    """
    evidence = Evidence.of(data, mission)
    return Report(promises(evidence), summarise(evidence))
