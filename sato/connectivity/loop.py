"""Simulation of connectivity maintenance, one frame a control step [Bernard2023]."""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.kinematic import step_kinematic
from dynamics.quadrotor import Quadrotor, step_quadrotor
from dynamics.vehicle import VehicleState, rotate_by_yaw
from problems.interaction_graph import algebraic_connectivity
from sato.connectivity.controller import (
    MAX_ROW_AGE,
    compute_commands,
    estimate_edges,
    estimate_lambda2,
)
from sato.connectivity.messages import exchange_messages
from sato.connectivity.mission import Connectivity
from sato.connectivity.record import ConnectivityFrame
from sato.connectivity.sensors import CameraViews, compute_views, measure
from sato.connectivity.state import (
    AgentEstimates,
    Inbox,
    Measurements,
    Message,
    empty_inbox,
    empty_measurements,
    first_estimates,
)
from sato.network.graph import label_components

POWER_ITERATION_WARMUP = 5.0  # time for which the power iteration runs before agents move [s]


@dataclass
class Swarm:
    """State of a simulation: truth, and what each agent measures, receives and estimates."""

    vehicles: VehicleState
    alive: Bool[Array, " n"]
    views: CameraViews
    measurements: Measurements
    inbox: Inbox
    estimates: AgentEstimates
    command: Float[Array, "n 4"]  # velocity in the body frame [m/s], yaw rate [rad/s]
    messages: deque[Message] = field(default_factory=deque)  # on their way
    step_number: int = 0

    @classmethod
    def at_rest(cls, mission: Connectivity, rng: np.random.Generator) -> "Swarm":
        """Build the state before anything is measured or sent."""
        vehicles, alive = vehicles_at_rest(mission), np.ones(mission.agents, dtype=bool)
        return cls(
            vehicles, alive, compute_views(vehicles, alive, mission),
            empty_measurements(mission.agents), empty_inbox(mission.agents),
            first_estimates(mission.initial_relative_yaw, rng), np.zeros((mission.agents, 4)),
        )  # fmt: skip

    def move(
        self, stick: Float[Array, " 3"], mission: Connectivity, rng: np.random.Generator
    ) -> None:
        """Move as commanded a step ago, and by the stick, a velocity in the world frame [m/s]."""
        command = self.command.copy()
        if self.alive[0]:
            command[0, :3] += rotate_by_yaw(stick, -self.vehicles.yaw[0])
        self.vehicles = advance_vehicles(self.vehicles, self.alive, command, mission, rng)

    def lose(self, agents: Bool[Array, " n"]) -> None:
        """Let agents stop; from now on they hear nothing."""
        self.alive = self.alive & ~agents
        self.vehicles.velocity[agents], self.vehicles.yaw_rate[agents] = 0.0, 0.0
        self.inbox.time[agents] = -np.inf

    def decide(self, mission: Connectivity, rng: np.random.Generator) -> None:
        """Measure, exchange messages, estimate and command."""
        time, before = self.step_number * mission.step, self.measurements
        self.views = compute_views(self.vehicles, self.alive, mission)
        self.measurements = measure(self.vehicles, self.views, self.alive, mission, rng)
        rows = exchange_messages(
            self.measurements, self.estimates, self.messages, self.inbox, mission.link,
            self.step_number, mission.step, rng,
        )  # fmt: skip
        estimates = estimate_edges(
            self.measurements, before, self.inbox, self.estimates._replace(adjacency=rows),
            mission, time,
        )  # fmt: skip
        self.estimates = estimate_lambda2(self.measurements, estimates, self.alive, mission, time)
        self.command = compute_commands(self.measurements, self.estimates, mission)
        self.step_number += 1


def vehicles_at_rest(mission: Connectivity) -> VehicleState:
    """Return the vehicles of a drawn mission at its start."""
    still, yaw = np.zeros((mission.agents, 3)), np.array(mission.yaw)
    return VehicleState(
        mission.initial_position, yaw, still, np.zeros(mission.agents), still.copy()
    )


