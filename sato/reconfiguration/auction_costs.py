"""What each agent bids by: the price of every target, and three rules of its own."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics import DiscreteModel, DoubleIntegrator
from problems.auction_cost import (
    compute_distances,
    compute_energies,
    compute_transfer_costs,
    solve_transfer,
)
from problems.transfer import TransferProblem
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.mission import Leg, Reconfiguration
from sato.reconfiguration.moment import DecisionContext

HELD_TARGET_DISCOUNT = (
    0.02  # of an agent's range of costs by which the target that it holds is cheaper
)
MIN_PENALTY = 1.0  # by which a target to be left alone is dearer, at the least [m]


@dataclass(frozen=True, eq=False)
class AgentMemory:
    """What every agent remembers of this leg, a row each."""

    target_index: Int[Array, " agents"]  # held; −1 none
    target_count: Int[Array, " agents"]  # m
    bidder_count: Int[Array, " agents"]  # heard of in the last auction; 0 before the first
    clock: Int[Array, " agents"]  # steps since the start or the last reset
    claimed_target: Int[
        Array, "agents agents"
    ]  # the target that another was last known to hold; −1 none
    claim_step: Int[Array, "agents agents"]  # when that was said, in steps; −1 never

    @classmethod
    def initial(cls, believed: Int[Array, " agents"]) -> "AgentMemory":
        """At the start of a leg: nothing but m."""
        N = len(believed)
        nothing, never = np.full(N, -1), np.full((N, N), -1)
        zero = np.zeros(N, dtype=int)
        return cls(nothing, believed, zero, zero, never, never)


class CostTable(NamedTuple):
    """What every target costs every agent, before the rules."""

    cost: Float[Array, "agents targets"]  # [m]; where out of reach, the tie-break alone
    is_reachable: Bool[Array, "agents targets"]
    is_exact: Bool[Array, "agents targets"]  # else a lower bound, and perhaps out of reach


def compute_costs(
    moment: DecisionContext, minds: AgentMemory, planned: Float[Array, " agents"]
) -> CostTable:
    """Price every target for every agent that decides.

    Args:
        moment: What there is to decide with.
        minds: What the agents remember.
        planned: Fuel left in the plan to the target that each holds; infinite without one.
    """
    mission, leg = moment.mission, moment.leg
    N, M = len(moment.state), len(leg.targets)
    cost, tie = np.zeros((N, M)), np.zeros((N, M))
    reachable, exact = np.ones((N, M), dtype=bool), np.ones((N, M), dtype=bool)
    for clock in np.unique(minds.clock[moment.graph.alive]):
        those = np.flatnonzero(moment.graph.alive & (minds.clock == clock))
        steps, x = moment.remaining_model(int(clock)), moment.state[those]
        cost[those], reachable[those], exact[those] = _compute_primary_costs(mission, leg, steps, x)
        tie[those] = _compute_tie_break(mission, leg, steps, x)
    # A plan that was found stays good: where it is tight, rounding must not call it out of reach.
    for i in np.flatnonzero(np.isfinite(planned)):
        j = minds.target_index[i]
        if not reachable[i, j]:
            straight = compute_distances(
                moment.remaining_model(0), moment.state[[i]], leg.targets[[j]]
            )[0, 0]
            by_fuel = _fuel_to_distance(mission, leg) * planned[i]
            cost[i, j] = by_fuel if mission.cost == "fuel" else straight
            reachable[i, j] = exact[i, j] = True
    return CostTable(np.where(reachable, cost, 0.0) + mission.tie_break * tie, reachable, exact)


def refine_costs(
    moment: DecisionContext, minds: AgentMemory, offered: CostTable, pairs: list[tuple[int, int]]
) -> CostTable:
    """The offers with the prices of some pairs made exact."""
    mission, leg = moment.mission, moment.leg
    cost, reachable, exact = (field.copy() for field in offered)
    # One transfer a clock: what it compiles serves all of its pairs.
    limits = mission.max_control, mission.max_speed
    clocks = {int(minds.clock[i]) for i, _ in pairs}
    transfers = {clock: TransferProblem(moment.remaining_model(clock), *limits) for clock in clocks}
    for i, j in sorted(pairs, key=lambda pair: minds.clock[pair[0]]):
        transfer = transfers[int(minds.clock[i])]
        flight = solve_transfer(transfer, moment.state[i], leg.targets[j])
        tie = (
            mission.tie_break
            * _compute_tie_break(mission, leg, transfer.model, moment.state[[i]])[0, j]
        )
        exact[i, j], reachable[i, j] = True, flight is not None
        if flight is None:
            cost[i, j] = tie
        elif mission.cost == "fuel":
            cost[i, j] = _fuel_to_distance(mission, leg) * flight.fuel + tie
    return CostTable(cost, reachable, exact)


def compute_bid_costs(
    offered: CostTable,
    minds: AgentMemory,
    network: CommunicationGraph,
    firm: Bool[Array, " agents"] | None = None,
) -> Float[Array, "agents targets"]:
    """What each agent bids by: its cost, and three rules that it can keep by itself.

    A target out of reach costs more than every other that is not. Rounds grow as prices
    over ε, so this wall is only as high as its range of costs; where somebody won a
    target out of reach all the same, its network bids again behind a `firm` one, which no
    exchange of targets among them can be worth.
    A target claimed by an agent that is out of hearing is left alone while others are
    free, if that claim is newer than all that are made within hearing: otherwise who
    loses sight of the holder turns back, is told off, and forgets.
    A target that it holds already is a little cheaper.

    Whoever is in hearing an agent knows from learning the diameter; the greatest range of
    costs among them, and whether somebody won a target out of reach, from flooding.
    """
    bid = offered.cost.copy()
    span = np.array([_cost_range(offered, i) for i in range(len(bid))])
    for i in np.flatnonzero(network.alive):
        near = network.component == network.component[i]
        within = offered.is_reachable[i]
        wall = max(float(span[i]), MIN_PENALTY)
        high = 2 * near.sum() * max(float(span[near].max()), MIN_PENALTY)
        top = float(bid[i][within].max()) if within.any() else 0.0
        bid[i][~within] += top + (high if firm is not None and firm[i] else wall)
        bid[i, _claimed_by_absent(minds, int(i), near, bid.shape[1])] += wall
        if minds.target_index[i] >= 0:
            bid[i, minds.target_index[i]] -= HELD_TARGET_DISCOUNT * span[i]
    return bid


def _cost_range(offered: CostTable, i: int) -> float:
    mine = offered.cost[i][offered.is_reachable[i]]
    return float(np.ptp(mine)) if len(mine) else 0.0


def _claimed_by_absent(
    minds: AgentMemory, i: int, near: Array, targets: int
) -> Bool[Array, " targets"]:
    """Targets whose newest claim, as far as agent i has heard, is of somebody absent."""
    here, away = np.full(targets, -1), np.full(targets, -1)
    claimed, heard = minds.claimed_target[i], minds.claim_step[i]
    known = claimed >= 0
    np.maximum.at(here, claimed[known & near], heard[known & near])
    np.maximum.at(away, claimed[known & ~near], heard[known & ~near])
    return away > here


def _fuel_to_distance(mission: Reconfiguration, leg: Leg) -> float:
    # From rest to rest a metre on one axis takes 2/τ of fuel: with this it costs 1.
    return leg.steps * mission.step / 2


def _compute_primary_costs(
    mission: Reconfiguration, leg: Leg, steps: DiscreteModel, state: Array
) -> tuple[Array, Array, Array]:
    if len(steps) == 0:
        here = _is_at_target(mission, state, leg.targets)
        return np.zeros(here.shape), here, np.ones(here.shape, dtype=bool)
    limits = mission.max_control, mission.max_speed
    transfer = TransferProblem(steps, *limits, mission.fuel_norm, mission.control_norm)
    prices = compute_transfer_costs(transfer, state, leg.targets)
    if mission.cost == "distance":
        return compute_distances(steps, state, leg.targets), prices.is_reachable, prices.is_exact
    return _fuel_to_distance(mission, leg) * prices.fuel, prices.is_reachable, prices.is_exact


def _is_at_target(
    mission: Reconfiguration, state: Array, targets: Array
) -> Bool[Array, "agents targets"]:
    d = mission.linear_model.axes
    miss = np.abs(state[:, None] - targets)
    near = miss[..., :d].max(axis=2) <= mission.position_tolerance
    return np.asarray(near & (miss[..., d:].max(axis=2) <= mission.velocity_tolerance))


def _compute_tie_break(
    mission: Reconfiguration, leg: Leg, steps: DiscreteModel, state: Array
) -> Array:
    """d², or where distance means nothing the least control energy on the same scale [m²]."""
    if isinstance(mission.linear_model, DoubleIntegrator):
        return compute_distances(steps, state, leg.targets) ** 2
    if len(steps) == 0:
        return np.zeros((len(state), len(leg.targets)))
    # From rest to rest over d a double integrator spends 12 d²/τ³.
    duration = len(steps) * mission.step
    return duration**3 / 12 * compute_energies(steps, state, leg.targets)
