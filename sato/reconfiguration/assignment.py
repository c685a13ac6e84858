"""Assignment of targets: claims, the auction and the clock [Morgan2016, Method 3, lines 3-13]."""

from dataclasses import replace
from math import isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import min_distance
from sato.auctions import VsdaaAuction, VsdaaResult, run_vsdaa
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.auction_costs import (
    CostTable,
    compute_bid_costs,
    compute_costs,
    refine_costs,
)
from sato.reconfiguration.mission import Leg, Reconfiguration
from sato.reconfiguration.state import AgentMemory, DecisionContext
from sato.scenario.definition import is_auto

RELATIVE_EPSILON = 0.01  # ε over the extent of the shape, where no tie-break gives a scale


class AssignmentDecision(NamedTuple):
    """Result of one or more auctions."""

    memory: AgentMemory
    was_reset: Bool[Array, " agents"]  # the clock was set back
    solve_count: int


def assign_targets(
    context: DecisionContext, memory: AgentMemory, planned_fuel: Float[Array, " agents"]
) -> AssignmentDecision:
    """Run an auction in every component; reset its clock where the number of bids changed.

    A clock is also reset where an agent won a target out of its reach; a mission may have it
    that this is the only reason. A component whose clock is reset bids again, with the time
    that it now has.

    Args:
        context: States and graph of the agents that decide.
        memory: Memory of the agents.
        planned_fuel: Fuel left in the plan to the target that each holds; infinite without one.
    """
    graph, before = context.graph, memory.clock
    memory = share_claims(memory, graph)
    was_reset = np.asarray(graph.alive & (memory.clock != before))
    auction = run_auction(context, memory, np.where(was_reset, np.inf, planned_fuel))
    solves = auction.solve_count
    is_called = auction.won_unreachable
    if context.mission.reset == "change":
        counted = auction.outcome.bidder_count
        is_called = is_called | ((memory.bidder_count > 0) & (counted != memory.bidder_count))
    is_due = graph.alive & (memory.clock > 0) & is_called
    is_due = graph.component_max(is_due.astype(int)).astype(bool) & graph.alive
    if is_due.any():
        was_reset = was_reset | is_due
        memory = replace(memory, clock=np.where(is_due, 0, memory.clock))
        auction = run_auction(context, memory, np.where(was_reset, np.inf, planned_fuel))
        solves += auction.solve_count
    if auction.won_unreachable.any():
        is_firm = graph.component_max(auction.won_unreachable.astype(int)).astype(bool)
        costs = np.where(was_reset, np.inf, planned_fuel)
        auction = run_auction(context, memory, costs, is_firm)
        solves += auction.solve_count
    return AssignmentDecision(_remember(memory, auction.outcome, context), was_reset, solves)


def share_claims(memory: AgentMemory, graph: CommunicationGraph) -> AgentMemory:
    """Agree in every component on the latest claims and on the clock with the most time left.

    The batched equivalent of flooding (`sato.network.rounds.flood`): of two claims of one
    agent the newer counts.
    """
    target, step = memory.claimed_target.copy(), memory.claim_step.copy()
    for c in range(graph.component.max(initial=-1) + 1):
        members = np.flatnonzero(graph.component == c)
        newest = step[members].argmax(axis=0)
        target[members] = target[members[newest], np.arange(len(newest))]
        step[members] = step[members].max(axis=0)
    clock = -graph.component_max(-memory.clock)
    return replace(memory, claimed_target=target, claim_step=step, clock=clock)


class AuctionResult(NamedTuple):
    """Result of an auction in which every winner's cost is exact."""

    outcome: VsdaaResult
    won_unreachable: Bool[Array, " agents"]  # the agent won a target out of its reach
    solve_count: int


def run_auction(
    context: DecisionContext,
    memory: AgentMemory,
    planned_fuel: Float[Array, " agents"],
    is_firm: Bool[Array, " agents"] | None = None,
) -> AuctionResult:
    """Run an auction in every component, refining costs until all winners' costs are exact.

    A cost that is only a lower bound is made exact when it wins, and the auction is run
    again. At the end all winners' costs are exact and no other exceeds its true value, so
    the bound N ε holds for the exact costs. In a real network, agents would flood that a cost
    was refined, like everything else that a component agrees on.
    """
    table, solves = compute_costs(context, memory, planned_fuel), 0
    epsilon = compute_epsilon(context.mission, context.leg)
    live, ids = np.flatnonzero(context.graph.alive), context.mission.bidder_ids
    while True:
        cost = compute_bid_costs(table, memory, context.graph, is_firm)
        auction = run_vsdaa(
            VsdaaAuction(cost, context.graph, memory.target_count, epsilon, bidder_ids=ids)
        )
        won = auction.target_index[live]
        inexact = np.flatnonzero(~table.is_exact[live, won])
        if not len(inexact):
            return AuctionResult(auction, _won_unreachable(table, auction, live), solves)
        pairs = [(int(live[k]), int(won[k])) for k in inexact]
        table, solves = refine_costs(context, memory, table, pairs), solves + len(pairs)


def compute_epsilon(mission: Reconfiguration, leg: Leg) -> float:
    """Compute the bid increment ε [m] from the mission alone, the same for all agents."""
    if not is_auto(mission.epsilon):
        return mission.epsilon
    position = leg.targets[:, : mission.axes]
    if mission.tie_break == 0:
        extent = float(np.linalg.norm(np.ptp(position, axis=0)))
        return RELATIVE_EPSILON * (extent if extent > 0 else 1.0)
    spacing = min_distance(position)
    return 0.5 * mission.tie_break * (spacing if isfinite(spacing) else 1.0) ** 2


def _won_unreachable(table: CostTable, auction: VsdaaResult, live: Array) -> Bool[Array, " agents"]:
    found = np.zeros(len(auction.target_index), dtype=bool)
    found[live] = ~table.is_reachable[live, auction.target_index[live]]
    return found


def _remember(memory: AgentMemory, auction: VsdaaResult, context: DecisionContext) -> AgentMemory:
    graph, alive = context.graph, context.graph.alive
    together = (graph.component[:, None] == graph.component) & alive[:, None] & alive
    return replace(
        memory,
        target_index=np.where(alive, auction.target_index, memory.target_index),
        target_count=np.where(alive, auction.target_count, memory.target_count),
        bidder_count=np.where(alive, auction.bidder_count, memory.bidder_count),
        claimed_target=np.where(together, auction.target_index, memory.claimed_target),
        claim_step=np.where(together, context.step_index, memory.claim_step),
    )