def advance_vehicles(
    vehicles: VehicleState,
    alive: Bool[Array, " n"],
    command: Float[Array, "n 4"],
    mission: Connectivity,
    rng: np.random.Generator,
) -> VehicleState:
    """Advance live agents by a step; lost ones stay where they are.

    Args:
        vehicles: State of all agents.
        alive: True for agents that move.
        command: Commanded velocity in the body frame [m/s] and yaw rate [rad/s].
        mission: Drawn mission.
        rng: Draws the noise of kinematic vehicles.
    """
    live = VehicleState(*(part[alive] for part in vehicles))
    if isinstance(mission.plant, Quadrotor):
        moved = step_quadrotor(live, command[alive], mission.plant, mission.step)
    else:
        moved = step_kinematic(live, command[alive], mission.plant, mission.step, rng)
    advanced = VehicleState(*(part.copy() for part in vehicles))
    for part, new in zip(advanced, moved, strict=True):
        part[alive] = new
    return advanced


def simulate(mission: Connectivity, rng: np.random.Generator) -> Iterator[ConnectivityFrame]:
    """Simulate a drawn mission.

    Args:
        mission: Drawn mission.
        rng: Draws noise, message losses, and the first iterates of the power iteration.
    """
    swarm, stick = Swarm.at_rest(mission, rng), np.zeros(3)
    waypoints_reached = 0
    component, graph = np.zeros(mission.agents, dtype=np.int64), b""
    if mission.estimator == "power_pi":
        for _ in range(round(POWER_ITERATION_WARMUP / mission.step)):
            swarm.decide(mission, rng)
    for instant in range(round(mission.duration / mission.step) + 1):
        time, events = instant * mission.step, list[dict[str, Any]]()
        if instant > 0:
            swarm.move(stick, mission, rng)
        for loss in mission.losses:
            if swarm.alive[loss.agent] and time >= loss.time - 1e-9:
                swarm.lose(np.arange(mission.agents) == loss.agent)
                events.append({"kind": "loss", "agents": [loss.agent]})
        swarm.decide(mission, rng)
        stick = np.zeros(3)
        if swarm.alive[0]:
            leader = swarm.vehicles.position[0]
            if mission.stick.has_arrived(leader, waypoints_reached):
                events.append({"kind": "waypoint", "agents": [0], "number": waypoints_reached})
                waypoints_reached += 1
            stick = mission.stick.command_velocity(time, leader, waypoints_reached)
        # Edges change seldom, and components take long to find.
        edges = swarm.views.weight > 0
        if (now := edges.tobytes() + swarm.alive.tobytes()) != graph:
            graph, was_split = now, component.max() > 0
            component = label_components(edges, swarm.alive)
            if (component.max() > 0) != was_split:
                kind = "whole" if was_split else "split"
                events.append({"kind": kind, "agents": np.flatnonzero(component > 0).tolist()})
        yield _make_frame(swarm, mission, time, component, stick, tuple(events))


def _make_frame(
    swarm: Swarm,
    mission: Connectivity,
    time: float,
    component: Array,
    stick: Float[Array, " 3"],
    events: tuple[dict[str, Any], ...],
) -> ConnectivityFrame:
    vehicles, estimates = swarm.vehicles, swarm.estimates
    true = algebraic_connectivity(swarm.views.weight, swarm.alive)
    error = estimates.relative_yaw - (vehicles.yaw - vehicles.yaw[:, None])
    known = estimates.weight > 0
    if mission.estimator == "flood":
        now = (swarm.step_number - 1) * mission.step
        known = known | (estimates.adjacency.time >= now - MAX_ROW_AGE)
    return ConnectivityFrame(
        time=time,
        position=vehicles.position,
        velocity=rotate_by_yaw(vehicles.velocity, vehicles.yaw),
        alive=swarm.alive,
        component=component,
        velocity_command=swarm.command[:, :3],
        yaw_rate=swarm.command[:, 3],
        yaw=vehicles.yaw,
        lambda2=float(true.lambda2),
        lambda3=float(true.lambda3),
        lambda2_estimate=estimates.lambda2,
        edge_weight=swarm.views.weight,
        yaw_estimate_error=(error + np.pi) % (2 * np.pi) - np.pi,
        visibility=swarm.measurements.visibility,
        stick=stick,
        known_agents=known,
        events=events,
    )
