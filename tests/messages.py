"""Rounds of messages between agents, for tests of batched code.

Distributed means: what an agent does is a pure function of its own memory and its inbox.
"""

from typing import NamedTuple

import numpy as np

from sato.auctions.bidder import VsdaaBidder, WinningBids
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
        graph,
        bidders,
        VsdaaBidder.update,
        lambda agent: agent.bids,
        lambda agent: agent.is_finished,
    )
