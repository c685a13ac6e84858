"""Winning bids known to an agent, and the merge of two agents' knowledge."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

NO_WINNER = -1  # winner of a target without a standing bid
ANONYMOUS = 0  # winner of every standing bid where bids carry no number


class OutOfTargets(RuntimeError):
    """Failure of an auction: all targets are taken, and an agent has none."""

    def __init__(self, agent: int, round: int, targets: int) -> None:
        """Keep the agent, the round in which it found out, and the number of targets."""
        super().__init__(
            f"agent {agent} found all {targets} targets taken in round {round}: its component "
            "has more agents than there are targets; define more targets"
        )
        self.agent, self.round, self.targets = agent, round, targets


class WinningBids(NamedTuple):
    """Price and winner of each target, as far as one agent knows.

    A positive price is a standing bid and has a winner. A negative one was a bid on a target
    that is for sale again: its magnitude still counts, and it has no winner. Zero: no bid yet.
    """

    price: Float[Array, " targets"]
    winner: Int[Array, " targets"]

    @classmethod
    def empty(cls, targets: int) -> "WinningBids":
        """Make a table without bids."""
        return cls(np.zeros(targets), np.full(targets, NO_WINNER))

    @property
    def winner_count(self) -> int:
        """Number of standing bids, which is the number of bidders heard of."""
        return int(np.count_nonzero(self.winner != NO_WINNER))


def find_newer_bids(own: WinningBids, received: WinningBids) -> Bool[Array, " targets"]:
    """Mark the targets of which `received` knows more.

    That is a larger |price|, or an equal one with a smaller winner. `NO_WINNER` is smaller than
    every agent, so of two equal magnitudes the negative price wins, and of two equal bids that
    of the smaller agent.
    """
    own_size, received_size = np.abs(own.price), np.abs(received.price)
    newer = received_size > own_size
    newer |= (received_size == own_size) & (received.winner < own.winner)
    return np.asarray(newer)


def merge_bids(own: WinningBids, received: WinningBids) -> WinningBids:
    """Keep the newer entry for each target.

    The larger of a total order, hence commutative, associative and idempotent: the order and
    the number of times in which messages arrive do not matter.
    """
    newer = find_newer_bids(own, received)
    return WinningBids(
        np.where(newer, received.price, own.price), np.where(newer, received.winner, own.winner)
    )
