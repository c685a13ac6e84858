"""Rules of bidding: the bid increment, and the costs by which agents bid."""

from collections.abc import Sequence
from math import isfinite

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import min_distance
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import AgentMemory
from sato.reconfiguration.target_costs import CostTable, bids_energy, cost_range
from sato.scenario.definition import is_auto

RELATIVE_EPSILON = 0.01  # ε over the extent of the shape, where no tie-break gives a scale
HELD_TARGET_DISCOUNT = 0.02  # on the target that an agent holds, of its range of costs
MIN_PENALTY = 1.0  # least penalty on a target to be left alone [m], but in a tiny mission
MAX_INCREMENTS = 1e6  # of ε in the extent of the shape, or in the least penalty


def compute_epsilon(mission: Reconfiguration, leg: Leg) -> float:
    """Compute the bid increment ε [m] from the mission alone, the same for all agents."""
    if not is_auto(mission.epsilon):
        return mission.epsilon
    if mission.assignment == "given":
        return 1.0  # nobody bids, and an agent may know its own target alone
    position = leg.targets[:, : mission.axes]
    weight = 1.0 if bids_energy(mission) else mission.tie_break
    extent = float(np.linalg.norm(np.ptp(position, axis=0)))
    if weight == 0:
        return RELATIVE_EPSILON * (extent if extent > 0 else 1.0)
    spacing = min_distance(position)
    increment = 0.5 * weight * (spacing if isfinite(spacing) else 1.0) ** 2
    return increment if bids_energy(mission) else max(increment, extent / MAX_INCREMENTS)


def least_penalty(epsilon: float) -> float:
    """Return the least penalty on a target to be left alone [m].

    Prices rise to it by ε a round.
    """
    return min(MIN_PENALTY, MAX_INCREMENTS * epsilon)


def compute_bid_costs(
    table: CostTable,
    memory: AgentMemory,
    graph: CommunicationGraph,
    is_firm: Bool[Array, " agents"] | None = None,
    is_printed: bool = False,
    least: float = MIN_PENALTY,
) -> Float[Array, "agents targets"]:
    """Compute the costs by which each agent bids, see `apply_bidding_rules`."""
    bid = table.cost.copy()
    ranges = np.array([cost_range(table, i)[1] for i in range(len(bid))])
    for i in np.flatnonzero(graph.alive).tolist():
        is_near = graph.component == graph.component[i]
        is_own_firm = is_firm is not None and is_firm[i]
        firm = firm_penalty(ranges[is_near].tolist(), least) if is_own_firm else None
        bid[i] = apply_bidding_rules(table, memory, i, is_near, firm, is_printed, least)
    return bid


def firm_penalty(ranges: Sequence[float], least: float = MIN_PENALTY) -> float:
    """Compute a penalty that no exchange of targets is worth, from the ranges of a component."""
    return 2 * len(ranges) * max(*ranges, least)


def apply_bidding_rules(
    table: CostTable,
    memory: AgentMemory,
    i: int,
    is_near: Bool[Array, " others"],
    firm: float | None,
    is_printed: bool = False,
    least: float = MIN_PENALTY,
) -> Float[Array, " targets"]:
    """Apply three rules to the costs of one agent.

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

    Args:
        table: Costs of several agents.
        memory: Memory of the same agents.
        i: The row of the agent.
        is_near: True for the numbers of the agents in its component.
        firm: Firm penalty on targets out of reach; None where it is not called for.
        is_printed: Apply the first rule alone: the printed auction has neither of the others.
        least: Least penalty of the other two, see `least_penalty`.
    """
    bid: Array = table.cost[i].copy()
    top, span = cost_range(table, i)
    penalty = max(span, least)
    bid[~table.is_reachable[i]] += top + (penalty if firm is None else firm)
    if is_printed:
        return bid
    bid[_claimed_by_absent(memory, i, is_near, len(bid))] += penalty
    if memory.target_index[i] >= 0:
        bid[memory.target_index[i]] -= HELD_TARGET_DISCOUNT * span
    return bid


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
