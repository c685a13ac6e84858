"""Distributed auctions: each agent gets a target of its own from messages of its neighbors.

`vsdaa` defines what one agent does in a round, and runs all agents by messages; `vsdaa_kernel` and
`cbaa` compute the rounds of all agents at once, compiled.
"""

from sato.auctions.bids import OutOfTargets
from sato.auctions.cbaa import CbaaAuction, CbaaResult, run_cbaa
from sato.auctions.vsdaa import VsdaaAuction, VsdaaResult, run_vsdaa

__all__ = [
    "CbaaAuction", "CbaaResult", "OutOfTargets", "VsdaaAuction", "VsdaaResult", "run_cbaa",
    "run_vsdaa",
]  # fmt: skip
