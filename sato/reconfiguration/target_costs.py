"""Costs of targets: fuel or energy of the way to each, and the tie-break."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretize import DiscreteModel
from problems import auction_cost
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.state import DecisionContext


class CostTable(NamedTuple):
    """Costs of all targets for all agents, before the rules of bidding."""

    cost: Float[Array, "agents targets"]  # [m]; where out of reach, the tie-break alone
    is_reachable: Bool[Array, "agents targets"]
    is_exact: Bool[Array, "agents targets"]  # else a lower bound, and perhaps out of reach


def cost_range(table: CostTable, i: int) -> tuple[float, float]:
    """Compute the largest of an agent's costs within its reach, and less the smallest."""
    cost = table.cost[i][table.is_reachable[i]]
    return (float(cost.max()), float(cost.max() - cost.min())) if len(cost) else (0.0, 0.0)


def compute_costs(context: DecisionContext) -> CostTable:
    """Compute the costs of all agents that decide."""
    shape = (len(context.state), len(context.leg.targets))
    table = CostTable(np.zeros(shape), np.ones(shape, dtype=bool), np.ones(shape, dtype=bool))
    for clock, agents in context.group_agents():
        model, x = context.remaining_model(clock), context.state[agents]
        for whole, part in zip(table, _costs_of(context, model, agents, x), strict=True):
            whole[agents] = part
    return table


def trust_plans(
    context: DecisionContext, table: CostTable, planned_cost: Float[Array, " agents"]
) -> CostTable:
    """Return the costs, with the plans to targets that are out of reach by them.

    A plan that was found stays feasible: where it is tight, rounding must not say otherwise. Its
    cost is the fuel or energy left to the target that the agent holds, infinite without a plan.
    """
    mission, leg, memory = context.mission, context.leg, context.memory
    table = CostTable(*(part.copy() for part in table))
    for i in np.flatnonzero(np.isfinite(planned_cost)):
        j = memory.target_index[i]
        if not table.is_reachable[i, j]:
            model, x = context.remaining_model(int(memory.clock[i])), context.state[[i]]
            distance = auction_cost.compute_distances(model, x, leg.targets[[j]])[0, 0]
            by_plan = _cost_scale(mission, leg, model) * planned_cost[i]
            table.cost[i, j] += by_plan if mission.cost == "fuel" else distance
            table.is_reachable[i, j] = table.is_exact[i, j] = True
    return table


def _costs_of(
    context: DecisionContext,
    model: DiscreteModel,
    agents: Int[Array, " k"],
    state: Float[Array, "k n"],
) -> CostTable:
    """Compute the costs for agents on one clock and with equal limits."""
    mission, leg = context.mission, context.leg
    d, tie = mission.axes, _tie_break(mission, leg, model, state)
    if len(model) == 0:
        error = np.abs(state[:, None] - leg.targets)
        is_there = error[..., :d].max(axis=2) <= mission.position_tolerance
        is_there &= error[..., d:].max(axis=2) <= mission.velocity_tolerance
        return CostTable(tie, is_there, np.ones_like(is_there))
    transfer = context.make_transfer(model, int(agents[0]))
    found = auction_cost.compute_transfer_costs(
        transfer, state, leg.targets, [context.solver_of(i) for i in agents.tolist()]
    )
    cost = _cost_scale(mission, leg, model) * found.cost
    if mission.cost == "distance":
        cost = auction_cost.compute_distances(model, state, leg.targets)
    cost = np.where(found.is_reachable, cost, 0.0) + tie
    return CostTable(cost, found.is_reachable, found.is_exact)


def refine_cost(context: DecisionContext, table: CostTable, i: int, j: int) -> None:
    """Make the cost of target j for agent i exact."""
    mission, leg, x = context.mission, context.leg, context.state[i]
    model = context.remaining_model(int(context.memory.clock[i]))
    problem = context.make_transfer(model, i)
    transfer = auction_cost.solve_transfer(problem, x, leg.targets[j], context.solver_of(i))
    tie = _tie_break(mission, leg, model, x[None])[0, j]
    table.is_exact[i, j], table.is_reachable[i, j] = True, transfer is not None
    if transfer is None:
        table.cost[i, j] = tie
    elif mission.cost == "fuel":
        table.cost[i, j] = _cost_scale(mission, leg, model) * problem.cost(transfer) + tie


def _cost_scale(mission: Reconfiguration, leg: Leg, model: DiscreteModel) -> float:
    # From rest to rest a meter on one axis takes 2/τ of fuel: with this factor it costs 1.
    # A double integrator spends 12 d²/τ³ of energy over d, which costs d².
    if mission.objective == "energy":
        return (len(model) * mission.step) ** 3 / 12
    return leg.steps * mission.step / 2


def _tie_break(
    mission: Reconfiguration, leg: Leg, model: DiscreteModel, state: Float[Array, "k n"]
) -> Float[Array, "k targets"]:
    """Compute w times the squared distance, or in orbit the least control energy on its scale.

    An energy, which is strictly convex, needs none [m].
    """
    if bids_energy(mission) or (len(model) == 0 and not mission.is_point_mass):
        return np.zeros((len(state), len(leg.targets)))
    if mission.is_point_mass:
        return mission.tie_break * auction_cost.compute_distances(model, state, leg.targets) ** 2
    # From rest to rest over d a double integrator spends 12 d²/τ³.
    duration = len(model) * mission.step
    energy = auction_cost.compute_energies(model, state, leg.targets)
    return mission.tie_break * (duration**3 / 12 * energy)


def bids_energy(mission: Reconfiguration) -> bool:
    """Return True where the cost of a target is an energy, which needs no tie-break."""
    return mission.objective == "energy" and mission.cost != "distance"
