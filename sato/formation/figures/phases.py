"""What the swarm is about in each part of a run, and how the figures name it."""

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
    Phase.CONVERGED: "settled",
    Phase.COMPLETED: "settled",
    Phase.ABORTED: "gridlock",
}


class PhaseSpan(NamedTuple):
    """What the swarm is about for a while."""

    label: str
    start: float  # [s]
    end: float  # [s]


def phase_spans(evidence: FormationRecord) -> list[PhaseSpan]:
    """What the swarm is about from the start to the end, without gaps."""
    words, time = [PHASE_LABELS[phase] for phase in evidence.replay.phase], evidence.time
    edges = [0, *(k for k in range(1, len(words)) if words[k] != words[k - 1]), len(words) - 1]
    return [
        PhaseSpan(words[a], float(time[a]), float(time[b])) for a, b in pairwise(edges) if b > a
    ]


def is_leg_active(evidence: FormationRecord) -> Bool[Array, " instants"]:
    """Whether a shape is flown to, or held."""
    there = [phase is not Phase.WAITING for phase in evidence.replay.phase]
    return np.pad(np.array(there), (0, len(evidence.time) - len(there)))


def formation_name(evidence: FormationRecord, leg: int) -> str:
    """The name of a leg's shape, without that of its group; it may have none."""
    return evidence.mission.gains[leg].formation.name.rpartition("/")[2]


def subsample(count: int, most: int) -> Int[Array, " kept"]:
    """So many of the first numbers at most, evenly spaced, first and last among them."""
    return np.unique(np.round(np.linspace(0, count - 1, min(count, most))).astype(int))
