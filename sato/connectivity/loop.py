"""SYSTEM 3: connectivity maintenance. See → talk → reckon → keep together [Bernard2023]."""

from collections.abc import Iterator
from typing import Annotated, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.connectivity.kernel import MAX_ROW_AGE, advance
from sato.connectivity.mission import Connectivity
from sato.connectivity.state import initial_state
from sato.interfaces import (
    FrameAlive,
    FrameComponent,
    FrameEvents,
    FramePosition,
    FrameTime,
    Recorded,
)
from sato.network.graph import label_components

POWER_ITERATION_WARMUP = 5.0  # for which the power iteration runs before anybody moves [s]


class ConnectivityFrame(NamedTuple):
    """One instant."""

    time: FrameTime
    position: FramePosition
    velocity: Float[Array, "agents 3"]  # in the body frame [m/s]
    alive: FrameAlive
    component: FrameComponent
    command: Float[Array, "agents 4"]  # velocity in the body frame [m/s], yaw rate [rad/s]
    yaw: Annotated[Float[Array, " agents"], Recorded(("agent",), "rad", "yaw, not wrapped")]
    lambda2: Annotated[float, Recorded((), "1", "connectivity eigenvalue of the live agents, true")]
    lambda3: Annotated[
        float, Recorded((), "1", "eigenvalue after lambda2, infinite for two agents, true")
    ]
    lambda2_estimate: Annotated[
        Float[Array, " agents"], Recorded(("agent",), "1", "estimate of lambda2, NaN unknown")
    ]
    edge_weight: Annotated[
        Float[Array, "agents agents"], Recorded(("agent", "other"), "1", "weight of the edge, true")
    ]
    relative_yaw_estimate: Float[Array, "agents agents"]  # ψ̃_ij [rad]
    visibility: Annotated[
        Bool[Array, "agents agents"],
        Recorded(("agent", "other"), "1", "true where the agent has the other in sight"),
    ]
    known_agents: Bool[Array, "agents agents"]  # agent i still depends on agent j
    stick: Annotated[
        Float[Array, " 3"],
        Recorded(("axis",), "m/s", "velocity that the operator commands to agent 0, world frame"),
    ]
    min_separation: float  # least so far [m]
    min_obstacle_distance: float  # least so far [m]
    events: FrameEvents


def simulate(mission: Connectivity, rng: np.random.Generator) -> Iterator[ConnectivityFrame]:
    """Fly for the mission's duration, and yield the swarm once every control step.

    Args:
        mission: What is flown.
        rng: Draws noise, losses, and where the power iteration begins.
    """
    return _Simulation(mission, rng).frames()


class _Simulation:
    def __init__(self, mission: Connectivity, rng: np.random.Generator) -> None:
        self.mission, self.rng, self.parameters = mission, rng, mission.parameters
        obstacles, late = mission.obstacle_arrays.total, mission.link.delay_messages
        self.state = initial_state(
            mission.initial_position, mission.yaw, mission.initial_relative_yaw, late, obstacles, rng
        )
        self.step_number = -1  # of the control step, with those before the clock starts
        self.alive = np.ones(mission.agents, dtype=bool)
        self.waypoints_reached = 0
        self.graph_key = b""  # who hangs together by which edges
        self.component = np.zeros(mission.agents, dtype=np.int64)
        self.events: list[dict[str, Any]] = []

    def frames(self) -> Iterator[ConnectivityFrame]:
        mission, world = self.mission, self.state.truth
        asked = np.zeros(3)
        if mission.estimator == "power_pi":
            for _ in range(round(POWER_ITERATION_WARMUP / mission.step)):
                self._advance(asked, is_moving=False)
        for step in range(round(mission.duration / mission.step) + 1):
            time = step * mission.step
            self._remove_lost(time)
            self._advance(asked, is_moving=step > 0)
            if world.alive[0] and mission.stick.has_arrived(
                world.position[0], self.waypoints_reached
            ):
                said = {"agents": [0], "number": self.waypoints_reached}
                self.events.append({"kind": "waypoint", **said})
                self.waypoints_reached += 1
            asked = np.zeros(3)
            if world.alive[0]:
                asked = mission.stick.command_velocity(
                    time, world.position[0], self.waypoints_reached
                )
            self._update_components()
            yield self._make_frame(time, asked)

    def _advance(self, asked: Float[Array, " 3"], is_moving: bool) -> None:
        self.step_number += 1
        advance(
            self.state, self.parameters, asked, self.alive, self.step_number, is_moving, self.rng
        )

    def _remove_lost(self, time: float) -> None:
        for death in self.mission.losses:
            if self.alive[death.agent] and time >= death.time - 1e-9:
                self.alive[death.agent] = False
                self.events.append({"kind": "loss", "agents": [death.agent]})

    def _update_components(self) -> None:
        # Who hangs together changes seldom, and takes long to find out.
        links, alive = self.state.truth.weight > 0, self.state.truth.alive
        graph = links.tobytes() + alive.tobytes()
        if graph == self.graph_key:
            return
        self.graph_key, before = graph, self.component.max()
        self.component = label_components(links, alive)
        if (self.component.max() > 0) != (before > 0):
            kind = "split" if self.component.max() > 0 else "whole"
            apart = np.flatnonzero(self.component > 0).tolist()
            self.events.append({"kind": kind, "agents": apart})

    def _make_frame(self, time: float, asked: Float[Array, " 3"]) -> ConnectivityFrame:
        world, senses, _, mind = self.state
        events, self.events = tuple(self.events), []
        return ConnectivityFrame(
            time=time,
            position=world.position.copy(),
            velocity=senses.velocity.copy(),
            alive=world.alive.copy(),
            component=self.component,
            command=mind.command.copy(),
            yaw=world.yaw.copy(),
            lambda2=float(world.eigenvalues[0]),
            lambda3=float(world.eigenvalues[1]),
            lambda2_estimate=mind.lambda2.copy(),
            edge_weight=world.weight.copy(),
            relative_yaw_estimate=mind.relative_yaw.copy(),
            visibility=senses.visibility.copy(),
            known_agents=self._known_agents(),
            stick=asked,
            min_separation=float(world.min_separation.min()),
            min_obstacle_distance=float(world.min_obstacle_distance.min()),
            events=events,
        )

    def _known_agents(self) -> Bool[Array, "agents agents"]:
        mind, now = self.state.estimates, self.step_number * self.mission.step
        counts = mind.weight > 0
        if self.mission.estimator == "flood":
            counts |= mind.row_time >= now - MAX_ROW_AGE
        return counts
