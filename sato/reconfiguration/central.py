"""Centralized problem of a mission: the data of its first leg, for solvers of the user's own."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.doors import checked
from problems.assignment import solve_assignment
from problems.auction_cost import compute_transfer_costs
from problems.centralized import CentralizedProblem
from problems.convexify import AvoidanceHorizon
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import make_horizon
from sato.scenario.definition import Seed
from sato.scenario.errors import InputError


class CentralMission(NamedTuple):
    """Centralized problem of a mission's first leg, with the states of its agents.

    central = sato.central_problem(sato.read("crossing"))
    program = central.problem.nonlinear_program(central.start, central.goal)
    """

    problem: CentralizedProblem
    start: Float[Array, "agents n"]
    goal: Float[Array, "agents n"]  # target of each agent


@checked
def central_problem(mission: Reconfiguration, seed: Seed = 0) -> CentralMission:
    """Return the joint transfers of all agents from their starts to the targets of the first leg.

    They have the mission's objective, move by its shared linear model, keep its limits, collision
    radii and margin, and begin together: losses and joins are left out. Targets that are not
    given are assigned at the least total cost.

    Args:
        mission: Of least energy, or of fuel in the norm 1 or ∞.
        seed: Random seed, as that of `run`.

    Raises:
        ValueError: It is no reconfiguration, has fuel in the Euclidean norm, or obstacles, a box or
            passive safety, which the optimum would not keep.
    """
    asked = {"obstacles": mission.obstacles, "passive_safety": mission.passive_safety}
    asked |= {"box": mission.box is not None}
    for key in filter(asked.get, asked):
        raise InputError(key, "is no part of the joint problem; a mission without would do")
    drawn = mission.draw(np.random.default_rng(seed))
    leg, start = drawn.legs[0], drawn.initial_states[drawn.alive]
    model = drawn.discretize(leg.steps)
    agents = np.flatnonzero(drawn.alive)
    each = tuple(
        drawn.make_transfer(
            model, i, objective=drawn.objective, max_control=drawn.control_limit(i).bound
        )
        for i in agents.tolist()
    )
    whole = make_horizon(replace(drawn, foresight_steps=leg.steps), 0.0, leg.steps)
    fine = whole.fine_model[: leg.steps * whole.pieces_per_step]
    kept = None if drawn.has_equal_radii else drawn.own_clearances(whole.clearance, agents)
    problem = CentralizedProblem(
        each[0],
        AvoidanceHorizon(model, fine, whole.clearance),
        own_transfers=each if len(drawn.group_by_limits(agents)) > 1 else (),
        clearances=kept,
    )
    if drawn.assignment == "given":
        return CentralMission(problem, start, leg.targets[: len(start)])
    targets = leg.targets if leg.is_free else leg.targets[: len(start)]
    cost = np.empty((len(start), len(targets)))
    for group in drawn.group_by_limits(agents):
        cost[group] = compute_transfer_costs(each[group[0]], start[group], targets).cost
    return CentralMission(problem, start, targets[solve_assignment(cost)])
