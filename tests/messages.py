"""Definitions by messages: what one agent does in a round, for tests of batched code.

Distributed means: what an agent does is a pure function of its own memory and its inbox.
"""

from typing import NamedTuple

import numpy as np

from sato.auctions.vsdaa import ANONYMOUS, NO_WINNER, OutOfTargets
from sato.network.rounds import run_round
from sato.scp.planner import update_planner


def run_rounds(graph, states, update, message, is_finished):
    """Run synchronous rounds until all agents have finished; yield the states after each.

    A message sent at the end of one round is heard in the next, so news travels one hop a round.
    The last message of a finished agent stays readable; it does nothing more.
    """
    now = dict(states)
    while running := {i: state for i, state in now.items() if not is_finished(state)}:
        messages = {i: message(state) for i, state in now.items()}
        now |= run_round(graph, running, update, messages)
        yield dict(now)


def flood(graph, values, merge):
    """Agree on the merged value of a component, in as many rounds as its diameter."""

    def update(state, inbox):
        value, rounds_left = state
        for received in inbox:
            value = merge(value, received)
        return value, rounds_left - 1

    last = {i: (value, int(graph.diameter[i])) for i, value in values.items()}
    for now in run_rounds(graph, last, update, lambda s: s[0], lambda s: s[1] <= 0):
        last = now
    return {i: value for i, (value, _) in last.items()}


class WaveMessage(NamedTuple):
    """Message of an agent that measures its component."""

    known_agents: frozenset[int]  # agents whose wave has arrived, its own included
    max_eccentricity: int = -1  # largest eccentricity heard of; −1 for none


class DiameterEstimator(NamedTuple):
    """Memory of an agent that measures its component."""

    message: WaveMessage
    round: int = 0
    eccentricity: int = -1  # hops to the farthest agent; −1 while not known


def update_diameter(state, inbox):
    """Pass on the waves of all agents, and note when no new one arrives.

    Every agent starts a wave that carries its number, one hop a round. After r rounds an
    agent has heard of exactly those within r hops. A shortest path to its farthest agent,
    e hops away, passes through every distance below e, so something new arrives in each of
    the rounds 1 … e and nothing in round e + 1: then it knows e, its eccentricity, and
    that the diameter D is at most 2 e.

    Agents learn their e at different times, and gossip the largest they know from then on.
    Agent i may stop after 2 e_i further rounds, at its round 3 e_i + 1, since agent j knows
    e_j in round e_j + 1, and i, at most e_i hops away, hears it by round e_j + 1 + e_i,
    which is at most D + 1 + e_i ≤ 3 e_i + 1. By then it has heard of all, and the largest
    is D. An agent that stops does not cut others off: its last message stays readable and
    holds all there is to know. Since e_i ≤ D, all are through by round 3 D + 1, which every
    one of them can compute: the protocol that follows can begin there in step.
    """
    known = state.message.known_agents.union(*(message.known_agents for message in inbox))
    eccentricity, this_round = state.eccentricity, state.round + 1
    if eccentricity < 0 and known == state.message.known_agents:
        eccentricity = this_round - 1
    received = [message.max_eccentricity for message in inbox]
    largest = max([state.message.max_eccentricity, eccentricity, *received])
    return DiameterEstimator(WaveMessage(known, largest), this_round, eccentricity)


def learn_diameter(graph):
    """Run the measurement of each agent's component: yield every live agent after every round."""
    live = np.flatnonzero(graph.alive).tolist()
    states = {i: DiameterEstimator(WaveMessage(frozenset([i]))) for i in live}

    def knows_diameter(state):
        return state.eccentricity >= 0 and state.round >= 3 * state.eccentricity + 1

    return run_rounds(graph, states, update_diameter, lambda s: s.message, knows_diameter)


def plan_by_messages(planners, graph):
    """Run the exchange of trajectories: yield every planner after every round."""
    return run_rounds(
        graph, planners, update_planner, lambda agent: agent.message, lambda agent: agent.is_final
    )


class WinningBids(NamedTuple):
    """Price and winner of each target, as far as one agent knows.

    A positive price is a standing bid and has a winner. A negative one was a bid on a target
    that is for sale again: its magnitude still counts, and it has no winner. Zero: no bid yet.
    """

    price: np.ndarray
    winner: np.ndarray

    @classmethod
    def empty(cls, targets):
        return cls(np.zeros(targets), np.full(targets, NO_WINNER))

    @property
    def winner_count(self):
        """Number of standing bids, which is the number of bidders heard of."""
        return int(np.count_nonzero(self.winner != NO_WINNER))


