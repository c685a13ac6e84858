"""The rounds of `agent`, for all agents at once and compiled.

Books only grow, in the order that `merge` keeps the larger of, and news travels one hop
a round. So the book of agent i after round r is the merge of all entries that an agent
a wrote in a round t with t + hops(a, i) ≤ r. That saves passing books around: an entry is
delivered to each agent once, in the round in which it arrives there.

All compiled functions stand in this one file: numba's cache does not see a change in another.
"""

from collections.abc import Iterator
from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy import ndarray as Array

from sato.auctions.bids import NO_WINNER
from sato.auctions.vsdaa import ANONYMOUS, OutOfTargets
from sato.network.graph import CommunicationGraph

DONE, RUNNING, LOG_FULL = 0, 1, 2  # how `_advance` ends; −1 − i: agent i found no target left


class VsdaaState(NamedTuple):
    """All agents of an auction, changed in place from round to round."""

    cost: Float[Array, "agents targets"]
    alive: Array
    by_hops: Int[Array, "agents agents"]  # the others by their hops from each agent
    hop_start: Int[Array, "agents reach"]  # where those d hops away begin in `order`
    patience: Int[Array, " agents"]
    price: Float[Array, "agents targets"]
    winner: Int[Array, "agents targets"]
    price_count: Int[Array, " agents"]  # nonzero prices in each book
    winner_count: Int[Array, " agents"]  # standing bids in each book
    target_count: Int[Array, " agents"]
    target_index: Int[Array, " agents"]
    sent_price: Float[Array, " agents"]  # price of the agent's target in the book it told last
    last_news_round: Int[Array, " agents"]  # round in which the agent last bid or heard news
    last_bid_round: Int[Array, " agents"]
    bid_count: Int[Array, " agents"]
    round: Int[Array, " 1"]


class BidLog(NamedTuple):
    """What was written in which round by whom, while it is still under way."""

    agent: Int[Array, " events"]
    round: Int[Array, " events"]
    start: Int[Array, " events"]  # first entry of the event; it ends where the next begins
    target: Int[Array, " entries"]
    price: Float[Array, " entries"]
    winner: Int[Array, " entries"]
    size: Int[Array, " 2"]  # first event under way, number of events

    @classmethod
    def empty(cls, events: int, entries: int) -> "BidLog":
        """Room for so much."""
        ints = [np.zeros(size, dtype=np.int64) for size in (events, events, events + 1)]
        target, holder = np.zeros(entries, dtype=np.int64), np.zeros(entries, dtype=np.int64)
        size = np.zeros(2, dtype=np.int64)
        return cls(ints[0], ints[1], ints[2], target, np.zeros(entries), holder, size)


def init_state(cost: Array, network: CommunicationGraph, believed: Array) -> VsdaaState:
    """All agents before the first round, with the largest m of their component."""
    agents, targets = cost.shape
    ints = [np.zeros(agents, dtype=np.int64) for _ in range(5)]
    # shell[a, d] counts the agents nearer than d; those in other components come last.
    reach = np.arange(int(network.diameter.max(initial=0)) + 2)
    hops = network.hops
    shell = np.stack([np.count_nonzero(hops < d, axis=1) for d in reach], axis=1)
    return VsdaaState(
        cost=np.ascontiguousarray(cost, dtype=np.float64),
        alive=network.alive,
        by_hops=np.argsort(hops, axis=1, kind="stable"),
        hop_start=np.ascontiguousarray(shell),
        patience=2 * network.diameter,
        price=np.zeros((agents, targets)),
        winner=np.full((agents, targets), NO_WINNER),
        price_count=ints[0],
        winner_count=ints[1],
        target_count=network.component_max(np.asarray(believed, dtype=np.int64)),
        target_index=np.full(agents, -1),
        sent_price=np.zeros(agents),
        last_news_round=ints[2],
        last_bid_round=ints[3],
        bid_count=ints[4],
        round=np.zeros(1, dtype=np.int64),
    )


def run_kernel(swarm: VsdaaState, epsilon: float, ids: bool, stride: int = 2**62) -> Iterator[None]:
    """Play all rounds in which something happens, pausing after every `stride` of them.

    Raises:
        OutOfTargets: An agent found all targets taken.
    """
    agents, targets = swarm.cost.shape
    most = agents * (targets + 1)  # entries in a round: everybody adds a target
    log = BidLog.empty(2 * agents, 2 * most)
    while True:
        before = int(swarm.round[0])
        outcome = _advance(stride, float(epsilon), ids, swarm, log)
        if outcome < 0:
            raise OutOfTargets(-1 - outcome, int(swarm.round[0]), targets)
        if swarm.round[0] > before:
            yield
        if outcome == DONE:
            return
        if outcome == LOG_FULL:
            log = _grow_log(log, agents, most)


