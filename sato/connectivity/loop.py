"""Simulation of connectivity maintenance, one frame a control step [Bernard2023]."""

from collections import deque
from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.kinematic import KinematicVehicle, step_kinematic
from dynamics.quadrotor import Quadrotor, step_quadrotor
from dynamics.vehicle import VehicleState, rotate_by_yaw
from problems.interaction_graph import connectivity_eigenvalues
from sato.connectivity.controller import compute_commands, estimate_edges, estimate_lambda2
from sato.connectivity.messages import exchange_messages
from sato.connectivity.mission import Connectivity
from sato.connectivity.record import ConnectivityFrame
from sato.connectivity.sensors import compute_views, measure
from sato.connectivity.settings import MAX_ROW_AGE
from sato.connectivity.state import Knowledge, Message
from sato.connectivity.yaw_estimator import wrap_angle
from sato.network.graph import label_components
from sato.network.outages import PairOutages

CONNECTED = 1e-9  # a graph with a larger λ₂ is connected; less may be rounding
POWER_ITERATION_WARMUP = 5.0  # time for which the power iteration runs before agents move [s]


class Swarm:
    """State of a simulation: truth, and what each agent measures, receives and estimates."""

    def __init__(self, mission: Connectivity, rng: np.random.Generator) -> None:
        """Start at rest, before anything is measured or sent."""
        n = mission.agents
        self.mission, self.rng, self.steps_taken = mission, rng, 0
        self.vehicles = VehicleState.at_rest(mission.initial_position, mission.yaw)
        self.alive, self.command = np.ones(n, dtype=bool), np.zeros((n, 4))
        self.known = Knowledge.at_start(mission.initial_relative_yaw, rng)
        self.messages = deque[Message]()
        has_outages = mission.link.outage > 0
        self.outages = PairOutages(mission.timed_link, n, rng) if has_outages else None

    def move(self, stick: Float[Array, " 3"]) -> None:
        """Move as commanded a step ago, and by the stick, a velocity in the world frame [m/s]."""
        command, noise, plant = self.command.copy(), np.zeros_like(self.command), self.mission.plant
        if self.alive[0]:
            command[0, :3] += rotate_by_yaw(stick, -self.vehicles.yaw[0])
        if isinstance(plant, KinematicVehicle):
            noise[self.alive] = plant.draw_noise(int(self.alive.sum()), self.rng)
        self.vehicles = advance_vehicles(self.vehicles, self.alive, command, noise, self.mission)

    def lose(self, agent: int) -> None:
        """Let an agent stop; from now on it hears nothing."""
        self.alive = self.alive & (np.arange(len(self.alive)) != agent)
        self.vehicles.velocity[agent], self.vehicles.yaw_rate[agent] = 0.0, 0.0
        self.known.inbox.time[agent] = -np.inf
        self.known.inbox.relative_position[agent] = np.nan

    def decide(self) -> None:
        """Measure, exchange messages, estimate and command."""
        mission, alive, rng, number = self.mission, self.alive, self.rng, self.steps_taken
        time, before = number * mission.step, self.known.measurements
        self.views = compute_views(self.vehicles, alive, mission)
        measured = measure(self.vehicles, self.views, alive, before, mission, rng)
        known = self.known._replace(measurements=measured)
        known = exchange_messages(known, self.messages, mission, number, rng, self.outages)
        known = known._replace(estimates=estimate_edges(known, mission, time))
        self.known = known._replace(estimates=estimate_lambda2(known, alive, mission, time))
        self.command = compute_commands(self.known, mission)
        self.steps_taken += 1


def advance_vehicles(
    vehicles: VehicleState,
    alive: Bool[Array, " n"],
    command: Float[Array, "n 4"],
    noise: Float[Array, "n 4"],
    mission: Connectivity,
) -> VehicleState:
    """Advance live agents by a step; lost ones stay where they are.

    Commands are velocities in the body frame [m/s] and yaw rates [rad/s]; the noise is of kinematic
    vehicles, in the same units.
    """
    plant = mission.plant
    if isinstance(plant, Quadrotor):
        moved = step_quadrotor(vehicles, command, plant, mission.step)
    else:
        moved = step_kinematic(vehicles, command, plant, mission.step, noise)
    if alive.all():
        return moved
    both = zip(vehicles, moved, strict=True)
    return VehicleState(
        *(np.where(alive if was.ndim == 1 else alive[:, None], now, was) for was, now in both)
    )


def simulate(mission: Connectivity, rng: np.random.Generator) -> Iterator[ConnectivityFrame]:
    """Simulate a drawn mission, from a generator of all that is random in the flight."""
    swarm, stick, waypoints_reached, was_split = Swarm(mission, rng), np.zeros(3), 0, False
    if mission.estimator == "power_pi":
        for _ in range(round(POWER_ITERATION_WARMUP / mission.step)):
            swarm.decide()
    for instant in range(round(mission.duration / mission.step) + 1):
        time, events = instant * mission.step, list[dict[str, Any]]()
        if instant > 0:
            swarm.move(stick)
        for loss in mission.losses:
            if swarm.alive[loss.agent] and time >= loss.time - 1e-9:
                swarm.lose(loss.agent)
                events.append({"kind": "loss", "agents": [loss.agent]})
        swarm.decide()
        stick, leader = np.zeros(3), swarm.vehicles.position[0]
        if swarm.alive[0]:
            if mission.stick.has_arrived(leader, waypoints_reached):
                events.append({"kind": "waypoint", "agents": [0], "number": waypoints_reached})
                waypoints_reached += 1
            stick = mission.stick.command_velocity(time, leader, waypoints_reached)
        lambda2, lambda3 = connectivity_eigenvalues(swarm.views.weight, swarm.alive)
        component = np.where(swarm.alive, 0, -1)
        if not lambda2 > CONNECTED:
            component = label_components(swarm.views.weight > 0, swarm.alive)
        if (component.max() > 0) != was_split:
            kind, was_split = "whole" if was_split else "split", not was_split
            events.append({"kind": kind, "agents": np.flatnonzero(component > 0).tolist()})
        vehicles, (measured, _, estimates) = swarm.vehicles, swarm.known
        known_agents = estimates.weight > 0
        if mission.estimator == "flood":
            now = (swarm.steps_taken - 1) * mission.step
            known_agents |= estimates.adjacency.time >= now - MAX_ROW_AGE
        true_yaw = vehicles.yaw - vehicles.yaw[:, None]
        yield ConnectivityFrame(
            time=time,
            position=vehicles.position,
            velocity=rotate_by_yaw(vehicles.velocity, vehicles.yaw),
            alive=swarm.alive,
            component=component,
            velocity_command=swarm.command[:, :3],
            yaw_rate=swarm.command[:, 3],
            yaw=vehicles.yaw,
            lambda2=float(lambda2),
            lambda3=float(lambda3),
            lambda2_estimate=estimates.lambda2,
            edge_weight=swarm.views.weight,
            yaw_estimate_error=wrap_angle(estimates.relative_yaw - true_yaw),
            visibility=measured.visibility,
            stick=stick,
            known_agents=known_agents,
            events=tuple(events),
        )
