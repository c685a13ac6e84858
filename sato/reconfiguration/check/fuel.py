"""The fuel that was burnt, and the least that it could have been."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.assignment import solve_assignment
from sato.reconfiguration.check.prediction import find_entry_indices, predict_end_states
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.mission import Norm

MAX_PAIRS = 600  # pairs that are solved one by one, where no method for all at once exists


class LegCosts(NamedTuple):
    """What every pair costs, and which of the prices are only lower bounds so far."""

    fuel: Float[Array, "survivors targets"]  # [m/s]; infinite where out of reach
    is_exact: Bool[Array, "survivors targets"]
    solve_pair: Callable[[int, int], float]  # the exact price of a pair


class FuelBound(NamedTuple):
    """Least fuel of a leg, from where it started, in the time that it took."""

    total: float  # of the central optimum [m/s]
    agents: Int[Array, " survivors"]
    per_agent: Float[
        Array, " survivors"
    ]  # of each agent, to the target that it held at the end [m/s]
    correction_fuel: Float[
        Array, " survivors"
    ]  # to be led there by the shared model, see `least` [m/s]


def compute_step_fuel(evidence: ReconfigurationRecord) -> Float[Array, "steps agents"]:
    """Fuel of every agent in every step [m/s]."""
    u = np.where(evidence.is_flying[..., None], evidence.control[:-1], 0.0)
    return vector_norm(u, evidence.mission.fuel_norm) * evidence.mission.step


def vector_norm(u: Float[Array, "*k d"], norm: Norm) -> Float[Array, "*k"]:
    """A vector's size in one of the three norms."""
    order = np.inf if norm == "inf" else float(norm)
    return np.asarray(np.linalg.norm(u, ord=order, axis=-1))


def compute_fuel_bound(evidence: ReconfigurationRecord, stretch: LegRecord) -> FuelBound | None:
    """Lower bound on the fuel of a leg, by the model that all agents share.

    It counts the agents that were there at the end, each from where it was at the start
    of the leg, or where it came in. A plant that is not the model may take an agent to its
    target for less. By the model, its commanded controls would have ended somewhere else,
    and as much fuel as it takes to move that end to the target, alone and without limits
    but that of the control, is what its plant can have saved it (`mend`): while limits do
    not bind, the price of a transfer grows by no more than the price of the difference.

    None where the bound cannot be had: the leg never ended, an agent could not have made
    its way, or the instance is too large for norms that have no method for all pairs at once.
    """
    if stretch.end_event is None or not stretch.step_count:
        return None
    agents = np.asarray(stretch.end_event["agents"], dtype=np.int64)
    held = np.asarray(stretch.end_event["target"], dtype=np.int64)[agents]
    told = np.asarray(stretch.end_event["believed"], dtype=np.int64)[agents]
    goals = evidence.targets[stretch.leg_index]
    goals = goals[np.isfinite(goals).all(axis=1)]
    m = max(int(told.max(initial=0)), len(agents))
    if len(goals) < m:
        return None
    held[held >= len(goals)] = -1
    # Every target that somebody holds is priced too, for that agent's own bound.
    prices = _compute_leg_costs(
        evidence, stretch, agents, goals[: max(m, int(held.max(initial=-1)) + 1)]
    )
    if prices is None:
        return None
    chosen = _solve_assignment(prices, m)
    who = np.arange(len(agents))
    for i in np.flatnonzero(held >= 0):
        _refine_cost(prices, int(i), int(held[i]))
    own = np.where(held >= 0, prices.fuel[who, held], np.nan)
    total = float(prices.fuel[who, chosen].sum())
    if not np.isfinite(total):
        return None
    return FuelBound(total, agents, own, _compute_correction_fuel(evidence, stretch, agents, held))