def _grow_log(log: BidLog, agents: int, most: int) -> BidLog:
    # Forget what has arrived everywhere; twice the room where that is not enough.
    first, end = log.size
    begin, stop = log.start[first], log.start[end]
    events = max(len(log.agent), 2 * (end - first + agents))
    entries = max(len(log.target), 2 * (stop - begin + most))
    fresh = BidLog.empty(int(events), int(entries))
    fresh.agent[: end - first] = log.agent[first:end]
    fresh.round[: end - first] = log.round[first:end]
    fresh.start[: end - first + 1] = log.start[first : end + 1] - begin
    for new, old in zip(fresh[3:6], log[3:6], strict=True):
        new[: stop - begin] = old[begin:stop]
    fresh.size[1] = end - first
    return fresh


@njit(cache=True)
@no_type_check
def _advance(stride, epsilon, ids, s, log):
    agents, targets = s.cost.shape
    # By name: numba counts references to every array of a tuple that is passed on.
    alive, target, told, last = s.alive, s.target_index, s.sent_price, s.last_news_round
    for _ in range(stride):
        end = log.size[1]
        if end + agents > len(log.agent) or log.start[end] + agents * (targets + 1) > len(
            log.target
        ):
            return LOG_FULL
        s.round[0] += 1
        _deliver(s, log)
        restless = False
        for i in range(agents):
            # Who bids nothing and hears nothing goes on counting: its round less its last.
            j = target[i]
            if not alive[i] or (j >= 0 and last[i] != s.round[0] and told[i] >= 0):
                continue
            if j < 0 or (s.winner[i, j] != i if ids else abs(s.price[i, j]) > told[i]):
                if not _place_bid(i, epsilon, ids, s, log):
                    return -1 - i
            else:
                s.target_count[i] = max(s.target_count[i], s.price_count[i])
            told[i] = s.price[i, target[i]]
            restless = restless or told[i] < 0
        if log.size[0] == log.size[1] and not restless:
            return DONE
    return RUNNING


@njit(cache=True)
@no_type_check
def _deliver(s, log):
    # What was written d rounds ago arrives d hops away from its writer.
    round, far = s.round[0], s.hop_start.shape[1] - 2
    price, holder, prices, holders, last = (
        s.price,
        s.winner,
        s.price_count,
        s.winner_count,
        s.last_news_round,
    )
    while log.size[0] < log.size[1] and round - log.round[log.size[0]] > far:
        log.size[0] += 1
    for e in range(log.size[0], log.size[1]):
        a, d = log.agent[e], round - log.round[e]
        for q in range(s.hop_start[a, d], s.hop_start[a, d + 1]):
            i = s.by_hops[a, q]
            for k in range(log.start[e], log.start[e + 1]):
                j, p, h = log.target[k], log.price[k], log.winner[k]
                size, mine = abs(p), abs(price[i, j])
                if size > mine or (size == mine and h < holder[i, j]):
                    prices[i] += price[i, j] == 0
                    holders[i] += (h >= 0) - (holder[i, j] >= 0)
                    price[i, j], holder[i, j], last[i] = p, h, round


@njit(cache=True)
@no_type_check
def _place_bid(i, epsilon, ids, s, log):
    # The same as `_bid` of `agent`; False if there are not enough targets.
    price, holder, cost = s.price[i], s.winner[i], s.cost[i]
    e, m = log.size[1], max(s.target_count[i], s.price_count[i])
    k = log.start[e]
    if s.winner_count[i] >= m:
        m = s.winner_count[i] + 1
        if m > len(price):
            return False
        for j in range(m):
            s.price_count[i] += price[j] == 0
            s.winner_count[i] -= holder[j] >= 0
            price[j], holder[j] = -(abs(price[j]) + epsilon), NO_WINNER
            log.target[k], log.price[k], log.winner[k] = j, price[j], NO_WINNER
            k += 1
    best, v, w = 0, np.inf, np.inf
    for j in range(m):
        total = cost[j] + abs(price[j])
        if total < v:
            best, v, w = j, total, v
        elif total < w:
            w = total
    if m == 1:
        w = v
    s.price_count[i] += price[best] == 0
    s.winner_count[i] += holder[best] < 0
    price[best] = abs(price[best]) + (w - v + epsilon)
    holder[best] = i if ids else ANONYMOUS
    log.target[k], log.price[k], log.winner[k] = best, price[best], holder[best]
    log.agent[e], log.round[e], log.start[e + 1] = i, s.round[0], k + 1
    log.size[1] += 1
    s.target_count[i], s.target_index[i] = m, best
    s.last_news_round[i] = s.last_bid_round[i] = s.round[0]
    s.bid_count[i] += 1
    return True
