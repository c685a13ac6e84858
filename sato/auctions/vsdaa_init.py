"""The variable-swarm, distributed auction algorithm [Morgan2016, Method 1].

`agent` is the definition: what one agent does in a round. `kernel` plays the rounds of
all agents at once, compiled; a test holds the two equal, round by round. `run` has what
one calls: `vsdaa`.
"""

from sato.auctions.vsdaa import OutOfTargets, VsdaaBidder, is_finished, update_bidder
from sato.auctions.vsdaa_run import VsdaaResult, run_by_messages, run_vsdaa

__all__ = [
    "OutOfTargets",
    "VsdaaBidder",
    "VsdaaResult",
    "is_finished",
    "run_by_messages",
    "run_vsdaa",
    "update_bidder",
]
