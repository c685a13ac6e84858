"""Phases of a flight, and their names in figures."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray as Array

from sato.formation.check import FormationRecord
from sato.formation.supervisor import Phase

PHASE_LABELS = {
    Phase.WAITING: "waiting",
    Phase.FLYING: "flying",
    Phase.GRIDLOCKED: "gridlock",
    Phase.CONVERGED: "converged",
    Phase.COMPLETED: "converged",
    Phase.ABORTED: "gridlock",
}


class PhaseSpan(NamedTuple):
    """Interval of one phase."""

    label: str
    start: float  # [s]
    end: float  # [s]


def phase_spans(record: FormationRecord) -> list[PhaseSpan]:
    """Divide a flight into phases, from start to end without gaps."""
    labels, time = [PHASE_LABELS[phase] for phase in record.replay.phase], record.time
    edges = [0, *(k for k in range(1, len(labels)) if labels[k] != labels[k - 1]), len(labels) - 1]
    return [
        PhaseSpan(labels[a], float(time[a]), float(time[b])) for a, b in pairwise(edges) if b > a
    ]


def is_leg_active(record: FormationRecord) -> Bool[Array, " instants"]:
    """Tell at which instants a formation is flown to, or held."""
    active = [phase is not Phase.WAITING for phase in record.replay.phase]
    return np.pad(np.array(active), (0, len(record.time) - len(active)))


def formation_name(record: FormationRecord, leg: int) -> str:
    """Return the name of a leg's formation without that of its group; it may be empty."""
    return record.mission.gains[leg].formation.name.rpartition("/")[2]


def subsample(count: int, most: int) -> Int[Array, " kept"]:
    """Return at most so many of the first numbers, evenly spaced, with first and last."""
    return np.unique(np.round(np.linspace(0, count - 1, min(count, most))).astype(int))
