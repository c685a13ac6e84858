"""Judges a run of this system: recomputes what it promises and what is said of it."""

from typing import TYPE_CHECKING

import numpy as np

from sato.check.report import Report
from sato.reconfiguration.check.chance import drawn
from sato.reconfiguration.check.evidence import Evidence, Stretch
from sato.reconfiguration.check.fuel import Bound, least
from sato.reconfiguration.check.promises import promises
from sato.reconfiguration.check.words import summarise
from sato.reconfiguration.mission import Reconfiguration

if TYPE_CHECKING:
    import xarray

__all__ = ["Bound", "Evidence", "Stretch", "examine"]


def examine(
    data: "xarray.Dataset", mission: Reconfiguration, rng: np.random.Generator | None = None
) -> Report:
    """Judge a run's data against a mission.

    Args:
        data: The run's.
        mission: What was to be flown.
        rng: As the drawing of the mission left it; without it, what was drawn in flight is
            judged by its size alone.
    """
    evidence = Evidence.of(data, mission)
    bounds = [least(evidence, s) for s in evidence.stretches]
    chance = None if rng is None else drawn(evidence, rng)
    return Report(promises(evidence, bounds, chance), summarise(evidence, bounds))
