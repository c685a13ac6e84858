"""Loop of a formation flight: align, auction, steer, repeat [Lusk2020]."""

from collections.abc import Iterator
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

from sato.formation.assignment import AssignmentResult, assign_points
from sato.formation.control_step import FormationState, Roles, StepParameters, simulate_steps
from sato.formation.mission import Formation
from sato.formation.supervisor import FlightCourse, Phase, find_blocked
from sato.interfaces import Alive, Component, Events, Indices, Position, Time, Vectors, Velocity
from sato.network.outages import PairOutages


class FormationFrame(NamedTuple):
    """Frame of a formation flight; a command is in the agent's own frame, and before limits."""

    time: Time
    position: Position
    velocity: Velocity
    alive: Alive
    component: Component  # of the graph, which is connected: 0
    velocity_command: Annotated[Vectors, "m/s", "commanded velocity, own frame"]
    avoiding: Annotated[Bool[Array, " agent"], "1", "true while avoiding others"]
    point_index: Annotated[Indices, "1", "formation point held"]
    leg_index: Annotated[int, "1", "leg under way"]
    phase: Phase
    frame_drift: Annotated[Vectors, "m", "odometry error, own frame"]
    events: Events


def simulate(mission: Formation, rng: np.random.Generator) -> Iterator[FormationFrame]:
    """Fly through all formations, and yield a frame every `mission.frame_period`.

    Ends early where the swarm has been gridlocked for too long, or the time is over.
    """
    return _Simulation(mission, rng).frames()


class _Simulation(FlightCourse):
    def __init__(self, mission: Formation, rng: np.random.Generator) -> None:
        super().__init__(mission)
        self.rng, link = rng, mission.timed_link
        self.outages = PairOutages(link, mission.agents, rng) if link.outage else None
        self.state = FormationState.at_rest(mission.initial_positions, link.late)
        self.start_leg()

    def start_leg(self) -> None:
        points = np.arange(self.mission.agents)
        holder = np.tile(points, (len(points), 1))
        self.outcome = AssignmentResult(points, holder, rounds=0)  # of the last auction
        self.roles = Roles(points, holder, np.full(len(points), False), -1, np.zeros(3))
        self.parameters = StepParameters.for_leg(self.mission, self.leg)
        self.neighbors = self.roles.find_neighbors(self.parameters)
        self.auction_count = 0
        self.state.begin_way(points)

    def hold_auction(self) -> int:
        known = self.state, self.roles
        self.outcome = assign_points(
            self.mission, self.leg, self.auction_count, *known, self.rng, self.outages
        )
        self.auction_count += 1
        return self.outcome.rounds

    def assign(self) -> None:
        assignment, holder, rounds = self.outcome
        changed = np.flatnonzero(assignment != self.roles.assignment)
        if len(changed) or not self.roles.is_active.any():
            point = assignment.tolist()
            self.note("assignment", changed.tolist(), point=point, rounds=rounds)
        self.state.begin_way(changed)
        is_active = np.full(len(assignment), True)
        self.roles = Roles(assignment, holder, is_active, -1, np.zeros(3))
        self.neighbors = self.roles.find_neighbors(self.parameters)

    def advance(self) -> tuple[Array, Array]:
        state, roles, steps = self.state, self.roles, self.mission.steps_per_frame
        for command in self.mission.operator_commands:
            if command.start <= self.time < command.end:
                velocity = np.array(command.velocity)
                roles = roles._replace(commanded_agent=command.agent, operator_velocity=velocity)
        first = self.instant * steps
        constants = self.neighbors, self.parameters
        simulate_steps(state, roles, *constants, first, steps, self.rng, self.outages)
        return state.velocity_command, find_blocked(self.mission, state.velocity, state.avoiding)

    def frames(self) -> Iterator[FormationFrame]:
        state, n = self.state, self.mission.agents
        for events in self.instants():
            yield FormationFrame(
                time=self.time,
                position=state.position.copy(),
                velocity=state.velocity.copy(),
                alive=np.ones(n, dtype=bool),
                component=np.zeros(n, dtype=np.int64),
                velocity_command=state.velocity_command.copy(),
                avoiding=state.avoiding.copy(),
                point_index=self.roles.assignment,
                leg_index=self.leg,
                phase=self.phase,
                frame_drift=state.drift.copy(),
                events=events,
            )
