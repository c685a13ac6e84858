"""Auction costs: the cost of every target for every agent, and three rules of bidding."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.discretize import DiscreteModel
from dynamics.double_integrator import DoubleIntegrator
from problems.auction_cost import (
    compute_distances,
    compute_energies,
    compute_transfer_costs,
    solve_transfer,
)
from problems.transfer import TransferProblem
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.mission import Leg, Reconfiguration
from sato.reconfiguration.state import AgentMemory, DecisionContext

HELD_TARGET_DISCOUNT = 0.02  # on the target that an agent holds, of its range of costs
MIN_PENALTY = 1.0  # least penalty on a target to be left alone [m]


class CostTable(NamedTuple):
    """Costs of all targets for all agents, before the rules of bidding."""

    cost: Float[Array, "agents targets"]  # [m]; where out of reach, the tie-break alone
    is_reachable: Bool[Array, "agents targets"]
    is_exact: Bool[Array, "agents targets"]  # else a lower bound, and perhaps out of reach


def compute_costs(
    context: DecisionContext, memory: AgentMemory, planned_fuel: Float[Array, " agents"]
) -> CostTable:
    """Compute the cost of every target for every agent that decides.

    Args:
        context: States and graph of the agents that decide.
        memory: Memory of the agents.
        planned_fuel: Fuel left in the plan to the target that each holds; infinite without one.
    """
    mission, leg = context.mission, context.leg
    N, M = len(context.state), len(leg.targets)
    cost, tie = np.zeros((N, M)), np.zeros((N, M))
    reachable, exact = np.ones((N, M), dtype=bool), np.ones((N, M), dtype=bool)
    for clock in np.unique(memory.clock[context.graph.alive]):
        agents = np.flatnonzero(context.graph.alive & (memory.clock == clock))
        model, x = context.remaining_model(int(clock)), context.state[agents]
        cost[agents], reachable[agents], exact[agents] = _primary_costs(mission, leg, model, x)
        tie[agents] = _tie_break(mission, leg, model, x)
    # A plan that was found stays feasible: where it is tight, rounding must not say otherwise.
    for i in np.flatnonzero(np.isfinite(planned_fuel)):
        j = memory.target_index[i]
        if not reachable[i, j]:
            model, x = context.remaining_model(0), context.state[[i]]
            distance = compute_distances(model, x, leg.targets[[j]])[0, 0]
            by_fuel = _fuel_to_distance(mission, leg) * planned_fuel[i]
            cost[i, j] = by_fuel if mission.cost == "fuel" else distance
            reachable[i, j] = exact[i, j] = True
    return CostTable(np.where(reachable, cost, 0.0) + mission.tie_break * tie, reachable, exact)


def refine_costs(
    context: DecisionContext,
    memory: AgentMemory,
    table: CostTable,
    pairs: list[tuple[int, int]],
) -> CostTable:
    """Return the table with the costs of some pairs (agent, target) made exact."""
    mission, leg = context.mission, context.leg
    cost, reachable, exact = (field.copy() for field in table)
    # One problem per clock: what it compiles serves all of its pairs.
    limits = mission.max_control, mission.max_speed
    clocks = {int(memory.clock[i]) for i, _ in pairs}
    problems = {clock: TransferProblem(context.remaining_model(clock), *limits) for clock in clocks}
    for i, j in sorted(pairs, key=lambda pair: memory.clock[pair[0]]):
        problem, x = problems[int(memory.clock[i])], context.state[i]
        transfer = solve_transfer(problem, x, leg.targets[j])
        tie = mission.tie_break * _tie_break(mission, leg, problem.model, x[None])[0, j]
        exact[i, j], reachable[i, j] = True, transfer is not None
        if transfer is None:
            cost[i, j] = tie
        elif mission.cost == "fuel":
            cost[i, j] = _fuel_to_distance(mission, leg) * transfer.fuel + tie
    return CostTable(cost, reachable, exact)


def compute_bid_costs(
    table: CostTable,
    memory: AgentMemory,
    graph: CommunicationGraph,
    is_firm: Bool[Array, " agents"] | None = None,
) -> Float[Array, "agents targets"]:
    """Compute the costs by which each agent bids: its costs, and three rules of its own.

    1. A target out of reach costs more than every other that is not. Rounds grow as prices
       over ε, so this penalty is only as large as the agent's range of costs; where an agent
       won a target out of reach all the same, its component bids again with a firm penalty,
       which no exchange of targets can be worth.
    2. A target claimed by an agent out of hearing is left alone while others are free, if
       that claim is newer than all claims within hearing. Otherwise an agent that loses
       sight of the holder returns, loses the next auction, and oscillates between two targets.
    3. A target that the agent holds already is a little cheaper.

    An agent knows the others in its component from learning the diameter, and the largest
    range of costs among them, and whether one won a target out of reach, from flooding.
    """
    bid = table.cost.copy()
    span = np.array([_cost_range(table, i) for i in range(len(bid))])
    for i in np.flatnonzero(graph.alive):
        is_near = graph.component == graph.component[i]
        is_reachable = table.is_reachable[i]
        penalty = max(float(span[i]), MIN_PENALTY)
        firm_penalty = 2 * is_near.sum() * max(float(span[is_near].max()), MIN_PENALTY)
        top = float(bid[i][is_reachable].max()) if is_reachable.any() else 0.0
        extra = firm_penalty if is_firm is not None and is_firm[i] else penalty
        bid[i][~is_reachable] += top + extra
        bid[i, _claimed_by_absent(memory, int(i), is_near, bid.shape[1])] += penalty
        if memory.target_index[i] >= 0:
            bid[i, memory.target_index[i]] -= HELD_TARGET_DISCOUNT * span[i]
    return bid


def _cost_range(table: CostTable, i: int) -> float:
    own = table.cost[i][table.is_reachable[i]]
    return float(np.ptp(own)) if len(own) else 0.0


def _claimed_by_absent(
    memory: AgentMemory, i: int, is_near: Array, targets: int
) -> Bool[Array, " targets"]:
    """Find targets whose newest claim, as agent i has heard, is of an agent out of hearing."""
    here, away = np.full(targets, -1), np.full(targets, -1)
    target, step = memory.claimed_target[i], memory.claim_step[i]
    known = target >= 0
    np.maximum.at(here, target[known & is_near], step[known & is_near])
    np.maximum.at(away, target[known & ~is_near], step[known & ~is_near])
    return away > here


def _fuel_to_distance(mission: Reconfiguration, leg: Leg) -> float:
    # From rest to rest a meter on one axis takes 2/τ of fuel: with this factor it costs 1.
    return leg.steps * mission.step / 2


def _primary_costs(
    mission: Reconfiguration, leg: Leg, model: DiscreteModel, state: Array
) -> tuple[Array, Array, Array]:
    if len(model) == 0:
        is_there = _is_at_target(mission, state, leg.targets)
        return np.zeros(is_there.shape), is_there, np.ones(is_there.shape, dtype=bool)
    limits = mission.max_control, mission.max_speed
    problem = TransferProblem(model, *limits, mission.fuel_norm, mission.control_norm)
    found = compute_transfer_costs(problem, state, leg.targets)
    if mission.cost == "distance":
        return compute_distances(model, state, leg.targets), found.is_reachable, found.is_exact
    return _fuel_to_distance(mission, leg) * found.fuel, found.is_reachable, found.is_exact


def _is_at_target(
    mission: Reconfiguration, state: Array, targets: Array
) -> Bool[Array, "agents targets"]:
    d, error = mission.axes, np.abs(state[:, None] - targets)
    is_near = error[..., :d].max(axis=2) <= mission.position_tolerance
    return np.asarray(is_near & (error[..., d:].max(axis=2) <= mission.velocity_tolerance))


def _tie_break(mission: Reconfiguration, leg: Leg, model: DiscreteModel, state: Array) -> Array:
    """Compute the squared distance, or in orbit the least control energy on its scale [m²]."""
    if isinstance(mission.linear_model, DoubleIntegrator):
        return compute_distances(model, state, leg.targets) ** 2
    if len(model) == 0:
        return np.zeros((len(state), len(leg.targets)))
    # From rest to rest over d a double integrator spends 12 d²/τ³.
    duration = len(model) * mission.step
    return duration**3 / 12 * compute_energies(model, state, leg.targets)
