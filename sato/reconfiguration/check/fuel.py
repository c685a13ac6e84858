"""Fuel and energy of a run, and lower bounds on them by the model that all agents share."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems import auction_cost
from problems.assignment import solve_assignment
from problems.limit import vector_norm
from problems.minimum_fuel import solve_minimum_fuel
from problems.transfer import Objective, TransferProblem
from sato.reconfiguration.check.prediction import predict_end_states
from sato.reconfiguration.check.recorded import (
    AssignmentCost,
    FuelBound,
    LegRecord,
    ReconfigurationRecord,
)

MAX_PAIRS = 600  # pairs that are solved one by one, where no method for all at once exists


def compute_step_fuel(record: ReconfigurationRecord) -> Float[Array, "steps agents"]:
    """Compute the fuel of every agent in every step [m/s]."""
    return vector_norm(record.flown_control, record.mission.fuel_norm) * record.mission.step


def compute_step_energy(record: ReconfigurationRecord) -> Float[Array, "steps agents"]:
    """Compute the energy of every agent in every step [m²/s³]."""
    return np.asarray((record.flown_control**2).sum(axis=2) * record.mission.step)


def compute_fuel_bound(record: ReconfigurationRecord, leg: LegRecord) -> FuelBound | None:
    """Compute a lower bound on the fuel of a leg, by the model that all agents share.

    It counts the agents that are there at the end, each from its state at the start of the leg, or
    where it joined. A plant that is not the model may take an agent to its target for less, as a
    flight far from the chief does, about which the model is linear: there it is an estimate. By the
    model, its controls would end elsewhere; the fuel that moves that end to the target, alone and
    limited by the control only, is as much as the plant can have saved (`correction_fuel`) on a
    bound with limits that allow both (`compute_fuel_shortfall`). There is no bound where the leg
    did not end, an agent could not have arrived, or the instance is too large for norms without a
    method for all pairs.
    """
    costs = _make_leg_costs(record, leg, "fuel")
    if costs is None:
        return None
    assignment, held = costs.compute_assignment(), costs.held
    if np.isnan(assignment.bound):
        return None
    own, saved = costs.solve_each(held), _correction_cost(record, leg, held, "fuel")
    return FuelBound(assignment.bound, np.flatnonzero(leg.alive), own, saved, assignment)


def compute_asked_bound(
    record: ReconfigurationRecord, leg: LegRecord, bound: FuelBound | None
) -> float:
    """Compute the same bound [m/s] over the steps that were asked for; NaN where there is none.

    Agents that join count from the step at which they were asked to, also if they waited. There is
    none where one waited beyond its leg, or could not have arrived in time. The bound that is
    given is over the time that the leg took.
    """
    mission, start, entry = record.mission, leg.start_index, leg.entry_index.copy()
    for agents, at_step in mission.joining(leg.leg_index):
        entry[agents] = np.minimum(entry[agents], start + at_step)
    joining = [i for agents, _ in mission.joining(leg.leg_index) for i in agents]
    if (np.delete(entry, joining)[np.delete(leg.alive, joining)] > start).any():
        return np.nan
    end = min(leg.end_index, start + mission.legs[leg.leg_index].steps)
    if end == leg.end_index and (entry == leg.entry_index)[leg.alive].all():
        return np.nan if bound is None else bound.total
    costs = _make_leg_costs(record, replace(leg, end_index=end, entry_index=entry), "fuel")
    return np.nan if costs is None else costs.compute_assignment().bound


def compute_energy_bound(record: ReconfigurationRecord, leg: LegRecord) -> AssignmentCost:
    """Compute the same for energy [m²/s³]; NaN where there is no bound."""
    costs = _make_leg_costs(record, leg, "energy")
    return AssignmentCost(*[np.nan] * 3) if costs is None else costs.compute_assignment()


def compute_fuel_shortfall(
    record: ReconfigurationRecord, leg: LegRecord, bound: FuelBound, used: float
) -> float:
    """Compute by how much the fuel that a leg used [m/s] is below its lower bound, relative.

    By the model, controls that were flown on a plant, and those that correct their end, reach the
    targets together. Each is within the limit in every axis, their sum within a larger one.
    """
    mission, least = record.mission, bound.total
    most = float(mission.largest_control.max()) * mission.step
    needed = used + float(bound.correction_fuel.sum())
    if least > needed and (mission.has_noise or not mission.flies_model):
        costs = _make_leg_costs(record, leg, "fuel", limit_factor=1.0 + mission.axes)
        least = np.nan if costs is None else costs.compute_assignment().bound
    # A bound that is nearly 0 is known to rounding of what could be burned at most.
    scale = max(least, 1e-3 * most * leg.step_count * len(bound.agents))
    return float(np.nan_to_num((least - needed) / scale))


def compute_energy_shortfall(
    record: ReconfigurationRecord, leg: LegRecord, bound: AssignmentCost
) -> float:
    """Compute by how much the energy of a leg is below its lower bound, relative.

    A plant that is not the model may have saved some, as with fuel: √energy is a norm of the
    controls, so that √bound ≤ √energy + √(energy that moves the model's end to the target),
    all without limits. It is at most 0 where nothing is wrong, or there is no bound.
    """
    used = compute_step_energy(record)[leg.start_index : leg.end_index, leg.alive].sum()
    least, saved = bound.bound, 0.0
    if record.mission.has_noise or not record.mission.flies_model:
        costs = _make_leg_costs(record, leg, "energy", limit_factor=np.inf)
        if costs is None:
            return 0.0
        least = costs.compute_assignment().bound
        saved = _correction_cost(record, leg, costs.held, "energy").sum()
    most = float(np.linalg.norm(record.mission.largest_control))
    most *= (record.mission.step * leg.step_count * int(leg.alive.sum())) ** 0.5
    scale = max(least**0.5, 1e-3 * most)  # a bound that is nearly 0 is known to rounding
    return float(np.nan_to_num((least**0.5 - used**0.5 - saved**0.5) / scale))


def _make_leg_costs(
    record: ReconfigurationRecord, leg: LegRecord, objective: Objective, limit_factor: float = 1.0
) -> "_LegCosts | None":
    mission, agents = record.mission, np.flatnonzero(leg.alive)
    targets, first = record.leg_targets(leg), leg.entry_index[agents]
    held = leg.target_index[agents]
    held[held >= len(targets)] = -1
    m = max(leg.largest_target_count, len(agents))
    if len(record.find_left_out(leg)):  # others may stand in for those, so all count
        m = len(targets)
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
    start, given = record.state[first, agents], agents if mission.assignment == "given" else None
    cost = np.zeros((len(agents), len(targets)))
    costs = _LegCosts(start, targets, m, held, given, cost, np.ones(cost.shape, dtype=bool), {})
    for k in np.unique(first):
        together = np.flatnonzero(first == k)
        for own in mission.group_by_limits(agents[together]):
            rows, model = together[own], record.model[slice(k, leg.end_index)]
            if np.isinf(limit_factor):
                cost[rows] = auction_cost.compute_energies(model, start[rows], targets)
                continue
            agent = int(agents[rows[0]])
            most = limit_factor * mission.control_limit(agent).bound
            problem = mission.make_transfer(model, agent, max_control=most, objective=objective)
            found = auction_cost.compute_transfer_costs(problem, start[rows], targets)
            cost[rows] = np.where(found.is_reachable, found.cost, np.inf)
            costs.is_exact[rows] = found.is_exact
            costs.problems |= dict.fromkeys(rows.tolist(), problem)
    return costs


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


def _correction_cost(
    record: ReconfigurationRecord,
    leg: LegRecord,
    held: Int[Array, " survivors"],
    objective: Objective,
) -> Float[Array, " survivors"]:
    # With fuel counted as |u|₁, which is at least as much as in the other norms.
    end = predict_end_states(record, leg, record.frames.control)
    error = record.targets[leg.leg_index, held] - end
    agents, first = np.flatnonzero(leg.alive), leg.entry_index[leg.alive]
    cost = np.full(len(held), np.inf)
    is_known = (held >= 0) & np.isfinite(error).all(axis=1)
    for k in np.unique(first[is_known]):
        rows = np.flatnonzero((first == k) & is_known)
        model = record.model[slice(k, leg.end_index)]
        if objective == "energy":
            cost[rows] = auction_cost.least_energies(model, error[rows])
            continue
        for group in record.mission.group_by_limits(agents[rows]):
            own = rows[group]
            limit = record.mission.control_limit(int(agents[own[0]])).bound
            cost[own] = solve_minimum_fuel(model, error[own], limit, np.ones(len(model))).fuel
    return cost


@dataclass(eq=False)
class _LegCosts:
    """Fuel or energy of all pairs of survivors and targets, lower bounds until solved."""

    start: Float[Array, "survivors n"]
    targets: Float[Array, "targets n"]
    target_count: int  # of the first targets, among which the optimum is
    held: Int[Array, " survivors"]
    given: Int[Array, " survivors"] | None  # where the mission assigns them
    cost: Float[Array, "survivors targets"]
    is_exact: Bool[Array, "survivors targets"]
    problems: dict[int, TransferProblem]

    def solve(self, i: int, j: int) -> float:
        """Return the cost of a pair; infinite where the target is out of reach."""
        if not self.is_exact[i, j]:
            problem = self.problems[i]
            transfer = auction_cost.solve_transfer(problem, self.start[i], self.targets[j])
            self.cost[i, j] = np.inf if transfer is None else problem.cost(transfer)
            self.is_exact[i, j] = True
        return float(self.cost[i, j])

    def solve_each(self, chosen: Int[Array, " survivors"]) -> Float[Array, " survivors"]:
        """Return the cost of each agent's target; NaN where it has none."""
        each = enumerate(chosen.tolist())
        return np.array([self.solve(i, j) if j >= 0 else np.nan for i, j in each])

    def compute_assignment(self) -> AssignmentCost:
        """Sum the costs of the targets held and of the best assignment of the first m targets."""
        totals = [float(np.sum(self.solve_each(chosen))) for chosen in (self.held, self._assign())]
        held, optimum = (total if np.isfinite(total) else np.nan for total in totals)
        given = optimum if self.given is None else float(np.sum(self.solve_each(self.given)))
        return AssignmentCost(given if np.isfinite(given) else np.nan, held, optimum)

    def _assign(self) -> Int[Array, " survivors"]:
        # Solve what the optimum uses, until it uses no bounds.
        rows, cost = np.arange(len(self.cost)), self.cost[:, : self.target_count]
        while True:
            is_finite = np.isfinite(cost)
            large = 1 + np.max(cost, initial=0.0, where=is_finite) * (len(cost) + 1)
            chosen = solve_assignment(np.where(is_finite, cost, large))
            inexact = np.flatnonzero(~self.is_exact[rows, chosen])
            if not len(inexact):
                return chosen
            for i in inexact:
                self.solve(int(i), int(chosen[i]))
