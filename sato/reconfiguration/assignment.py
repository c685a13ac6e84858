"""Assignment of targets: claims, the auction, the clock [Morgan2016, Method 3, l. 3-13]."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.auctions import VsdaaAuction, VsdaaResult, assign_centrally, assign_given, run_vsdaa
from sato.auctions.vsdaa import Opening
from sato.network.encoding import AUCTION_REPORT, BID, REAL, TERMS, measure_claims
from sato.network.graph import CommunicationGraph
from sato.network.load import Load, count_flood, fingerprint
from sato.reconfiguration.auction_opening import (
    count_targets,
    counts_members,
    forecast_opening,
    has_dear_leftovers,
    is_forecast,
)
from sato.reconfiguration.bidding_rules import compute_bid_costs, compute_epsilon, least_penalty
from sato.reconfiguration.blocked_targets import find_all_blocked, order_targets
from sato.reconfiguration.clock import set_back, wait
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import AgentMemory, DecisionContext
from sato.reconfiguration.target_costs import compute_costs, refine_cost, trust_plans

METHODS = {"auction": run_vsdaa, "given": assign_given, "central": assign_centrally}


class AssignmentDecision(NamedTuple):
    """Result of one or more auctions."""

    memory: AgentMemory
    was_reset: Bool[Array, " agents"]  # the clock was set back
    solve_count: int
    load: Load
    blocked: Bool[Array, "agents targets"] | None = None  # targets that were left out


class AuctionResult(NamedTuple):
    """Result of an auction in which every winner's cost is exact."""

    outcome: VsdaaResult
    won_unreachable: Bool[Array, " agents"]  # the agent won a target out of its reach
    solve_count: int
    load: Load


def assign_targets(
    context: DecisionContext,
    planned_cost: Float[Array, " agents"],
    heard: Int[Array, " agents"] | None = None,
) -> AssignmentDecision:
    """Run an auction in every component; reset its clock where the number of bids changed.

    A clock is also reset where an agent won a target out of its reach; a mission may have it
    that this is the only reason. A component whose clock is reset bids again, with the time
    that it now has. The planned cost is the fuel or energy left in the plan to the target that
    each holds, infinite without a plan; and the clock that is heard that with the most time left
    of those that plan again in each agent's component.
    """
    heard = context.memory.clock if heard is None else heard
    waiting = replace(context.memory, clock=wait(context, heard, np.isfinite(planned_cost)))
    context = context._replace(graph=agreement_graph(context.mission, context.graph))
    graph, memory = context.graph, share_claims(waiting, context.graph)
    known = find_all_blocked(context)
    blocked = None if known is None else graph.component_any(known)
    was_reset = np.asarray(graph.alive & (memory.clock != context.memory.clock))
    cost = np.where(was_reset, np.inf, planned_cost)
    context = context._replace(memory=memory)
    auction = run_auction(context, cost, None, blocked)
    solves, load = auction.solve_count, _count_claims(context.mission, graph, waiting, known)
    load = load.plus(auction.load)
    is_called = needs_reset(context, auction.outcome.bidder_count, auction.won_unreachable)
    is_due = graph.component_any(graph.alive & is_called) & graph.alive
    if is_due.any():
        was_reset, cost = was_reset | is_due, np.where(is_due, np.inf, cost)
        context = context._replace(memory=replace(memory, clock=set_back(context, is_due)))
        auction = run_auction(context, cost, None, blocked)
        solves, load = solves + auction.solve_count, load.plus(auction.load, is_due)
    if auction.won_unreachable.any():
        is_firm = graph.component_any(auction.won_unreachable)
        auction = run_auction(context, cost, is_firm, blocked)
        solves, load = solves + auction.solve_count, load.plus(auction.load, is_firm)
    return AssignmentDecision(_remember(context, auction.outcome), was_reset, solves, load, blocked)


def agreement_graph(mission: Reconfiguration, graph: CommunicationGraph) -> CommunicationGraph:
    """Return the graph of those that agree on targets: none where they are given, or all."""
    if mission.assignment == "auction":
        return graph
    together = np.outer(graph.alive, graph.alive) & (mission.assignment == "central")
    return CommunicationGraph(together & ~np.eye(len(together), dtype=bool), graph.alive)


def needs_reset(
    context: DecisionContext,
    counted: Int[Array, " agents"],
    won_unreachable: Bool[Array, " agents"],
) -> Bool[Array, " agents"]:
    """Find the agents that call for a reset of their component's clock after an auction.

    They counted so many bidders in it, and may have won targets out of their reach.
    """
    is_called, memory = won_unreachable, context.memory
    if context.mission.reset == "change":
        is_called = is_called | ((memory.bidder_count > 0) & (counted != memory.bidder_count))
    return np.asarray((memory.clock > 0) & is_called)


def share_claims(memory: AgentMemory, graph: CommunicationGraph) -> AgentMemory:
    """Agree in every component on the latest claims and on the clock with the most time left.

    The batched equivalent of flooding: of two claims of one agent the newer counts.
    """
    target, step = memory.claimed_target.copy(), memory.claim_step
    for c in range(graph.component.max(initial=-1) + 1):
        members = np.flatnonzero(graph.component == c)
        newest = step[members].argmax(axis=0)
        target[members] = target[members[newest], np.arange(len(newest))]
    step, clock = graph.component_max(step), -graph.component_max(-memory.clock)
    return replace(memory, claimed_target=target, claim_step=step, clock=clock)


