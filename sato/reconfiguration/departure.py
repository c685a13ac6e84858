"""Departures: vehicles that begin a leg, where, and how many of them need a target."""

from math import floor
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from dynamics.discretize import DiscreteModel
from problems.minimum_fuel import reachability_matrix
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.feasibility import fewest_agents, target_demand
from sato.reconfiguration.mission import Reconfiguration


class Departure(NamedTuple):
    """Vehicles that begin a leg."""

    mission: Reconfiguration  # their model and limits
    agents: Int[Array, " k"]
    state: Float[Array, "k n"]
    spare: int = 0  # how many of them need no target of their own
    lost: int = 0  # how many of those need not reach any target
    time: float = 0.0  # [s]
    names: tuple[str, ...] = ()  # of each; by its number if absent
    last: dict[int, DiscreteModel] | None = None  # by steps, what was discretized last, if kept

    def discretize(self, steps: int) -> DiscreteModel:
        """Discretize the shared model over some steps of the leg."""
        kept = {} if self.last is None else self.last
        if steps not in kept:
            kept.clear()
            kept[steps] = self.mission.discretize(steps, self.time)
        return kept[steps]

    def select(self, rows: Int[Array, " k"]) -> "Departure":
        """Return some of the agents."""
        return self._replace(agents=self.agents[rows], state=self.state[rows])


def depart(
    mission: Reconfiguration,
    number: int,
    known: Float[Array, "k n"],
    states: Float[Array, "agents n"],
    demand: tuple[int, ...],
    time: float,
) -> Departure:
    """Return those that begin a leg: agents at first, then any that targets may have.

    Some, not yet known, may be lost before it, or before others join.
    """
    new = sum(join.size for join in mission.legs[number].joins)
    begun, spare, lost = np.arange(len(known)), 0, 0
    if number > 0:
        spare = max(0, len(known) - demand[number - 1], len(known) + new - demand[number])
    for loss in mission.legs[0].losses if number == 0 else ():
        if loss.at_step == 0:
            begun = np.setdiff1d(begun, np.array(loss.agents, dtype=int))
            spare = lost = lost + floor((loss.share or 0.0) * (len(begun) - lost))
    agents = np.append(begun, np.arange(len(states) - new, len(states)))
    state = np.concatenate([known[begun], states[len(states) - new :]])
    excess = max(0, len(agents) - demand[number])
    return Departure(mission, agents, state, max(spare, excess), max(lost, excess), time)


def count_wanted(mission: Reconfiguration, number: int) -> int | None:
    """Return how many targets the auctions of a leg may be about; None for all."""
    is_all = mission.uses_all_targets(mission.legs[number])
    return None if is_all else target_demand(mission)[number]


def depart_leg(mission: Reconfiguration, number: int) -> Departure | None:
    """Return the agents that begin a leg of a drawn mission.

    Those of later legs are at targets of the leg before. That some have no target among them is
    known only where all decide together. None where the model is not the same at all times and
    states, or where any of unequal vehicles may be there.
    """
    new = [i for agents, at_step in mission.joining(number) if at_step == 0 for i in agents]
    fewest = fewest_agents(mission)[number]
    losses = [loss for leg in mission.legs[: number + 1] for loss in leg.losses]
    named = [i for loss in losses for i in loss.agents]
    if number == 0:
        agents = np.setdiff1d([*range(mission.agent_count), *new], named)
        lost = max(0, len(agents) - fewest)
        return Departure(mission, agents, mission.initial_states[agents], lost, lost)
    is_given = mission.assignment == "given"
    is_equal = len(mission.control_limits) == len(mission.speed_limits) == 1
    is_fixed = mission.nonlinear_model is None and mission.linear_model.is_time_invariant
    if not is_fixed or not (is_equal or is_given):
        return None
    state = mission.legs[number - 1].targets[: count_wanted(mission, number - 1)]
    held = np.setdiff1d(np.arange(len(state)), named if is_given else [])
    agents = np.append(held, new).astype(int)
    there = "agent {}" if is_given else f"the agent at target {{}} of leg {number - 1}"
    names = tuple(there.format(i) for i in held) + tuple(f"agent {i}" for i in new)
    state = np.concatenate([state[held], mission.initial_states[new]])
    spare = lost = max(0, len(agents) - fewest)
    position, present = state[:, : mission.axes], np.ones(len(state), dtype=bool)
    graph = CommunicationGraph.from_positions(position, mission.comm_radius, present)
    if mission.assignment == "auction" and (lost or graph.component.any()):
        spare = len(agents)
    begin = sum(leg.steps for leg in mission.legs[:number]) * mission.step
    return Departure(mission, agents, state, spare, lost, begin, names)


def room_at_start(departure: Departure, steps: int) -> float:
    """Return the factor of the control that makes up for a start within tolerances of a target."""
    mission, d, model = departure.mission, departure.mission.axes, departure.discretize(steps)
    error = np.repeat([mission.position_tolerance, mission.velocity_tolerance], d)
    C = reachability_matrix(model).reshape(2 * d, -1)
    Phi = np.linalg.matrix_power(model.A[0], steps)
    control = np.abs(np.linalg.pinv(C) @ Phi) @ error
    return 1 + float(control.max()) / mission.least_control