def compute_agent_bounds(
    evidence: ReconfigurationRecord, bounds: list[FuelBound | None]
) -> Float[Array, " agents"]:
    """Least fuel of each agent to the targets it held; NaN unless all its legs are priced."""
    total = np.zeros(evidence.alive.shape[1])
    for stretch, bound in zip(evidence.leg_records, bounds, strict=True):
        priced = np.full(len(total), np.nan)
        if bound is not None:
            priced[bound.agents] = np.where(np.isfinite(bound.per_agent), bound.per_agent, np.nan)
        absent = ~evidence.alive[stretch.start_index : stretch.end_index].any(axis=0)
        total += np.where(absent, 0.0, priced)
    return total


def _compute_correction_fuel(
    evidence: ReconfigurationRecord,
    stretch: LegRecord,
    agents: Int[Array, " survivors"],
    held: Int[Array, " survivors"],
) -> Float[Array, " survivors"]:
    # With fuel counted as |u|₁, which is at least as much as in the other norms.
    from problems.minimum_fuel import solve_minimum_fuel

    end = predict_end_states(evidence, stretch, agents, evidence.control)
    off = evidence.targets[stretch.leg_index][held] - end
    first, price = find_entry_indices(evidence, stretch, agents), np.full(len(agents), np.inf)
    known = (first < stretch.end_index) & (held >= 0) & np.isfinite(off).all(axis=1)
    for k in np.unique(first[known]):
        who = np.flatnonzero((first == k) & known)
        steps = evidence.model[slice(k, stretch.end_index)]
        limit, weight = evidence.mission.max_control, np.ones(len(steps))
        price[who] = solve_minimum_fuel(steps, off[who], limit, weight).fuel
    return price


def _solve_assignment(prices: LegCosts, m: int) -> Int[Array, " survivors"]:
    # Lower bounds are made exact where the optimum uses them, until it uses no other.
    who = np.arange(len(prices.fuel))
    while True:
        first = prices.fuel[:, :m]
        finite = np.isfinite(first)
        far = 1 + np.max(first, initial=0.0, where=finite) * (len(first) + 1)
        chosen = solve_assignment(np.where(finite, first, far))
        loose = np.flatnonzero(~prices.is_exact[who, chosen])
        if not len(loose):
            return chosen
        for i in loose:
            _refine_cost(prices, int(i), int(chosen[i]))


def _refine_cost(prices: LegCosts, i: int, j: int) -> None:
    if not prices.is_exact[i, j]:
        prices.fuel[i, j] = prices.solve_pair(i, j)
        prices.is_exact[i, j] = True


def _compute_leg_costs(
    evidence: ReconfigurationRecord,
    stretch: LegRecord,
    agents: Int[Array, " survivors"],
    goals: Float[Array, "targets n"],
) -> LegCosts | None:
    from problems.auction_cost import compute_transfer_costs, solve_transfer
    from problems.transfer import TransferProblem

    mission = evidence.mission
    limits = (mission.max_control, mission.max_speed)
    norms = (mission.fuel_norm, mission.control_norm)
    if norms != (1, "inf") and len(agents) * len(goals) > MAX_PAIRS:
        return None
    first = find_entry_indices(evidence, stretch, agents)
    start = evidence.state[first, agents]
    if (first >= stretch.end_index).any() or not np.isfinite(start).all():
        return None
    transfers = {
        int(k): TransferProblem(evidence.model[slice(k, stretch.end_index)], *limits, *norms)
        for k in np.unique(first)
    }

    def settle(i: int, j: int) -> float:
        flight = solve_transfer(transfers[int(first[i])], start[i], goals[j])
        return np.inf if flight is None else flight.fuel

    fuel = np.zeros((len(agents), len(goals)))
    exact = np.zeros(fuel.shape, dtype=bool)
    for k, transfer in transfers.items():
        who = np.flatnonzero(first == k)
        found = compute_transfer_costs(transfer, start[who], goals)
        fuel[who] = np.where(found.is_reachable, found.fuel, np.inf)
        exact[who] = found.is_exact
    return LegCosts(fuel, exact, settle)
