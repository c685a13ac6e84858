"""Check of a formation flight: recompute what it promises and what its summary says."""

from sato.formation.check.promises import check_run
from sato.formation.check.recorded import FormationRecord

__all__ = ["FormationRecord", "check_run"]
