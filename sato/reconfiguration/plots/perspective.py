"""From where a run of this system is looked at."""

from sato.plots.view import IN_ORBIT, View
from sato.reconfiguration.check.evidence import Evidence


def in_orbit(evidence: Evidence) -> bool:
    """Whether the swarm flies about a chief."""
    return evidence.mission.truth.chief(0.0) is not None


def view_of(evidence: Evidence) -> View:
    """How the swarm of a run is best looked at."""
    d = evidence.axes
    return IN_ORBIT if in_orbit(evidence) else View(tuple(range(d)), ("x", "y", "z")[:d])
