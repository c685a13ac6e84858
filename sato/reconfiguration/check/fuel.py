"""Fuel of a run, and lower bounds on it."""

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
    """Fuel of all pairs of survivors and targets, lower bounds until they are refined."""

    fuel: Float[Array, "survivors targets"]  # [m/s]; infinite where out of reach
    is_exact: Bool[Array, "survivors targets"]
    solve_pair: Callable[[int, int], float]


class FuelBound(NamedTuple):
    """Least fuel of a leg, from its initial states, in the time that it took."""

    total: float  # of the central optimum [m/s]
    agents: Int[Array, " survivors"]
    per_agent: Float[Array, " survivors"]  # to the target that each held at the end [m/s]
    correction_fuel: Float[Array, " survivors"]  # to correct the shared model's end state [m/s]


def compute_step_fuel(record: ReconfigurationRecord) -> Float[Array, "steps agents"]:
    """Compute the fuel of every agent in every step [m/s]."""
    u = np.where(record.is_flying[..., None], record.control[:-1], 0.0)
    return vector_norm(u, record.mission.fuel_norm) * record.mission.step


def vector_norm(u: Float[Array, "*k d"], norm: Norm) -> Float[Array, "*k"]:
    """Compute the norm of vectors: 1, 2 or "inf"."""
    order = np.inf if norm == "inf" else float(norm)
    return np.asarray(np.linalg.norm(u, ord=order, axis=-1))


def compute_fuel_bound(record: ReconfigurationRecord, leg: LegRecord) -> FuelBound | None:
    """Compute a lower bound on the fuel of a leg, by the model that all agents share.

    It counts the agents that are there at the end, each from its state at the start of the
    leg, or where it joined. A plant that is not the model may take an agent to its target for
    less. By the model, its commanded controls would have ended elsewhere; the fuel that moves
    that end to the target, alone and limited by the control only, is as much as the plant can
    have saved (`correction_fuel`): while limits do not bind, the fuel of a transfer grows by
    no more than the fuel of the difference.

    Returns:
        The bound; None where the leg did not end, an agent could not have arrived, or the
        instance is too large for norms without a method for all pairs at once.
    """
    if leg.end_event is None or not leg.step_count:
        return None
    agents = np.asarray(leg.end_event["agents"], dtype=np.int64)
    held = np.asarray(leg.end_event["target"], dtype=np.int64)[agents]
    counts = np.asarray(leg.end_event["believed"], dtype=np.int64)[agents]
    targets = record.targets[leg.leg_index]
    targets = targets[np.isfinite(targets).all(axis=1)]
    m = max(int(counts.max(initial=0)), len(agents))
    if len(targets) < m:
        return None
    held[held >= len(targets)] = -1
    # Every target that an agent holds is counted too, for that agent's own bound.
    most = max(m, int(held.max(initial=-1)) + 1)
    costs = _compute_leg_costs(record, leg, agents, targets[:most])
    if costs is None:
        return None
    chosen, rows = _solve_assignment(costs, m), np.arange(len(agents))
    for i in np.flatnonzero(held >= 0):
        _refine_cost(costs, int(i), int(held[i]))
    own = np.where(held >= 0, costs.fuel[rows, held], np.nan)
    total = float(costs.fuel[rows, chosen].sum())
    if not np.isfinite(total):
        return None
    return FuelBound(total, agents, own, _correction_fuel(record, leg, agents, held))


def compute_agent_bounds(
    record: ReconfigurationRecord, bounds: list[FuelBound | None]
) -> Float[Array, " agents"]:
    """Compute the least fuel of each agent to its targets; NaN unless all its legs have one."""
    total = np.zeros(record.alive.shape[1])
    for leg, bound in zip(record.leg_records, bounds, strict=True):
        fuel = np.full(len(total), np.nan)
        if bound is not None:
            fuel[bound.agents] = np.where(np.isfinite(bound.per_agent), bound.per_agent, np.nan)
        is_absent = ~record.alive[leg.start_index : leg.end_index].any(axis=0)
        total += np.where(is_absent, 0.0, fuel)
    return total


def _correction_fuel(
    record: ReconfigurationRecord,
    leg: LegRecord,
    agents: Int[Array, " survivors"],
    held: Int[Array, " survivors"],
) -> Float[Array, " survivors"]:
    # With fuel counted as |u|₁, which is at least as much as in the other norms.
    from problems.minimum_fuel import solve_minimum_fuel

    end = predict_end_states(record, leg, agents, record.control)
    error = record.targets[leg.leg_index][held] - end
    first, fuel = find_entry_indices(record, leg, agents), np.full(len(agents), np.inf)
    is_known = (first < leg.end_index) & (held >= 0) & np.isfinite(error).all(axis=1)
    for k in np.unique(first[is_known]):
        rows = np.flatnonzero((first == k) & is_known)
        model = record.model[slice(k, leg.end_index)]
        limit, weight = record.mission.max_control, np.ones(len(model))
        fuel[rows] = solve_minimum_fuel(model, error[rows], limit, weight).fuel
    return fuel


def _solve_assignment(costs: LegCosts, m: int) -> Int[Array, " survivors"]:
    # Lower bounds are made exact where the optimum uses them, until it uses no other.
    rows = np.arange(len(costs.fuel))
    while True:
        first = costs.fuel[:, :m]
        is_finite = np.isfinite(first)
        large = 1 + np.max(first, initial=0.0, where=is_finite) * (len(first) + 1)
        chosen = solve_assignment(np.where(is_finite, first, large))
        inexact = np.flatnonzero(~costs.is_exact[rows, chosen])
        if not len(inexact):
            return chosen
        for i in inexact:
            _refine_cost(costs, int(i), int(chosen[i]))


def _refine_cost(costs: LegCosts, i: int, j: int) -> None:
    if not costs.is_exact[i, j]:
        costs.fuel[i, j] = costs.solve_pair(i, j)
        costs.is_exact[i, j] = True


def _compute_leg_costs(
    record: ReconfigurationRecord,
    leg: LegRecord,
    agents: Int[Array, " survivors"],
    targets: Float[Array, "targets n"],
) -> LegCosts | None:
    from problems.auction_cost import compute_transfer_costs, solve_transfer
    from problems.transfer import TransferProblem

    mission = record.mission
    limits = (mission.max_control, mission.max_speed)
    norms = (mission.fuel_norm, mission.control_norm)
    if norms != (1, "inf") and len(agents) * len(targets) > MAX_PAIRS:
        return None
    first = find_entry_indices(record, leg, agents)
    start = record.state[first, agents]
    if (first >= leg.end_index).any() or not np.isfinite(start).all():
        return None
    problems = {
        int(k): TransferProblem(record.model[slice(k, leg.end_index)], *limits, *norms)
        for k in np.unique(first)
    }

    def solve_pair(i: int, j: int) -> float:
        transfer = solve_transfer(problems[int(first[i])], start[i], targets[j])
        return np.inf if transfer is None else transfer.fuel

    fuel = np.zeros((len(agents), len(targets)))
    is_exact = np.zeros(fuel.shape, dtype=bool)
    for k, problem in problems.items():
        rows = np.flatnonzero(first == k)
        found = compute_transfer_costs(problem, start[rows], targets)
        fuel[rows] = np.where(found.is_reachable, found.fuel, np.inf)
        is_exact[rows] = found.is_exact
    return LegCosts(fuel, is_exact, solve_pair)
