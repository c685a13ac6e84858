"""Rounds of CBAA for all agents at once, compiled; equal to `cbaa.update_bidder`.

A message is merged only if it has changed since the receiver last heard it: merging the same
again changes nothing.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int
from numba import njit
from numpy import ndarray as Array

from sato.auctions.bids import NO_WINNER
from sato.network.graph import CommunicationGraph


class CbaaState(NamedTuple):
    """Memory of all agents in an auction, changed in place from round to round."""

    score: Float[Array, "agents points"]
    adjacency: Bool[Array, "agents agents"]
    price: Float[Array, "agents points"]
    winner: Int[Array, "agents points"]
    point: Int[Array, " agents"]
    winner_count: Int[Array, " agents"]  # standing bids that each agent knows
    version: Int[Array, " agents"]  # number of changes to what each agent knows
    seen_version: Int[Array, "agents agents"]  # version that [i] last heard from [j]
    sent_price: Float[Array, "slots agents points"]  # of round r in slot r mod (delay + 1)
    sent_winner: Int[Array, "slots agents points"]
    sent_version: Int[Array, "slots agents"]
    is_running: Bool[Array, " agents"]  # True while an agent does not know the end
    finished_round: Int[Array, " agents"]  # round in which it knew the end; 0 for not yet
    round: Int[Array, " 1"]


def init_state(
    score: Float[Array, "agents points"], graph: CommunicationGraph, delay: int
) -> CbaaState:
    """Initialize all agents, for messages that are `delay` rounds late."""
    agents, points = score.shape

    def zeros(*shape: int) -> Array:
        return np.zeros(shape, dtype=np.int64)

    return CbaaState(
        score=np.ascontiguousarray(score, dtype=np.float64),
        adjacency=np.ascontiguousarray(graph.adjacency),
        price=np.zeros((agents, points)),
        winner=np.full((agents, points), NO_WINNER),
        point=np.full(agents, -1),
        winner_count=zeros(agents),
        version=zeros(agents),
        seen_version=zeros(agents, agents),
        sent_price=np.zeros((delay + 1, agents, points)),
        sent_winner=np.full((delay + 1, agents, points), NO_WINNER),
        sent_version=zeros(delay + 1, agents),
        is_running=graph.alive.copy(),
        finished_round=zeros(agents),
        round=zeros(1),
    )


def run_kernel(state: CbaaState, rounds: int, loss: float, rng: np.random.Generator) -> None:
    """Run at most so many rounds more, until all agents know the end.

    Args:
        state: Memory of all agents, changed in place.
        rounds: Largest number of rounds.
        loss: Probability that a message is lost.
        rng: Generator of the losses, drawn from only where messages can be lost: once for each
            agent that does not know the end and each agent of the swarm, in order.
    """
    _run_kernel(rounds, float(loss), rng, state)


@njit(cache=True)
@no_type_check
def _run_kernel(rounds, loss, rng, s):
    agents = len(s.is_running)
    bidders = np.count_nonzero(s.is_running) + np.count_nonzero(s.finished_round)
    for _ in range(rounds):
        if not s.is_running.any():
            return
        s.round[0] += 1
        slot = s.round[0] % len(s.sent_version)  # holds the oldest messages on their way
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
    # Merge the messages that arrive at agent i; True where that changed what it knows.
    price, winner, changed = s.price[i], s.winner[i], False
    for a in range(len(s.is_running)):
        lost = loss > 0 and rng.random() < loss
        if lost or not s.adjacency[i, a] or s.sent_version[slot, a] <= s.seen_version[i, a]:
            continue
        s.seen_version[i, a] = s.sent_version[slot, a]
        sent_price, sent_winner = s.sent_price[slot, a], s.sent_winner[slot, a]
        for j in range(len(price)):
            if sent_price[j] > price[j] or (
                sent_price[j] == price[j] and sent_winner[j] < winner[j]
            ):
                s.winner_count[i] += price[j] == 0
                price[j], winner[j], changed = sent_price[j], sent_winner[j], True
    return changed


@njit(cache=True)
@no_type_check
def _place_bid(i, s):
    # Equal to `cbaa._place_bid`.
    price, winner, score = s.price[i], s.winner[i], s.score[i]
    best, most = -1, 0.0
    for j in range(len(price)):
        wins = score[j] > price[j] or (score[j] == price[j] and i < winner[j])
        if wins and score[j] > most:
            best, most = j, score[j]
    s.winner_count[i] += price[best] == 0
    price[best], winner[best], s.point[i] = most, i, best
