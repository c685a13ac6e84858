"""Rounds of messages between agents, for tests of batched code.

Distributed means: what an agent does is a pure function of its own memory and its inbox.
"""

from typing import NamedTuple

import numpy as np

from sato.auctions.bidder import VsdaaBidder, WinningBids
from sato.auctions.vsdaa import Opening
from sato.network.flooding import Census, CensusMessage
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


class Hello(NamedTuple):
    """Report of an agent that has no more to tell than its number."""

    agent: int


def learn_diameter(graph):
    """Run the measurement of each agent's component: yield every live agent after every round."""
    live = np.flatnonzero(graph.alive).tolist()
    states = {i: Census(CensusMessage(frozenset([Hello(i)]))) for i in live}
    return run_rounds(graph, states, Census.update, lambda s: s.message, lambda s: s.knows_diameter)


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
    opening = auction.opening or Opening.empty(*cost.shape)
    bidders = {
        i: VsdaaBidder(
            i, cost[i], *rules, 2 * int(graph.diameter[i]), agreed[i],
            empty._replace(price=opening.price[i]), first_target=int(opening.target_index[i]),
        )
        for i in live
    }  # fmt: skip
    return run_rounds(
        graph,
        bidders,
        VsdaaBidder.update,
        lambda agent: agent.bids,
        lambda agent: agent.is_finished,
    )
