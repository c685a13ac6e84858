"""One agent in an auction: a pure function of its memory and its inbox.

The definitions of both auctions, as a vehicle runs them. `vsdaa` and `cbaa` compute the same rounds
for all agents of a simulation at once, which tests compare round by round.
"""

from collections.abc import Sequence
from typing import Annotated, NamedTuple

import numpy as np
from annotated_types import Ge, Gt
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.doors import checked
from dynamics.inputs import InputError
from sato.auctions.vsdaa import ANONYMOUS, FIRST_SLACK, NO_WINNER, OutOfTargets


@checked
class WinningBids(NamedTuple):
    """Price and winner of each target as far as one agent knows: its message to its neighbors.

    A positive price is a standing bid and has a winner. A negative one was a bid on a target
    that is for sale again: its magnitude still counts, and it has no winner. Zero: no bid yet.
    """

    price: Float[Array, " targets"]
    winner: Int[Array, " targets"]

    @property
    def array_sizes(self) -> dict[str, int]:
        """Sizes of the axes of arrays, by name."""
        return {"targets": len(self.price)}

    @classmethod
    def empty(cls, targets: Annotated[int, Gt(0)]) -> "WinningBids":
        """Make a table without bids."""
        return cls(np.zeros(targets), np.full(targets, NO_WINNER))

    @property
    def winner_count(self) -> int:
        """Number of standing bids, which is the number of bidders heard of."""
        return int(np.count_nonzero(self.winner != NO_WINNER))


@checked
def find_newer_bids(own: WinningBids, received: WinningBids) -> Bool[Array, " targets"]:
    """Mark the targets of which `received` knows more.

    That is a larger |price|, or an equal one with a smaller winner. `NO_WINNER` is smaller than
    every agent, so of two equal magnitudes the negative price wins, and of two equal bids that
    of the smaller agent.
    """
    own_size, received_size = np.abs(own.price), np.abs(received.price)
    is_tie = (received_size == own_size) & (received.winner < own.winner)
    return np.asarray((received_size > own_size) | is_tie)


@checked
def merge_bids(own: WinningBids, *received: WinningBids) -> WinningBids:
    """Keep the newest entry for each target.

    The largest of a total order, hence commutative, associative and idempotent: the order and
    the number of times in which messages arrive do not matter.
    """
    for bids in received:
        newer = find_newer_bids(own, bids)
        own = WinningBids(*(np.where(newer, *pair) for pair in zip(bids, own, strict=True)))
    return own


