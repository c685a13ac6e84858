"""The consensus-based auction algorithm: one point for every agent [Choi2009].

`agent` is the definition: what one agent does in a round, and how it knows that the
auction is over. `kernel` plays the rounds of all agents at once, compiled; a test holds
the two equal, round by round. `run` has what one calls: `assign`.
"""

from sato.auctions.cbaa import CbaaBidder, is_finished, update_bidder
from sato.auctions.cbaa_run import CbaaResult, run_by_messages, run_cbaa

__all__ = [
    "CbaaBidder",
    "CbaaResult",
    "is_finished",
    "run_by_messages",
    "run_cbaa",
    "update_bidder",
]
