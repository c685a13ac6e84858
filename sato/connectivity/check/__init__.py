"""Check of a connectivity run: promises, recomputed from its data, and its summary."""

from sato.connectivity.check.promises import check_run
from sato.connectivity.check.recorded import ConnectivityRecord

__all__ = ["ConnectivityRecord", "check_run"]
