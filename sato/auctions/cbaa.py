"""What one agent does in a round of CBAA: a pure function of what it knows and hears."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.auctions.bids import WinningBids, find_newer_bids, merge_bids


class CbaaBidder(NamedTuple):
    """One agent in an auction: all that it knows."""

    agent_id: int
    score: Float[Array, " points"]  # what each point is worth to it; stays as it is
    agent_count: int  # how many agents take part
    bids: WinningBids  # what it told its neighbours last
    point: int = -1  # what it bid on last


def update_bidder(agent: CbaaBidder, inbox: list[WinningBids]) -> CbaaBidder:
    """One round of one agent: listen, bid if it holds nothing, tell [Lusk2020, sec. IV-B].

    It bids its own score on the point that is worth most to it among those where it beats
    the standing bid; of two equal scores the smaller agent number wins. There is always
    such a point: nobody holds two (see `knows`), so somebody who holds none sees one that
    is not sold. The printed loop listens at the end of a round, here it does so at the
    start of the next: the same sequence.
    """
    book = agent.bids
    for heard in inbox:
        book = merge_bids(book, heard)
    if agent.point >= 0 and book.winner[agent.point] == agent.agent_id:
        return agent._replace(bids=book)
    return _place_bid(agent, book)


def is_finished(agent: CbaaBidder) -> bool:
    """Whether an agent knows that the auction is over: everybody holds a point in its book.

    That alone is a proof. No quiet rounds are needed and no diameter, and it holds as well
    where messages are lost, late or out of order:

    1. Only c writes bids of c, and books travel whole. So a book with a bid of c contains,
       entry by entry, no less than the book of c right after that bid.
    2. No book has two points of one agent c. It bid on the second only when another's bid
       on the first was in its book, and by 1 that came along.
    3. Let B be a book in which everybody holds a point, and suppose that some agent bids
       after its bid in B. Let b be the first to do so, and j its point in B: it was outbid
       there by some c. That was not the bid of c in B, which is on another point. Nor a
       later one, for b is the first. Nor an earlier one: by 1, B would have it in place of
       b's. So nobody ever bids again, and by 1 all bids ever made are in B or outbid in it.

    Hence all such books are the same, and final. On a network of diameter D everybody has
    it in round n D + 1 at the latest, which listens n D times [Choi2009]: the largest score
    of all is bid at once and known to all D rounds later, then the largest of the rest.
    """
    return agent.bids.winner_count == agent.agent_count


def _place_bid(agent: CbaaBidder, heard: WinningBids) -> CbaaBidder:
    wins = find_newer_bids(
        heard, WinningBids(agent.score, np.full_like(heard.winner, agent.agent_id))
    )
    point = int(np.argmax(np.where(wins, agent.score, 0.0)))
    price, holder = heard.price.copy(), heard.winner.copy()
    price[point], holder[point] = agent.score[point], agent.agent_id
    return agent._replace(bids=WinningBids(price, holder), point=point)
