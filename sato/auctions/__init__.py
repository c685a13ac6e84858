"""Distributed auctions: each agent gets a target of its own from messages of its neighbors.

`bidder` defines what one agent does. `vsdaa` and `cbaa` compute the rounds of all agents at once;
`direct` assigns without an auction.
"""

from sato.auctions.cbaa import CbaaAuction, CbaaResult, run_cbaa
from sato.auctions.direct import assign_centrally, assign_given
from sato.auctions.vsdaa import OutOfTargets, VsdaaAuction, VsdaaResult, run_vsdaa

__all__ = [
    "CbaaAuction", "CbaaResult", "OutOfTargets", "VsdaaAuction", "VsdaaResult",
    "assign_centrally", "assign_given", "run_cbaa", "run_vsdaa",
]  # fmt: skip
