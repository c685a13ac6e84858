"""What every auction shares: an agent's book, and merging what it hears."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

NO_WINNER = -1  # holder of a target without a standing bid


class WinningBids(NamedTuple):
    """What one agent has heard of each target: the price, and whose bid it was.

    A positive price is a standing bid and has a holder. A negative one was a bid that has
    been put up for sale again: its magnitude still counts, nobody holds it. Zero: no bid yet.
    """

    price: Float[Array, " targets"]
    winner: Int[Array, " targets"]

    @classmethod
    def empty(cls, targets: int) -> "WinningBids":
        """A book without bids."""
        return cls(np.zeros(targets), np.full(targets, NO_WINNER))

    @property
    def winner_count(self) -> int:
        """Number of targets that somebody holds, which is the number of bidders heard."""
        return int(np.count_nonzero(self.winner != NO_WINNER))


def find_newer_bids(mine: WinningBids, heard: WinningBids) -> Bool[Array, " targets"]:
    """Where the other book knows more: a larger |price|, or the same with a smaller holder.

    "Nobody" is smaller than every agent, so of two equal magnitudes the negative one wins,
    and of two equal bids that of the smaller number.
    """
    mine_size, heard_size = np.abs(mine.price), np.abs(heard.price)
    more = heard_size > mine_size
    more |= (heard_size == mine_size) & (heard.winner < mine.winner)
    return np.asarray(more)


def merge_bids(mine: WinningBids, heard: WinningBids) -> WinningBids:
    """What is known from two books together.

    Keeps for each target the larger entry of a total order, hence commutative, associative
    and idempotent: the order and the number of times in which news arrives do not matter.
    """
    better = find_newer_bids(mine, heard)
    return WinningBids(
        np.where(better, heard.price, mine.price), np.where(better, heard.winner, mine.winner)
    )