def find_newer_bids(own, received):
    """Mark the targets of which `received` knows more.

    That is a larger |price|, or an equal one with a smaller winner. `NO_WINNER` is smaller than
    every agent, so of two equal magnitudes the negative price wins, and of two equal bids that
    of the smaller agent.
    """
    own_size, received_size = np.abs(own.price), np.abs(received.price)
    is_tie = (received_size == own_size) & (received.winner < own.winner)
    return (received_size > own_size) | is_tie


def merge_bids(own, received):
    """Keep the newer entry for each target.

    The larger of a total order, hence commutative, associative and idempotent: the order and
    the number of times in which messages arrive do not matter.
    """
    newer = find_newer_bids(own, received)
    return WinningBids(*(np.where(newer, *pair) for pair in zip(received, own, strict=True)))


class VsdaaBidder(NamedTuple):
    """Memory of one agent in an auction."""

    agent_id: int
    cost: np.ndarray
    epsilon: float
    bidder_ids: bool  # True where bids carry the bidder's number
    patience: int  # quiet rounds after which it stops: 2 D
    target_count: int  # m
    bids: WinningBids  # its last message
    target_index: int = -1  # j, the target of its last bid
    quiet_rounds: int = 0  # rounds without news: the count of the printed method
    round: int = 0
    bid_count: int = 0

    @property
    def is_finished(self):
        return self.target_index >= 0 and self.quiet_rounds >= self.patience


def update_bidder(agent, inbox):
    """Merge the messages (lines 27-29) and bid where the agent holds no target (8-25).

    The printed loop listens at the end of a round, here the agent does so at the start of the
    next: the same sequence. Prices have the length M throughout, padded with zeros.

    With `bidder_ids` a bid stands as long as the agent knows itself as the winner. Without, it
    trusts the price alone (line 8), and of two equal bids both bidders believe to hold the target.
    """
    bids = agent.bids
    for received in inbox:
        bids = merge_bids(bids, received)
    agent, j = agent._replace(round=agent.round + 1), agent.target_index
    if agent.bidder_ids:
        is_outbid = bids.winner[j] != agent.agent_id
    else:  # signed on purpose: a price negated at equal magnitude makes it bid a round later
        is_outbid = abs(bids.price[j]) > agent.bids.price[j]
    if j < 0 or is_outbid:
        return _place_bid(agent, bids)
    if all(map(np.array_equal, bids, agent.bids)):
        return agent._replace(quiet_rounds=agent.quiet_rounds + 1)
    m = max(agent.target_count, int(np.count_nonzero(bids.price)))
    return agent._replace(bids=bids, target_count=m, quiet_rounds=0)


def _place_bid(agent, known):
    price, winner, epsilon = known.price.copy(), known.winner.copy(), agent.epsilon
    m = max(agent.target_count, int(np.count_nonzero(price)))
    if known.winner_count >= m:  # lines 10-12: one target more, and all are for sale again
        m = known.winner_count + 1
        if m > len(price):
            raise OutOfTargets(agent.agent_id, agent.round, len(price))
        price[:m] = -(np.abs(price[:m]) + epsilon)
        winner[:m] = NO_WINNER
    total = agent.cost[:m] + np.abs(price[:m])
    j = int(np.argmin(total))
    v = total[j]
    w = np.min(np.delete(total, j)) if m > 1 else v  # line 16 has no minimum for m = 1
    price[j] = abs(price[j]) + (w - v + epsilon)
    winner[j] = agent.agent_id if agent.bidder_ids else ANONYMOUS
    return agent._replace(
        bids=WinningBids(price, winner),
        target_count=m,
        target_index=j,
        quiet_rounds=0,
        bid_count=agent.bid_count + 1,
    )


def bid_by_messages(auction):
    """Run VSDAA: yield every live agent after every round.

    Agents know the diameter of their component, agree on the largest m, then bid.
    """
    cost, graph = auction.cost, auction.graph
    live = np.flatnonzero(graph.alive).tolist()
    agreed = flood(graph, {i: int(auction.target_count[i]) for i in live}, max)
    empty, rules = WinningBids.empty(cost.shape[1]), (auction.epsilon, auction.bidder_ids)
    bidders = {
        i: VsdaaBidder(i, cost[i], *rules, 2 * int(graph.diameter[i]), agreed[i], empty)
        for i in live
    }
    return run_rounds(
        graph, bidders, update_bidder, lambda agent: agent.bids, lambda agent: agent.is_finished
    )
