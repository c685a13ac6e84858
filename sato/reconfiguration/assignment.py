"""Who goes where: claims, the auction and the clock [Morgan2016, Method 3, lines 3-13]."""

from dataclasses import replace
from math import isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import min_distance
from sato.auctions import VsdaaResult, run_vsdaa
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.auction_costs import (
    AgentMemory,
    CostTable,
    compute_bid_costs,
    compute_costs,
    refine_costs,
)
from sato.reconfiguration.mission import Leg, Reconfiguration
from sato.reconfiguration.moment import DecisionContext
from sato.scenario.definition import is_auto

RELATIVE_EPSILON = 0.01  # ε over the extent of the shape, where there is no tie-break to tell it


class AssignmentDecision(NamedTuple):
    """What came out of one or more auctions."""

    memory: AgentMemory
    was_reset: Bool[Array, " agents"]  # whose clock went back
    solve_count: int


def assign_targets(
    moment: DecisionContext, minds: AgentMemory, planned: Float[Array, " agents"]
) -> AssignmentDecision:
    """Let every network bid, and set its clock back where the number of bids changed.

    A clock also goes back where somebody won a target out of its reach; a mission may have
    it that this is the only reason. A network whose clock goes back bids again, with the
    time that it now has.

    Args:
        moment: What there is to decide with.
        minds: What the agents remember.
        planned: Fuel left in the plan to the target that each holds; infinite without one.
    """
    network, before = moment.graph, minds.clock
    minds = share_claims(minds, network)
    reset = np.asarray(network.alive & (minds.clock != before))
    sale = run_auction(moment, minds, np.where(reset, np.inf, planned))
    solves = sale.solve_count
    changed = (minds.bidder_count > 0) & (sale.outcome.bidder_count != minds.bidder_count)
    calls = (
        sale.won_unreachable | changed if moment.mission.reset == "change" else sale.won_unreachable
    )
    due = network.alive & (minds.clock > 0) & calls
    due = network.component_max(due.astype(int)).astype(bool) & network.alive
    if due.any():
        reset = reset | due
        minds = replace(minds, clock=np.where(due, 0, minds.clock))
        sale = run_auction(moment, minds, np.where(reset, np.inf, planned))
        solves += sale.solve_count
    if sale.won_unreachable.any():
        firm = network.component_max(sale.won_unreachable.astype(int)).astype(bool)
        sale = run_auction(moment, minds, np.where(reset, np.inf, planned), firm)
        solves += sale.solve_count
    return AssignmentDecision(_update_memory(minds, sale.outcome, moment), reset, solves)


def share_claims(minds: AgentMemory, network: CommunicationGraph) -> AgentMemory:
    """Agree within every network on the claims heard last and the clock with longest to go.

    The batched equivalent of flooding (`network.rounds.flood`): of two claims of one agent the
    newer counts.
    """
    claimed, heard = minds.claimed_target.copy(), minds.claim_step.copy()
    for c in range(network.component.max(initial=-1) + 1):
        members = np.flatnonzero(network.component == c)
        newest = heard[members].argmax(axis=0)
        claimed[members] = claimed[members[newest], np.arange(len(newest))]
        heard[members] = heard[members].max(axis=0)
    clock = -network.component_max(-minds.clock)
    return replace(minds, claimed_target=claimed, claim_step=heard, clock=clock)


class AuctionResult(NamedTuple):
    outcome: VsdaaResult
    won_unreachable: Bool[Array, " agents"]  # who won a target out of its reach
    solve_count: int


def run_auction(
    moment: DecisionContext,
    minds: AgentMemory,
    planned: Float[Array, " agents"],
    firm: Bool[Array, " agents"] | None = None,
) -> AuctionResult:
    # A price that is only a lower bound is settled when it wins, and the auction is run
    # again. At the end all winners' prices are exact and no other is above the truth, so
    # the promise of N ε holds for the exact prices. That somebody's price was settled is
    # flooded like everything else that a network agrees on.
    offered, solves = compute_costs(moment, minds, planned), 0
    epsilon = compute_epsilon(moment.mission, moment.leg)
    live = np.flatnonzero(moment.graph.alive)
    while True:
        cost = compute_bid_costs(offered, minds, moment.graph, firm)
        ids = moment.mission.bidder_ids
        auction = run_vsdaa(cost, moment.graph, minds.target_count, epsilon, bidder_ids=ids)
        won = auction.target_index[live]
        doubtful = np.flatnonzero(~offered.is_exact[live, won])
        if not len(doubtful):
            return AuctionResult(
                auction, _find_unreachable_winners(offered, auction, moment.graph), solves
            )
        pairs = [(int(live[k]), int(won[k])) for k in doubtful]
        offered, solves = refine_costs(moment, minds, offered, pairs), solves + len(pairs)


def _find_unreachable_winners(
    offered: CostTable, auction: VsdaaResult, network: CommunicationGraph
) -> Bool[Array, " agents"]:
    unreached = np.zeros(len(network.alive), dtype=bool)
    live = np.flatnonzero(network.alive)
    unreached[live] = ~offered.is_reachable[live, auction.target_index[live]]
    return unreached


def compute_epsilon(mission: Reconfiguration, leg: Leg) -> float:
    """ε, from the mission alone, so that all agents know the same [m]."""
    if not is_auto(mission.epsilon):
        return mission.epsilon
    places = leg.targets[:, : mission.linear_model.axes]
    if mission.tie_break == 0:
        extent = float(np.linalg.norm(np.ptp(places, axis=0)))
        return RELATIVE_EPSILON * (extent if extent > 0 else 1.0)
    spacing = min_distance(places)
    return 0.5 * mission.tie_break * (spacing if isfinite(spacing) else 1.0) ** 2


def _update_memory(
    minds: AgentMemory, auction: VsdaaResult, moment: DecisionContext
) -> AgentMemory:
    network, alive = moment.graph, moment.graph.alive
    together = (network.component[:, None] == network.component) & alive[:, None] & alive
    return replace(
        minds,
        target_index=np.where(alive, auction.target_index, minds.target_index),
        target_count=np.where(alive, auction.target_count, minds.target_count),
        bidder_count=np.where(alive, auction.bidder_count, minds.bidder_count),
        claimed_target=np.where(together, auction.target_index, minds.claimed_target),
        claim_step=np.where(together, moment.step_index, minds.claim_step),
    )
