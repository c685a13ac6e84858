"""Distributed auctions: each agent gets a target of its own from messages of its neighbors.

`vsdaa` and `cbaa` define what one agent does in a round, and run all agents by messages.
`vsdaa_kernel` and `cbaa_kernel` compute the same rounds for all agents at once, compiled.
"""

from sato.auctions.bids import OutOfTargets
from sato.auctions.cbaa import CbaaAuction, CbaaResult, run_cbaa
from sato.auctions.vsdaa import VsdaaAuction, VsdaaResult, run_vsdaa

__all__ = [
    "CbaaAuction", "CbaaResult", "OutOfTargets", "VsdaaAuction", "VsdaaResult", "run_cbaa",
    "run_vsdaa",
]  # fmt: skip
