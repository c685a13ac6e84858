"""The rounds of `agent`, for all agents at once and compiled.

A book is merged only if it has changed since the listener last heard it: merging the
same again changes nothing.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit
from numpy import ndarray as Array

from sato.auction import NOBODY
from sato.network import Network


class Swarm(NamedTuple):
    """All agents of an auction, changed in place from round to round."""

    score: Float[Array, "agents points"]
    hears: Bool[Array, "agents agents"]
    price: Float[Array, "agents points"]
    holder: Int[Array, "agents points"]
    point: Int[Array, " agents"]
    sold: Int[Array, " agents"]  # standing bids in each book
    version: Int[Array, " agents"]  # how often each book has changed
    seen: Int[Array, "agents agents"]  # version of [j]'s book that [i] heard last
    told_price: Float[Array, "late agents points"]  # by the round in which it was told, mod late
    told_holder: Int[Array, "late agents points"]
    told_version: Int[Array, "late agents"]
    waiting: Bool[Array, " agents"]  # who takes part and does not yet know the end
    knew: Int[Array, " agents"]  # round in which an agent knew that it is over; 0 for not yet
    round: Int[Array, " 1"]


def gather(score: Float[Array, "agents points"], network: Network, delay: int) -> Swarm:
    """All agents before the first round, where messages are `delay` rounds late."""
    agents, points = score.shape

    def none(*shape: int) -> Array:
        return np.zeros(shape, dtype=np.int64)

    return Swarm(
        score=np.ascontiguousarray(score, dtype=np.float64),
        hears=np.ascontiguousarray(network.hears),
        price=np.zeros((agents, points)),
        holder=np.full((agents, points), NOBODY),
        point=np.full(agents, -1),
        sold=none(agents),
        version=none(agents),
        seen=none(agents, agents),
        told_price=np.zeros((delay + 1, agents, points)),
        told_holder=np.full((delay + 1, agents, points), NOBODY),
        told_version=none(delay + 1, agents),
        waiting=network.alive.copy(),
        knew=none(agents),
        round=none(1),
    )


def play(swarm: Swarm, rounds: int, loss: float, rng: np.random.Generator) -> None:
    """Play so many rounds more, or until all know the end.

    Args:
        swarm: Changed in place.
        rounds: At most so many.
        loss: Probability that a message is lost.
        rng: Drawn from only where messages can be lost: once for each agent that waits and
            each that it might hear, in order.
    """
    _play(rounds, float(loss), rng, swarm)


@njit(cache=True)
@no_type_check
def _play(rounds, loss, rng, s):
    agents, bidders = len(s.waiting), np.count_nonzero(s.waiting) + np.count_nonzero(s.knew)
    for _ in range(rounds):
        if not s.waiting.any():
            return
        s.round[0] += 1
        slot = s.round[0] % len(s.told_version)  # told first, of those still under way
        for i in range(agents):
            if s.waiting[i]:
                changed = _listen(i, slot, loss, rng, s)
                if s.point[i] < 0 or s.holder[i, s.point[i]] != i:
                    _bid(i, s)
                    changed = True
                s.version[i] += changed
                if s.sold[i] == bidders:
                    s.waiting[i], s.knew[i] = False, s.round[0]
        for i in range(agents):
            if s.told_version[slot, i] < s.version[i]:
                s.told_price[slot, i], s.told_holder[slot, i] = s.price[i], s.holder[i]
                s.told_version[slot, i] = s.version[i]


@njit(cache=True)
@no_type_check
def _listen(i, slot, loss, rng, s):
    # Merge what is heard into the book of i; whether that changed it.
    price, holder, news = s.price[i], s.holder[i], False
    for a in range(len(s.waiting)):
        lost = loss > 0 and rng.random() < loss
        if lost or not s.hears[i, a] or s.told_version[slot, a] <= s.seen[i, a]:
            continue
        s.seen[i, a] = s.told_version[slot, a]
        heard, whose = s.told_price[slot, a], s.told_holder[slot, a]
        for j in range(len(price)):
            if heard[j] > price[j] or (heard[j] == price[j] and whose[j] < holder[j]):
                s.sold[i] += price[j] == 0
                price[j], holder[j], news = heard[j], whose[j], True
    return news


@njit(cache=True)
@no_type_check
def _bid(i, s):
    # The same as `_bid` of `agent`.
    price, holder, score = s.price[i], s.holder[i], s.score[i]
    best, most = -1, 0.0
    for j in range(len(price)):
        wins = score[j] > price[j] or (score[j] == price[j] and i < holder[j])
        if wins and score[j] > most:
            best, most = j, score[j]
    s.sold[i] += price[best] == 0
    price[best], holder[best], s.point[i] = most, i, best
