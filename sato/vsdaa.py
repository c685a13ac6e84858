"""The variable-swarm, distributed auction algorithm [Morgan2016, Method 1].

`take_part` is the definition: what one agent does in a round. `vsdaa` runs the same
for all agents at once, compiled; a test holds the two equal, round by round.
"""

from collections.abc import Iterator
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy import ndarray as Array

from sato.auction import NOBODY, Book, merge
from sato.network import Network, flood, learn_diameter, rounds


class Auction(NamedTuple):
    """How an auction ended."""

    target: Int[Array, " agents"]  # −1 for who is not alive
    believed: Int[Array, " agents"]  # m, the number of targets bid on
    bidders: Int[Array, " agents"]  # holders in the agent's own book: the bidders it heard of
    rounds: int  # until the last agent stopped, counted from the first bid
    preparation: int  # rounds before that: 3 D + 1 to learn D, D to agree on m
    bids: int
    last_bid_round: int
    price: Float[Array, "agents targets"]  # signed, as in the agents' books


class OutOfTargets(RuntimeError):
    """An agent found all targets taken and none left to add."""

    def __init__(self, agent: int, round: int, targets: int) -> None:
        """Keep who found out, when, and how many targets there are."""
        super().__init__(
            f"agent {agent} found all {targets} targets taken in round {round}: there are more "
            "agents in its component than targets; define more targets"
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
    book: Book  # what it has told its neighbours
    target: int = -1  # j, what it bid on last
    quiet: int = 0  # rounds without news
    round: int = 0
    bids: int = 0


def take_part(agent: Bidder, inbox: list[Book]) -> Bidder:
    """One round of one agent: listen (lines 27-29), bid if it holds nothing (8-25), tell (26).

    The printed loop listens at the end of a round, here it does so at the start of the
    next: the same sequence. Prices have the length M throughout, padded with zeros.

    With `ids` a bid is its bidder's as long as the holder in its book is itself. Without,
    an agent trusts the price alone (line 8), and two equal bids both believe they hold.
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
    would bid now, and the agent would hear that too.
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
    holder[j] = agent.number if agent.ids else 0
    return agent._replace(
        book=Book(price, holder), believed=m, target=j, quiet=0, bids=agent.bids + 1
    )


def by_messages(
    cost: Float[Array, "agents targets"],
    network: Network,
    believed: Int[Array, " agents"],
    epsilon: float,
    *,
    ids: bool = True,
) -> Iterator[list[Bidder]]:
    """Run the definition itself: every agent after every round. See `vsdaa`.

    Agents first learn the diameter of their component, then agree on the largest m, then bid.
    """
    _check(cost, network, believed, epsilon)
    diameter = learn_diameter(network)
    agreed = flood(network, believed.tolist(), max)
    empty = Book.empty(cost.shape[1])
    bidders = [
        Bidder(i, cost[i], epsilon, ids, 2 * int(diameter[i]), agreed[i], empty)
        for i in range(len(cost))
    ]
    return rounds(network, bidders, take_part, lambda agent: agent.book, stopped)


def vsdaa(
    cost: Float[Array, "agents targets"],
    network: Network,
    believed: Int[Array, " agents"],
    epsilon: float,
    *,
    ids: bool = True,
) -> Auction:
    """Give every agent its own target, by talking to neighbours only [Morgan2016, Method 1].

    In a component of N agents the total cost is within N ε of the optimum over the first
    max(N, m) targets, where m is the largest number that one of them believes in. Components
    know nothing of each other, so they may choose the same targets.

    Args:
        cost: What each target costs each agent; finite, also where it is out of reach.
        network: Who hears whom while the auction lasts.
        believed: m of each agent, the number of targets it would bid on.
        epsilon: Bid increment, on the scale of the cost.
        ids: Bids carry the bidder's number, which decides between equal bids. False runs
            the printed method, which may give one target to two agents.

    Raises:
        ValueError: The input is not of this kind.
        OutOfTargets: A component has more agents than there are targets.
    """
    _check(cost, network, believed, epsilon)
    swarm = _gather(cost, network, believed)
    agent, round = _run(epsilon, ids, network.alive, swarm)
    if agent >= 0:
        raise OutOfTargets(int(agent), int(round), cost.shape[1])
    ends = np.where(network.alive, swarm.last + swarm.patience, 0)
    return Auction(
        target=swarm.target,
        believed=swarm.believed,
        bidders=np.count_nonzero(swarm.holder != NOBODY, axis=1),
        rounds=int(ends.max(initial=0)),
        preparation=int(4 * network.diameter.max(initial=0) + 1),
        bids=int(swarm.bids.sum()),
        last_bid_round=int(swarm.last_bid.max(initial=0)),
        price=swarm.price,
    )


def _check(cost: Array, network: Network, believed: Array, epsilon: float) -> None:
    agents, targets = cost.shape
    alive = network.alive
    if agents != len(alive) or agents != len(believed):
        raise ValueError(
            f"costs for {agents} agents, a network of {len(alive)}, m of {len(believed)}: "
            "there must be a row and an m for every agent of the network"
        )
    if not np.all(np.isfinite(cost[alive])):
        i, j = next((i, j) for i, j in np.argwhere(~np.isfinite(cost)) if alive[i])
        raise ValueError(
            f"the cost of target {j} for agent {i} is {cost[i, j]}: "
            "give an unreachable target a large finite cost"
        )
    wrong = np.flatnonzero(alive & ((believed < 1) | (believed > targets)))
    if len(wrong):
        raise ValueError(
            f"agent {wrong[0]} believes in {believed[wrong[0]]} targets: "
            f"from 1 to the {targets} that are defined would do"
        )
    # Prices may climb to agents × the largest cost, and each bid must still be seen there.
    least = 4 * float(np.spacing(agents * np.abs(cost[alive]).max(initial=1e-300)))
    if not least < epsilon < np.inf:
        raise ValueError(
            f"the bid increment is {epsilon}: it must be finite and above {least:.1e}, "
            "below which prices of this size cannot show it"
        )


class _Swarm(NamedTuple):
    # All agents of an auction as arrays, which the compiled rounds change in place.
    cost: Array
    first: Array  # where the neighbours of each agent begin in `neighbour`
    neighbour: Array
    patience: Array
    price: Array
    holder: Array
    believed: Array
    target: Array
    told: Array  # price of the agent's target in the book that it told last
    last: Array  # round in which the agent last bid or heard news
    last_bid: Array
    bids: Array
    changed: Array  # round in which an entry of a book last changed
    news: Array  # number of entries told, for an even and an odd round
    news_target: Array
    news_price: Array
    news_holder: Array


def _gather(cost: Array, network: Network, believed: Array) -> _Swarm:
    agents, targets = cost.shape
    degree = np.count_nonzero(network.hears, axis=1)
    each, table, told = (agents,), (agents, targets), (2, agents, targets)
    return _Swarm(
        cost=np.ascontiguousarray(cost, dtype=np.float64),
        first=np.concatenate([[0], np.cumsum(degree)]),
        neighbour=np.nonzero(network.hears)[1],
        patience=2 * network.diameter,
        price=np.zeros(table),
        holder=np.full(table, NOBODY),
        believed=network.largest(np.asarray(believed, dtype=np.int64)),
        target=np.full(each, -1),
        told=np.zeros(each),
        last=np.zeros(each, dtype=np.int64),
        last_bid=np.zeros(each, dtype=np.int64),
        bids=np.zeros(each, dtype=np.int64),
        changed=np.zeros(table, dtype=np.int64),
        news=np.zeros((2, agents), dtype=np.int64),
        news_target=np.zeros(told, dtype=np.int64),
        news_price=np.zeros(told),
        news_holder=np.zeros(told, dtype=np.int64),
    )


# The compiled rounds. Merging keeps the larger entry of a total order, so an agent that has
# merged a neighbour's book needs only what changed in it since; most agents are quiet.


@njit(cache=True)
@no_type_check
def _enter(i, j, price, holder, round, s):
    # Write an entry and remember it once as news of this round.
    if s.changed[i, j] != round:
        s.changed[i, j] = round
        s.news_target[round % 2, i, s.news[round % 2, i]] = j
        s.news[round % 2, i] += 1
    s.price[i, j], s.holder[i, j] = price, holder


@njit(cache=True)
@no_type_check
def _listen(round, s):
    before = (round - 1) % 2
    for a in range(len(s.target)):
        for q in range(s.first[a], s.first[a + 1] if s.news[before, a] else s.first[a]):
            i = s.neighbour[q]
            if _is_stopped(i, round, s):
                continue
            for k in range(s.news[before, a]):
                j, p = s.news_target[before, a, k], s.news_price[before, a, k]
                size, mine = abs(p), abs(s.price[i, j])
                h = s.news_holder[before, a, k]
                if size > mine or (size == mine and h < s.holder[i, j]):
                    _enter(i, j, p, h, round, s)


@njit(cache=True)
@no_type_check
def _is_stopped(i, round, s):
    return s.target[i] >= 0 and round - 1 - s.last[i] >= s.patience[i]


@njit(cache=True)
@no_type_check
def _is_outbid(i, ids, s):
    j = s.target[i]
    if j < 0:
        return True
    return s.holder[i, j] != i if ids else abs(s.price[i, j]) > s.told[i]


@njit(cache=True)
@no_type_check
def _place(i, epsilon, ids, round, s):
    # The same as `_bid`; False if there are not enough targets.
    m = max(s.believed[i], np.count_nonzero(s.price[i]))
    standing = np.count_nonzero(s.holder[i] != NOBODY)
    if standing >= m:
        m = standing + 1
        if m > s.price.shape[1]:
            return False
        for j in range(m):
            _enter(i, j, -(abs(s.price[i, j]) + epsilon), NOBODY, round, s)
    best, v, w = 0, np.inf, np.inf
    for j in range(m):
        total = s.cost[i, j] + abs(s.price[i, j])
        if total < v:
            best, v, w = j, total, v
        elif total < w:
            w = total
    if m == 1:
        w = v
    price = abs(s.price[i, best]) + (w - v + epsilon)
    _enter(i, best, price, i if ids else 0, round, s)
    s.believed[i], s.target[i], s.last_bid[i] = m, best, round
    s.bids[i] += 1
    return True


@njit(cache=True)
@no_type_check
def _play(round, epsilon, ids, alive, s):
    # One round of all agents. The number of agents with something left to say or do, or
    # −1 − i if agent i found no target left.
    now, busy = round % 2, 0
    s.news[now] = 0
    _listen(round, s)
    for i in range(len(s.target)):
        if not alive[i] or _is_stopped(i, round, s):
            continue
        if _is_outbid(i, ids, s):
            if not _place(i, epsilon, ids, round, s):
                return -1 - i
            s.last[i] = round
        elif s.news[now, i]:
            s.believed[i] = max(s.believed[i], np.count_nonzero(s.price[i]))
            s.last[i] = round
        s.told[i] = s.price[i, s.target[i]]
        for k in range(s.news[now, i]):
            j = s.news_target[now, i, k]
            s.news_price[now, i, k], s.news_holder[now, i, k] = s.price[i, j], s.holder[i, j]
        if s.news[now, i] or s.told[i] < 0:
            busy += 1
    return busy


@njit(cache=True)
@no_type_check
def _run(epsilon, ids, alive, s):
    # Rounds in which nothing happens are not played: each agent stops `patience` rounds
    # after its last news. Answers with the agent that found no target left, or −1.
    round, busy = 0, 1
    while busy > 0:
        round += 1
        busy = _play(round, epsilon, ids, alive, s)
    return -1 - busy, round
