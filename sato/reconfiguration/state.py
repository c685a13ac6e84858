"""State of a reconfiguration: memory of the agents, context of a decision, recorded frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.discretize import DiscreteModel
from problems.convexify import AvoidanceHorizon
from problems.obstacle_paths import ObstaclePaths
from problems.solvers.verified import solve_program
from problems.transfer import Solver, TransferProblem
from sato.interfaces import (
    HELD,
    Alive,
    Component,
    Events,
    Indices,
    Position,
    Time,
    Vectors,
    Velocity,
)
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.surroundings import Surroundings

Event = dict[str, Any]  # {"kind": …, "agents": […], …}


@dataclass(frozen=True, eq=False)
class AgentMemory:
    """Memory of every agent in this leg, a row each."""

    target_index: Int[Array, " agents"]  # target that it holds; −1 none
    target_count: Int[Array, " agents"]  # m
    bidder_count: Int[Array, " agents"]  # bidders in the last auction; 0 before the first
    clock: Int[Array, " agents"]  # steps since the start or the last reset
    claimed_target: Int[Array, "agents others"]  # target that another last claimed; −1 none
    claim_step: Int[Array, "agents others"]  # step of that claim; −1 never

    @classmethod
    def initial(cls, target_count: Int[Array, " agents"]) -> "AgentMemory":
        """Return the memory at the start of a leg: nothing but m."""
        N = len(target_count)
        none, never = np.full(N, -1), np.full((N, N), -1)
        zero = np.zeros(N, dtype=int)
        return cls(none, target_count, zero, zero, never, never)

    def with_rows(self, other: "AgentMemory", rows: Bool[Array, " agents"]) -> "AgentMemory":
        """Return the same with the memory of some agents replaced."""
        parts = {}
        for name, own in vars(self).items():
            parts[name] = own.copy()
            parts[name][rows] = getattr(other, name)[rows]
        return AgentMemory(**parts)


def begin_memory(
    mission: Reconfiguration, leg: Leg, believed: Int[Array, " agents"]
) -> AgentMemory:
    """Return the memory of agents that begin a leg and believe in so many agents.

    Those that bid on all targets learn from the bids how many they are, but not from m.
    """
    all_targets = np.full_like(believed, len(leg.targets))
    return AgentMemory.initial(all_targets if mission.uses_all_targets(leg) else believed)


def update_believed(
    mission: Reconfiguration,
    believed: Int[Array, " agents"],
    memory: AgentMemory,
    flown: Leg,
    recount: bool,
) -> Int[Array, " agents"]:
    """Return in how many agents each believes after a leg, from its memory at the end.

    The next leg takes the number of bidders where it recounts.
    """
    counted = memory.bidder_count
    is_free = mission.uses_all_targets(flown)
    believed = np.maximum(believed, counted) if is_free else memory.target_count
    return np.where(counted > 0, counted, believed) if recount else believed


class DecisionContext(NamedTuple):
    """Graph, states and memory of the agents that decide, at an instant of a leg."""

    mission: Reconfiguration
    leg: Leg
    graph: CommunicationGraph  # only agents that decide are alive in it
    state: Float[Array, "agents n"]  # by which each agent plans, see `estimator`
    memory: AgentMemory
    step_index: int  # since the start of the leg
    time: float  # since the start of the mission [s]
    solvers: Sequence[Solver] = ()  # of each agent; the default where empty
    surroundings: Surroundings | None = None

    @property
    def instant(self) -> int:
        """Steps since the start of the mission."""
        return round(self.time / self.mission.step)

    def solver_of(self, agent: int) -> Solver:
        """Return the agent's own solver."""
        return self.solvers[agent] if self.solvers else solve_program

    def known_obstacles(self, agent: int, horizon: AvoidanceHorizon) -> ObstaclePaths | None:
        """Return what an agent knows of its surroundings, over a horizon that begins now."""
        around = self.surroundings
        if around is None:
            return None
        flown = around.fly(self.mission, horizon)
        return around.known_to(self.mission, agent, flown, horizon.clearance)

    def group_agents(self) -> list[tuple[int, Int[Array, "..."]]]:
        """Group the agents that decide by their clocks and limits."""
        alive, clocks = self.graph.alive, self.memory.clock
        together = [(c, np.flatnonzero(alive & (clocks == c))) for c in np.unique(clocks[alive])]
        return [
            (int(clock), agents[rows])
            for clock, agents in together
            for rows in self.mission.group_by_limits(agents)
        ]

    def remaining_model(self, clock: int) -> DiscreteModel:
        """Discretize the steps that remain on a clock."""
        return self.mission.discretize(self.leg.steps - clock, self.time)

    def make_transfer(self, model: DiscreteModel, agent: int, **more: Any) -> TransferProblem:
        """Make the transfer problem of an agent's plans over some steps."""
        mission, most = self.mission, self.mission.planned_speed_limit(agent).bound
        options = {"max_speed": most, "objective": mission.objective, **more}
        return mission.make_transfer(model, agent, **options)


class ReconfigurationFrame(NamedTuple):
    """One control instant; controls are NaN where there is none."""

    time: Time
    position: Position
    velocity: Velocity
    alive: Alive
    component: Component
    control: Annotated[Vectors, "m/s2", "commanded control, held to the next instant", HELD]
    applied_control: Annotated[Vectors, "m/s2", "control with thrust errors and disturbances", HELD]
    leg_index: Annotated[int, "1", "leg under way; at the end, the last one"]
    target_index: Annotated[Indices, "1", "index of the target that the agent holds, -1 none"]
    target_count: Annotated[Indices, "1", "number of targets that the agent bids on"]
    measured_position: Annotated[Vectors | None, "m", "position as the agent measures it"]
    measured_velocity: Annotated[Vectors | None, "m/s", "velocity as the agent measures it"]
    rounds: Annotated[
        Int[Array, " purpose"] | None, "1", "synchronous rounds of messages, in the largest network"
    ]
    received: Int[Array, "2 agent purpose"] | None  # messages and bytes since the start
    events: Events
