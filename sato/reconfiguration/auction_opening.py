"""Openings of auctions: the number of targets, prices and first bids, from what all have reported.

Before they bid, the agents of a component know each other from the census, and their states from
the terms. So they know how many they are, and can forecast their auction: each computes the costs
of all, the best assignment, and its prices. At these the auction opens, and each agent first bids
on its target of the forecast, as long as no other is cheaper to it by more than ε/2. Bids correct
what others cannot know of an agent: a cost that was refined, or that of its plan.

The bound N ε does not depend on the forecast. At the end no other target is cheaper to an agent, at
its price p, by more than ε. So for the outcome σ and any other assignment σ*

    Σᵢ c_iσ(i) ≤ Σᵢ c_iσ*(i) + N ε + Σᵢ p_σ*(i) − Σᵢ p_σ(i)

and the last two sums do not count as long as no target that is left over is dearer than one that is
taken. With as many agents as targets none is left over. Otherwise a target may be that was taken in
the forecast alone: all agents see it at the end, and begin again without prices, with which targets
that are left over cost nothing [Bertsekas1992].
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.assignment import least_prices
from sato.auctions import VsdaaAuction, assign_centrally
from sato.auctions.vsdaa import Opening
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.bidding_rules import (
    apply_bidding_rules,
    compute_epsilon,
    firm_penalty,
    least_penalty,
)
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import AgentMemory, DecisionContext
from sato.reconfiguration.target_costs import compute_costs, cost_range


def counts_members(mission: Reconfiguration) -> bool:
    """Tell whether agents know from the census how many bid, and not from bids alone."""
    return mission.assignment == "auction" and mission.bidder_ids and not mission.printed


def count_targets(
    believed: Int[Array, "*agents"], members: Int[Array, "*agents"], targets: int
) -> Int[Array, "*agents"]:
    """Return m: what an agent believes, or the number of agents in its component, if more."""
    return np.asarray(np.minimum(np.maximum(believed, members), np.maximum(believed, targets)))


def is_forecast(mission: Reconfiguration, leg: Leg) -> bool:
    """Tell whether agents forecast their auctions.

    They do where they can compute each other's costs without a solver: of vehicles with equal
    limits, for least energy, and for least fuel where the fuel norm is 1. With a free choice of
    targets prices begin at zero, so that targets that are left over cost nothing.
    """
    if not counts_members(mission) or mission.uses_all_targets(leg):
        return False
    is_equal = len(mission.control_limits) == len(mission.speed_limits) == 1
    return is_equal and (mission.fuel_norm == 1 or mission.objective == "energy")


def forecast_opening(auction: VsdaaAuction) -> Opening:
    """Assign targets by the costs as all know them, and price these."""
    graph, found = auction.graph, assign_centrally(auction)
    price, target_index = np.zeros_like(auction.cost), found.target_index
    for c in range(graph.component.max(initial=-1) + 1):
        members = np.flatnonzero(graph.component == c)
        m = found.target_count[members[0]]
        price[members, :m] = -least_prices(auction.cost[members, :m], target_index[members])
    return Opening(price, target_index)


def has_dear_leftovers(price: Float[Array, "*agents targets"]) -> Bool[Array, "*agents"]:
    """Tell where a target that is left over is dearer than one that is taken, after an auction.

    Prices are signed, as each agent knows them.
    """
    is_taken = price > 0
    least = np.where(is_taken, price, np.inf).min(axis=-1)
    return np.asarray(np.where(is_taken, 0.0, np.abs(price)).max(axis=-1) > least)


def forecast_alone(
    context: DecisionContext,
    number: int,
    states: Mapping[int, Sequence[float]],
    is_firm: bool,
    order: Int[Array, " targets"],
    target_count: int,
) -> Opening:
    """Forecast the auction of a component as one of its agents does, for this agent alone.

    The states are those by which each of its component plans, its own included; `order` is that in
    which agents bid on targets, and `is_firm` True where the firm penalty is called for.
    """
    members, own = list(states), context.memory
    count, clock = len(members), np.full(len(members), own.clock[number])
    target, step = (np.tile(c[number], (count, 1)) for c in (own.claimed_target, own.claim_step))
    held = replace(AgentMemory.initial(clock), target_index=target[0, members], clock=clock)
    memory = replace(held, claimed_target=target, claim_step=step)
    graph = CommunicationGraph(~np.eye(count, dtype=bool), np.ones(count, dtype=bool))
    known = context._replace(graph=graph, state=np.array([*states.values()]), memory=memory)
    table, rows = compute_costs(known._replace(solvers=())), range(count)
    epsilon = compute_epsilon(context.mission, context.leg)
    ranges, least = [cost_range(table, i)[1] for i in rows], least_penalty(epsilon)
    firm = firm_penalty(ranges, least) if is_firm else None
    is_near = np.isin(np.arange(target.shape[1]), members)
    cost = np.array(
        [apply_bidding_rules(table, memory, i, is_near, firm, least=least) for i in rows]
    )
    opening = forecast_opening(VsdaaAuction(cost[:, order], graph, target_count, epsilon))
    own_row = [members.index(number)]
    return Opening(opening.price[own_row], opening.target_index[own_row])