@checked
class VsdaaBidder(NamedTuple):
    """Memory of one agent in VSDAA [Morgan2016, Method 1]."""

    agent_id: Annotated[int, Ge(0)]
    cost: Float[Array, " targets"]
    epsilon: Annotated[float, Gt(0)]
    bidder_ids: bool  # True where bids carry the bidder's number
    patience: Annotated[int, Ge(0)]  # rounds without news after which it stops: 2 D
    target_count: Annotated[int, Gt(0)]  # m
    bids: WinningBids  # its last message
    target_index: Annotated[int, Ge(-1)] = -1  # j, the target of its last bid
    quiet_rounds: Annotated[int, Ge(0)] = 0  # rounds without news
    round: Annotated[int, Ge(0)] = 0
    bid_count: Annotated[int, Ge(0)] = 0
    first_target: Annotated[int, Ge(-1)] = -1  # of the opening; −1 none

    @property
    def array_sizes(self) -> dict[str, int]:
        """Sizes of the axes of arrays, by name."""
        return {"targets": len(self.cost)}

    @property
    def is_finished(self) -> bool:
        """True once it has bid and then heard nothing new for long enough."""
        return self.target_index >= 0 and self.quiet_rounds >= self.patience

    def update(self, inbox: Sequence[WinningBids]) -> "VsdaaBidder":
        """Merge the messages (lines 27-29) and bid where the agent holds no target (8-25).

        The printed loop listens at the end of a round, here the agent does so at the start of
        the next: the same sequence. Prices have the length M throughout, padded with zeros.

        With `bidder_ids` a bid stands as long as the agent knows itself as the winner. Without,
        it trusts the price alone (line 8), and of two equal bids both bidders believe to hold
        the target.

        Raises:
            OutOfTargets: All targets are taken.
        """
        limits = {"target_index": self.target_index, "first_target": self.first_target}
        _check_below(len(self.cost), **limits, target_count=self.target_count - 1)
        bids, j = merge_bids(self.bids, *inbox), self.target_index
        agent = self._replace(round=self.round + 1)
        if self.bidder_ids:
            is_outbid = bids.winner[j] != self.agent_id
        else:  # signed on purpose: a price negated at equal magnitude makes it bid a round later
            is_outbid = abs(bids.price[j]) > self.bids.price[j]
        if j < 0 or is_outbid:
            return agent._bid(bids)
        if all(map(np.array_equal, bids, self.bids)):
            return agent._replace(quiet_rounds=self.quiet_rounds + 1)
        m = max(self.target_count, int(np.count_nonzero(bids.price)))
        return agent._replace(bids=bids, target_count=m, quiet_rounds=0)

    def _bid(self, known: WinningBids) -> "VsdaaBidder":
        price, winner = known.price.copy(), known.winner.copy()
        m = max(self.target_count, int(np.count_nonzero(price)))
        if known.winner_count >= m:  # lines 10-12: one target more, and all are for sale again
            m = known.winner_count + 1
            if m > len(price):
                raise OutOfTargets(self.agent_id, self.round, len(price))
            price[:m] = -(np.abs(price[:m]) + self.epsilon)
            winner[:m] = NO_WINNER
        total = self.cost[:m] + np.abs(price[:m])
        j = int(np.argmin(total))
        if self.target_index < 0 <= self.first_target:
            is_near = total[self.first_target] <= total[j] + FIRST_SLACK * self.epsilon
            j = self.first_target if is_near else j
        v = total[j]
        w = np.min(np.delete(total, j)) if m > 1 else v  # line 16 has no minimum for m = 1
        price[j] = abs(price[j]) + (w - v + self.epsilon)
        winner[j] = self.agent_id if self.bidder_ids else ANONYMOUS
        return self._replace(
            bids=WinningBids(price, winner),
            target_count=m,
            target_index=j,
            quiet_rounds=0,
            bid_count=self.bid_count + 1,
        )


@checked
class CbaaBidder(NamedTuple):
    """Memory of one agent in CBAA [Lusk2020, sec. IV-B]."""

    agent_id: Annotated[int, Ge(0)]
    score: Float[Array, " targets"]  # of each point
    agent_count: Annotated[int, Gt(0)]
    bids: WinningBids  # its last message
    point: Annotated[int, Ge(-1)] = -1  # of its last bid

    @property
    def array_sizes(self) -> dict[str, int]:
        """Sizes of the axes of arrays, by name."""
        return {"targets": len(self.score)}

    @property
    def is_finished(self) -> bool:
        """True once every agent has a point."""
        return self.bids.winner_count == self.agent_count

    def update(self, inbox: Sequence[WinningBids]) -> "CbaaBidder":
        """Merge the messages, and bid where the agent holds no point."""
        _check_below(len(self.score), point=self.point, agent_count=self.agent_count - 1)
        bids, point = merge_bids(self.bids, *inbox), self.point
        if point < 0 or bids.winner[point] != self.agent_id:
            own = WinningBids(self.score, np.full_like(bids.winner, self.agent_id))
            point = int(np.argmax(np.where(find_newer_bids(bids, own), self.score, 0.0)))
            price, winner = bids.price.copy(), bids.winner.copy()
            price[point], winner[point] = self.score[point], self.agent_id
            bids = WinningBids(price, winner)
        return self._replace(bids=bids, point=point)


def _check_below(count: int, **limited: int) -> None:
    for name, index in limited.items():
        if index >= count:
            raise InputError(name, f"is beyond the {count} targets")
