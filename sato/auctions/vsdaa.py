"""What one agent does in a round of VSDAA: a pure function of what it knows and hears."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.auctions.bids import NO_WINNER, WinningBids, merge_bids

ANONYMOUS = 0  # holder of every standing bid where bids carry no number


class OutOfTargets(RuntimeError):
    """An agent found all targets taken and none left to add."""

    def __init__(self, agent: int, round: int, targets: int) -> None:
        """Keep who found out, in which round, and how many targets there are."""
        super().__init__(
            f"agent {agent} found all {targets} targets taken in round {round}: its component "
            "has more agents than there are targets; define more targets"
        )
        self.agent, self.round, self.targets = agent, round, targets


class VsdaaBidder(NamedTuple):
    """One agent in an auction: all that it knows."""

    agent_id: int
    cost: Float[Array, " targets"]
    epsilon: float
    bidder_ids: bool  # bids carry the bidder's number
    patience: int  # quiet rounds after which it stops: 2 D
    target_count: int  # m
    bids: WinningBids  # what it told its neighbours last
    target_index: int = -1  # j, what it bid on last
    quiet_rounds: int = 0  # rounds without news: the printed count
    round: int = 0
    bid_count: int = 0


def update_bidder(agent: VsdaaBidder, inbox: list[WinningBids]) -> VsdaaBidder:
    """One round of one agent: listen (lines 27-29), bid if it holds nothing (8-25), tell (26).

    The printed loop listens at the end of a round, here it does so at the start of the
    next: the same sequence. Prices have the length M throughout, padded with zeros.

    With `ids` a bid stands as long as the holder in the agent's book is the agent. Without,
    it trusts the price alone (line 8), and of two equal bids both bidders believe they hold.

    Raises:
        OutOfTargets: The agent would add a target (line 11), and all M are in use.
    """
    book = agent.bids
    for heard in inbox:
        book = merge_bids(book, heard)
    agent = agent._replace(round=agent.round + 1)
    if _is_outbid(agent, book):
        return _place_bid(agent, book)
    if np.array_equal(book.price, agent.bids.price) and np.array_equal(
        book.winner, agent.bids.winner
    ):
        return agent._replace(quiet_rounds=agent.quiet_rounds + 1)
    believed = max(agent.target_count, int(np.count_nonzero(book.price)))
    return agent._replace(bids=book, target_count=believed, quiet_rounds=0)


def is_finished(agent: VsdaaBidder) -> bool:
    """Whether an agent has bid and then heard nothing new for 2 D rounds (line 7).

    Why 2 D is enough, and nobody bids after: let the agent's book be B since round s. All
    books contain B from round s + D on. Every bid made before is in B, or the agent would
    have heard it by round s + 2 D. So at s + D all books are B. Whoever were outbid in B
    would bid in the next round, and the agent would hear that too, in time.
    """
    return agent.target_index >= 0 and agent.quiet_rounds >= agent.patience


def _is_outbid(agent: VsdaaBidder, book: WinningBids) -> bool:
    if agent.target_index < 0:
        return True
    if agent.bidder_ids:
        return bool(book.winner[agent.target_index] != agent.agent_id)
    # Signed on purpose: a price negated at equal magnitude makes it bid a round later.
    return bool(abs(book.price[agent.target_index]) > agent.bids.price[agent.target_index])


def _place_bid(agent: VsdaaBidder, heard: WinningBids) -> VsdaaBidder:
    price, holder, epsilon = heard.price.copy(), heard.winner.copy(), agent.epsilon
    m = max(agent.target_count, int(np.count_nonzero(price)))
    if heard.winner_count >= m:  # lines 10-12: one target more, and all are for sale again
        m = heard.winner_count + 1
        if m > len(price):
            raise OutOfTargets(agent.agent_id, agent.round, len(price))
        price[:m] = -(np.abs(price[:m]) + epsilon)
        holder[:m] = NO_WINNER
    total = agent.cost[:m] + np.abs(price[:m])
    j = int(np.argmin(total))
    v = total[j]
    w = np.min(np.delete(total, j)) if m > 1 else v  # line 16 has no minimum for m = 1
    price[j] = abs(price[j]) + (w - v + epsilon)
    holder[j] = agent.agent_id if agent.bidder_ids else ANONYMOUS
    return agent._replace(
        bids=WinningBids(price, holder),
        target_count=m,
        target_index=j,
        quiet_rounds=0,
        bid_count=agent.bid_count + 1,
    )
