"""From where a run of this system is looked at."""

from sato.figures.axes import ORBITAL_PLANE, Projection
from sato.reconfiguration.check.recorded import ReconfigurationRecord


def has_chief(evidence: ReconfigurationRecord) -> bool:
    """Whether the swarm flies about a chief."""
    return evidence.mission.flown_plant.chief_elements(0.0) is not None


def select_view(evidence: ReconfigurationRecord) -> Projection:
    """How the swarm of a run is best looked at."""
    d = evidence.axes
    return (
        ORBITAL_PLANE if has_chief(evidence) else Projection(tuple(range(d)), ("x", "y", "z")[:d])
    )
