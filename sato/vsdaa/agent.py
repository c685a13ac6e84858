"""What one agent does in a round of VSDAA: a pure function of what it knows and hears."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.auction import NOBODY, Book, merge

ANYBODY = 0  # holder of every standing bid where bids carry no number


class OutOfTargets(RuntimeError):
    """An agent found all targets taken and none left to add."""

    def __init__(self, agent: int, round: int, targets: int) -> None:
        """Keep who found out, in which round, and how many targets there are."""
        super().__init__(
            f"agent {agent} found all {targets} targets taken in round {round}: its component "
            "has more agents than there are targets; define more targets"
        )
        self.agent, self.round, self.targets = agent, round, targets


class Bidder(NamedTuple):
    """One agent in an auction: all that it knows."""

    number: int
    cost: Float[Array, " targets"]
    epsilon: float
    ids: bool  # bids carry the bidder's number
    patience: int  # quiet rounds after which it stops: 2 D
    believed: int  # m
    book: Book  # what it told its neighbours last
    target: int = -1  # j, what it bid on last
    quiet: int = 0  # rounds without news: the printed count
    round: int = 0
    bids: int = 0


def take_part(agent: Bidder, inbox: list[Book]) -> Bidder:
    """One round of one agent: listen (lines 27-29), bid if it holds nothing (8-25), tell (26).

    The printed loop listens at the end of a round, here it does so at the start of the
    next: the same sequence. Prices have the length M throughout, padded with zeros.

    With `ids` a bid stands as long as the holder in the agent's book is the agent. Without,
    it trusts the price alone (line 8), and of two equal bids both bidders believe they hold.

    Raises:
        OutOfTargets: The agent would add a target (line 11), and all M are in use.
    """
    book = agent.book
    for heard in inbox:
        book = merge(book, heard)
    agent = agent._replace(round=agent.round + 1)
    if _outbid(agent, book):
        return _bid(agent, book)
    if np.array_equal(book.price, agent.book.price) and np.array_equal(
        book.holder, agent.book.holder
    ):
        return agent._replace(quiet=agent.quiet + 1)
    believed = max(agent.believed, int(np.count_nonzero(book.price)))
    return agent._replace(book=book, believed=believed, quiet=0)


def stopped(agent: Bidder) -> bool:
    """Whether an agent has bid and then heard nothing new for 2 D rounds (line 7).

    Why 2 D is enough, and nobody bids after: let the agent's book be B since round s. All
    books contain B from round s + D on. Every bid made before is in B, or the agent would
    have heard it by round s + 2 D. So at s + D all books are B. Whoever were outbid in B
    would bid in the next round, and the agent would hear that too, in time.
    """
    return agent.target >= 0 and agent.quiet >= agent.patience


def _outbid(agent: Bidder, book: Book) -> bool:
    if agent.target < 0:
        return True
    if agent.ids:
        return bool(book.holder[agent.target] != agent.number)
    # Signed on purpose: a price negated at equal magnitude makes it bid a round later.
    return bool(abs(book.price[agent.target]) > agent.book.price[agent.target])


def _bid(agent: Bidder, heard: Book) -> Bidder:
    price, holder, epsilon = heard.price.copy(), heard.holder.copy(), agent.epsilon
    m = max(agent.believed, int(np.count_nonzero(price)))
    if heard.bidders >= m:  # lines 10-12: one target more, and all are for sale again
        m = heard.bidders + 1
        if m > len(price):
            raise OutOfTargets(agent.number, agent.round, len(price))
        price[:m] = -(np.abs(price[:m]) + epsilon)
        holder[:m] = NOBODY
    total = agent.cost[:m] + np.abs(price[:m])
    j = int(np.argmin(total))
    v = total[j]
    w = np.min(np.delete(total, j)) if m > 1 else v  # line 16 has no minimum for m = 1
    price[j] = abs(price[j]) + (w - v + epsilon)
    holder[j] = agent.number if agent.ids else ANYBODY
    return agent._replace(
        book=Book(price, holder), believed=m, target=j, quiet=0, bids=agent.bids + 1
    )
