"""Check of a reconfiguration: promises and summary, recomputed from the recorded data."""

from sato.reconfiguration.check.promises import check_run
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord

__all__ = ["LegRecord", "ReconfigurationRecord", "check_run"]
