"""Distributed auctions: each agent gets a target of its own from messages of its neighbors.

`vsdaa` and `cbaa` define what one agent does in a round, and run all agents by messages.
`vsdaa_kernel` and `cbaa_kernel` compute the same rounds for all agents at once, compiled.
"""

from sato.auctions.bids import OutOfTargets
from sato.auctions.cbaa import CbaaResult, run_cbaa
from sato.auctions.vsdaa import VsdaaResult, run_vsdaa

__all__ = ["CbaaResult", "OutOfTargets", "VsdaaResult", "run_cbaa", "run_vsdaa"]
