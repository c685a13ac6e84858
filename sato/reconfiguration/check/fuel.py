"""Fuel of a run, and lower bounds on it."""

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from problems.assignment import solve_assignment
from problems.limit import vector_norm
from sato.reconfiguration.check.prediction import predict_end_states
from sato.reconfiguration.check.recorded import FuelBound, LegRecord, ReconfigurationRecord

MAX_PAIRS = 600  # pairs that are solved one by one, where no method for all at once exists


def compute_step_fuel(record: ReconfigurationRecord) -> Float[Array, "steps agents"]:
    """Compute the fuel of every agent in every step [m/s]."""
    u = np.where(record.is_flying[..., None], record.frames.control[:-1], 0.0)
    return vector_norm(u, record.mission.fuel_norm) * record.mission.step


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
    mission, agents = record.mission, np.flatnonzero(leg.alive)
    targets, first = record.leg_targets(leg), leg.entry_index[agents]
    held = leg.target_index[agents]
    held[held >= len(targets)] = -1
    m = max(leg.largest_target_count, len(agents))
    # Every target that an agent holds is counted too, for that agent's own bound.
    targets = targets[: max(m, int(held.max(initial=-1)) + 1)]
    is_too_large = len(agents) * len(targets) > MAX_PAIRS
    if (
        leg.end_event is None
        or len(targets) < m
        or (first >= leg.end_index).any()
        or not np.isfinite(record.state[first, agents]).all()
        or ((mission.fuel_norm, mission.control_norm) != (1, "inf") and is_too_large)
    ):
        return None
    costs = _LegCosts(record, leg, targets)
    chosen = agents if mission.assignment == "given" else costs.assign(m)
    total = float(np.sum([costs.solve(i, j) for i, j in enumerate(chosen.tolist())]))
    if not np.isfinite(total):
        return None
    own = [costs.solve(i, j) if j >= 0 else np.nan for i, j in enumerate(held.tolist())]
    return FuelBound(total, agents, np.array(own), _correction_fuel(record, leg, held))


def compute_agent_bounds(record: ReconfigurationRecord) -> Float[Array, " agents"]:
    """Compute the least fuel of each agent to its targets; NaN unless all its legs have one."""
    alive = record.frames.alive
    total = np.zeros(alive.shape[1])
    for leg, bound in zip(record.leg_records, record.fuel_bounds, strict=True):
        fuel = np.full(len(total), np.nan)
        if bound is not None:
            fuel[bound.agents] = np.where(np.isfinite(bound.per_agent), bound.per_agent, np.nan)
        is_absent = ~alive[leg.start_index : leg.end_index].any(axis=0)
        total += np.where(is_absent, 0.0, fuel)
    return total


def _correction_fuel(
    record: ReconfigurationRecord, leg: LegRecord, held: Int[Array, " survivors"]
) -> Float[Array, " survivors"]:
    # With fuel counted as |u|₁, which is at least as much as in the other norms.
    from problems.minimum_fuel import solve_minimum_fuel

    end = predict_end_states(record, leg, record.frames.control)
    error = record.targets[leg.leg_index, held] - end
    first, fuel = leg.entry_index[leg.alive], np.full(len(held), np.inf)
    is_known = (held >= 0) & np.isfinite(error).all(axis=1)
    for k in np.unique(first[is_known]):
        rows = np.flatnonzero((first == k) & is_known)
        model = record.model[slice(k, leg.end_index)]
        limit, weight = record.mission.max_control, np.ones(len(model))
        fuel[rows] = solve_minimum_fuel(model, error[rows], limit, weight).fuel
    return fuel


class _LegCosts:
    """Fuel of all pairs of survivors and targets, lower bounds until they are solved."""

    def __init__(
        self, record: ReconfigurationRecord, leg: LegRecord, targets: Float[Array, "targets n"]
    ) -> None:
        from problems.auction_cost import compute_transfer_costs
        from problems.transfer import TransferProblem

        mission, first = record.mission, leg.entry_index[leg.alive]
        limits = mission.max_control, mission.max_speed, mission.fuel_norm, mission.control_norm
        self.first, self.start, self.targets = first, record.state[first, leg.alive], targets
        self.fuel = np.zeros((len(first), len(targets)))
        self.is_exact = np.zeros(self.fuel.shape, dtype=bool)
        self.problems = {}
        for k in np.unique(first):
            problem = TransferProblem(record.model[slice(k, leg.end_index)], *limits)
            found = compute_transfer_costs(problem, self.start[first == k], targets)
            self.fuel[first == k] = np.where(found.is_reachable, found.cost, np.inf)
            self.is_exact[first == k] = found.is_exact
            self.problems[k] = problem

    def solve(self, i: int, j: int) -> float:
        """Return the fuel of a pair [m/s]; infinite where the target is out of reach."""
        from problems.auction_cost import solve_transfer

        if not self.is_exact[i, j]:
            problem = self.problems[self.first[i]]
            transfer = solve_transfer(problem, self.start[i], self.targets[j])
            self.fuel[i, j] = np.inf if transfer is None else transfer.fuel
            self.is_exact[i, j] = True
        return float(self.fuel[i, j])

    def assign(self, m: int) -> Int[Array, " survivors"]:
        """Assign the first m targets; solve what the optimum uses, until it uses no bounds."""
        rows, fuel = np.arange(len(self.fuel)), self.fuel[:, :m]
        while True:
            is_finite = np.isfinite(fuel)
            large = 1 + np.max(fuel, initial=0.0, where=is_finite) * (len(fuel) + 1)
            chosen = solve_assignment(np.where(is_finite, fuel, large))
            inexact = np.flatnonzero(~self.is_exact[rows, chosen])
            if not len(inexact):
                return chosen
            for i in inexact:
                self.solve(int(i), int(chosen[i]))
