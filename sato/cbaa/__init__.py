"""The consensus-based auction algorithm: one point for every agent [Choi2009].

`agent` is the definition: what one agent does in a round, and how it knows that the
auction is over. `kernel` plays the rounds of all agents at once, compiled; a test holds
the two equal, round by round. `run` has what one calls: `assign`.
"""

from sato.cbaa.agent import Bidder, knows, take_part
from sato.cbaa.run import Assignment, assign, by_messages

__all__ = ["Assignment", "Bidder", "assign", "by_messages", "knows", "take_part"]
