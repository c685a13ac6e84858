"""The rounds of `agent`, for all agents at once and compiled.

A book is merged only if it has changed since the listener last heard it: merging the
same again changes nothing.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit
from numpy import ndarray as Array

from sato.auctions.bids import NO_WINNER
from sato.network.graph import CommunicationGraph


class CbaaState(NamedTuple):
    """All agents of an auction, changed in place from round to round."""

    score: Float[Array, "agents points"]
    adjacency: Bool[Array, "agents agents"]
    price: Float[Array, "agents points"]
    winner: Int[Array, "agents points"]
    point: Int[Array, " agents"]
    winner_count: Int[Array, " agents"]  # standing bids in each book
    version: Int[Array, " agents"]  # how often each book has changed
    seen_version: Int[Array, "agents agents"]  # version of [j]'s book that [i] heard last
    sent_price: Float[Array, "late agents points"]  # by the round in which it was told, mod late
    sent_winner: Int[Array, "late agents points"]
    sent_version: Int[Array, "late agents"]
    is_running: Bool[Array, " agents"]  # who takes part and does not yet know the end
    finished_round: Int[
        Array, " agents"
    ]  # round in which an agent knew that it is over; 0 for not yet
    round: Int[Array, " 1"]


def init_state(
    score: Float[Array, "agents points"], network: CommunicationGraph, delay: int
) -> CbaaState:
    """All agents before the first round, where messages are `delay` rounds late."""
    agents, points = score.shape

    def none(*shape: int) -> Array:
        return np.zeros(shape, dtype=np.int64)

    return CbaaState(
        score=np.ascontiguousarray(score, dtype=np.float64),
        adjacency=np.ascontiguousarray(network.adjacency),
        price=np.zeros((agents, points)),
        winner=np.full((agents, points), NO_WINNER),
        point=np.full(agents, -1),
        winner_count=none(agents),
        version=none(agents),
        seen_version=none(agents, agents),
        sent_price=np.zeros((delay + 1, agents, points)),
        sent_winner=np.full((delay + 1, agents, points), NO_WINNER),
        sent_version=none(delay + 1, agents),
        is_running=network.alive.copy(),
        finished_round=none(agents),
        round=none(1),
    )


def run_kernel(swarm: CbaaState, rounds: int, loss: float, rng: np.random.Generator) -> None:
    """Play so many rounds more, or until all know the end.

    Args:
        swarm: Changed in place.
        rounds: At most so many.
        loss: Probability that a message is lost.
        rng: Drawn from only where messages can be lost: once for each agent that waits and
            each that it might hear, in order.
    """
    _run_kernel(rounds, float(loss), rng, swarm)


@njit(cache=True)
@no_type_check
def _run_kernel(rounds, loss, rng, s):
    agents, bidders = (
        len(s.is_running),
        np.count_nonzero(s.is_running) + np.count_nonzero(s.finished_round),
    )
    for _ in range(rounds):
        if not s.is_running.any():
            return
        s.round[0] += 1
        slot = s.round[0] % len(s.sent_version)  # told first, of those still under way
        for i in range(agents):
            if s.is_running[i]:
                changed = _merge_inbox(i, slot, loss, rng, s)
                if s.point[i] < 0 or s.winner[i, s.point[i]] != i:
                    _place_bid(i, s)
                    changed = True
                s.version[i] += changed
                if s.winner_count[i] == bidders:
                    s.is_running[i], s.finished_round[i] = False, s.round[0]
        for i in range(agents):
            if s.sent_version[slot, i] < s.version[i]:
                s.sent_price[slot, i], s.sent_winner[slot, i] = s.price[i], s.winner[i]
                s.sent_version[slot, i] = s.version[i]


@njit(cache=True)
@no_type_check
def _merge_inbox(i, slot, loss, rng, s):
    # Merge what is heard into the book of i; whether that changed it.
    price, holder, news = s.price[i], s.winner[i], False
    for a in range(len(s.is_running)):
        lost = loss > 0 and rng.random() < loss
        if lost or not s.adjacency[i, a] or s.sent_version[slot, a] <= s.seen_version[i, a]:
            continue
        s.seen_version[i, a] = s.sent_version[slot, a]
        heard, whose = s.sent_price[slot, a], s.sent_winner[slot, a]
        for j in range(len(price)):
            if heard[j] > price[j] or (heard[j] == price[j] and whose[j] < holder[j]):
                s.winner_count[i] += price[j] == 0
                price[j], holder[j], news = heard[j], whose[j], True
    return news


@njit(cache=True)
@no_type_check
def _place_bid(i, s):
    # The same as `_bid` of `agent`.
    price, holder, score = s.price[i], s.winner[i], s.score[i]
    best, most = -1, 0.0
    for j in range(len(price)):
        wins = score[j] > price[j] or (score[j] == price[j] and i < holder[j])
        if wins and score[j] > most:
            best, most = j, score[j]
    s.winner_count[i] += price[best] == 0
    price[best], holder[best], s.point[i] = most, i, best