def claim_targets(context: DecisionContext, memory: AgentMemory) -> AgentMemory:
    """Claim the targets that agents hold, also again in components that have not changed."""
    graph, alive = context.graph, context.graph.alive
    together = (graph.component[:, None] == graph.component) & alive[:, None] & alive
    return replace(
        memory,
        claimed_target=np.where(together, memory.target_index, memory.claimed_target),
        claim_step=np.where(together, context.step_index, memory.claim_step),
    )


def _remember(context: DecisionContext, auction: VsdaaResult) -> AgentMemory:
    memory, alive = context.memory, context.graph.alive
    held = replace(
        memory,
        target_index=np.where(alive, auction.target_index, memory.target_index),
        target_count=np.where(alive, auction.target_count, memory.target_count),
        bidder_count=np.where(alive, auction.bidder_count, memory.bidder_count),
    )
    return claim_targets(context, held)


def run_auction(
    context: DecisionContext,
    planned_cost: Float[Array, " agents"],
    is_firm: Bool[Array, " agents"] | None = None,
    blocked: Bool[Array, "agents targets"] | None = None,
) -> AuctionResult:
    """Run an auction in every component, refining costs until all winners' costs are exact.

    A cost that is only a lower bound is made exact when it wins, and the auction is run
    again. At the end all winners' costs are exact and no other exceeds its true value, so
    the bound N ε holds for the exact costs. In a real network, agents would flood that a cost
    was refined, like everything else that a component agrees on.
    """
    mission, graph, memory = context.mission, context.graph, context.memory
    epsilon, live = compute_epsilon(mission, context.leg), np.flatnonzero(graph.alive)
    least = least_penalty(epsilon)
    table, solves = compute_costs(context), 0
    count, order = memory.target_count, np.arange(len(context.leg.targets))
    if blocked is not None:
        order, count = order_targets(count, blocked)
    if counts_members(mission):  # also where fewer are open than there are agents
        count = count_targets(count, graph.component_sizes, order.shape[-1])
    order = np.broadcast_to(order, table.cost.shape)

    def make(opening: Opening | None) -> VsdaaAuction:
        bids = compute_bid_costs(table, memory, graph, is_firm, mission.printed, least)
        cost = np.take_along_axis(bids, order, axis=1)
        return VsdaaAuction(cost, graph, count, epsilon, mission.bidder_ids, opening)

    opening = forecast_opening(make(None)) if is_forecast(mission, context.leg) else None
    table = trust_plans(context, table, planned_cost)
    load, bids = Load.none(len(graph.alive)), graph.alive  # that bid, at first all
    while True:
        auction = METHODS[mission.assignment](make(opening))
        load = load.plus(_count_load(auction, graph, context.state.shape[1]), bids)
        is_dear = graph.alive & has_dear_leftovers(auction.price)
        if opening is not None and is_dear.any():
            opening, bids = opening.without(is_dear), is_dear
            continue
        index = order[np.arange(len(order)), np.maximum(auction.target_index, 0)]
        auction = auction._replace(
            target_index=np.where(graph.alive, index, -1),
            target_count=np.maximum(auction.target_count, memory.target_count),
        )
        won = auction.target_index[live]
        inexact = ~table.is_exact[live, won]
        if not inexact.any():
            lost = np.zeros(len(graph.alive), dtype=bool)
            lost[live] = ~table.is_reachable[live, won]
            return AuctionResult(auction, lost, solves, load)
        solves += int(inexact.sum())
        bids = graph.component_any(np.isin(np.arange(len(bids)), live[inexact]))
        for i, j in zip(live[inexact].tolist(), won[inexact].tolist(), strict=True):
            refine_cost(context, table, i, j)


def _count_load(auction: VsdaaResult, graph: CommunicationGraph, states: int) -> Load:
    """Count the load of an auction: of its terms, of bids, and of reports that all have stopped.

    When the first agent stops, none has had news for at least D rounds.
    """
    bids = graph.alive & (auction.stop_round > 0)
    if not bids.any():
        return Load.none(len(bids))
    terms = count_flood(graph, graph.diameter, np.where(bids, 0, -1), TERMS + REAL * states)
    first = int(auction.stop_round[bids].min())
    made = np.where(bids, auction.stop_round - first, -1)
    last = graph.component_max(made) + graph.diameter
    reports = count_flood(graph, last, made, AUCTION_REPORT)
    news = auction.message_count, BID * auction.entry_count
    return Load.of(graph, bids.nonzero()[0], first + last + graph.diameter, terms, news, reports)


def _count_claims(
    mission: Reconfiguration,
    graph: CommunicationGraph,
    memory: AgentMemory,
    blocked: Bool[Array, "agents targets"] | None,
) -> Load:
    """Count the load of claims and blocked targets in the first terms of an auction.

    Of those that are the same for several agents, each agent tells once.
    """
    payload, live = np.zeros(len(graph.alive), dtype=np.int64), np.flatnonzero(graph.alive)
    if mission.assignment == "auction":
        tables = memory.claim_step, memory.claimed_target, *([] if blocked is None else [blocked])
        kind = np.sum([fingerprint(table) for table in tables], axis=0)[live]
        for first, which in zip(*np.unique(kind, return_index=True)[::-1], strict=True):
            known, count = memory.claim_step[live[first]], 0
            if blocked is not None:
                count = int(blocked[live[first]].sum())
            near = graph.hops[:, live[kind == which]].min(axis=1)
            size = measure_claims(known[known >= 0].tolist(), count)
            payload += np.where(near < graph.diameter, size, 0)
    none = np.zeros_like(payload)
    return Load.of(graph, live, none, (none, payload))
