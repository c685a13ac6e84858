"""The variable-swarm, distributed auction algorithm [Morgan2016, Method 1].

`agent` is the definition: what one agent does in a round. `kernel` plays the rounds of
all agents at once, compiled; a test holds the two equal, round by round. `run` has what
one calls: `vsdaa`.
"""

from sato.vsdaa.agent import Bidder, OutOfTargets, stopped, take_part
from sato.vsdaa.run import Auction, by_messages, vsdaa

__all__ = ["Auction", "Bidder", "OutOfTargets", "by_messages", "stopped", "take_part", "vsdaa"]
