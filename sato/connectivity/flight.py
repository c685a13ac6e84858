"""SYSTEM 3: connectivity maintenance. See → talk → reckon → keep together [Bernard2023]."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.connectivity.mission import ConnectivityFlight
from sato.connectivity.state import resting
from sato.connectivity.swarm import FORGET, advance
from sato.network import parts

SETTLE = 5.0  # for which the power iteration runs before anybody moves [s]


class Frame(NamedTuple):
    """One instant."""

    time: float  # [s]
    position: Float[Array, "agents 3"]  # [m]
    velocity: Float[Array, "agents 3"]  # in the body frame [m/s]
    alive: Bool[Array, " agents"]
    component: Int[Array, " agents"]  # of those who see each other; −1 while not alive
    command: Float[Array, "agents 4"]  # velocity in the body frame [m/s], yaw rate [rad/s]
    yaw: Float[Array, " agents"]  # [rad]
    lambda2: float  # true
    lambda3: float  # true
    lambda2_estimate: Float[Array, " agents"]  # NaN where unknown
    edge_weight: Float[Array, "agents agents"]  # true
    turned: Float[Array, "agents agents"]  # ψ̃_ij [rad]
    sees: Bool[Array, "agents agents"]  # i has j in sight
    counts: Bool[Array, "agents agents"]  # what i does still depends on j being there
    stick: Float[Array, " 3"]  # what the operator asks of the leader, in the world frame [m/s]
    robot_distance: float  # least so far [m]
    obstacle_distance: float  # least so far [m]
    events: tuple[dict[str, Any], ...]  # {"kind": …, "agents": […], …}; the record adds the time


def fly(mission: ConnectivityFlight, rng: np.random.Generator) -> Iterator[Frame]:
    """Fly for the mission's duration, and yield the swarm once every control step.

    Args:
        mission: What is flown.
        rng: Draws noise, losses, and where the power iteration begins.
    """
    return _Flight(mission, rng).frames()


class _Flight:
    def __init__(self, mission: ConnectivityFlight, rng: np.random.Generator) -> None:
        self.mission, self.rng, self.team = mission, rng, mission.team
        obstacles, late = mission.obstacles.total, mission.link.late
        self.state = resting(mission.start, mission.yaw, mission.believed, late, obstacles, rng)
        self.number = -1  # of the control step, with those before the clock starts
        self.alive = np.ones(mission.agents, dtype=bool)
        self.reached = 0
        self.graph = b""  # who hangs together by which edges
        self.component = np.zeros(mission.agents, dtype=np.int64)
        self.events: list[dict[str, Any]] = []

    def frames(self) -> Iterator[Frame]:
        mission, world = self.mission, self.state.world
        asked = np.zeros(3)
        if mission.estimator == "power_pi":
            for _ in range(round(SETTLE / mission.step)):
                self._advance(asked, moves=False)
        for step in range(round(mission.duration / mission.step) + 1):
            time = step * mission.step
            self._bury(time)
            self._advance(asked, moves=step > 0)
            if world.alive[0] and mission.stick.arrives(world.position[0], self.reached):
                said = {"agents": [0], "number": self.reached}
                self.events.append({"kind": "waypoint", **said})
                self.reached += 1
            asked = np.zeros(3)
            if world.alive[0]:
                asked = mission.stick.ask(time, world.position[0], self.reached)
            self._count_parts()
            yield self._frame(time, asked)

    def _advance(self, asked: Float[Array, " 3"], moves: bool) -> None:
        self.number += 1
        advance(self.state, self.team, asked, self.alive, self.number, moves, self.rng)

    def _bury(self, time: float) -> None:
        for death in self.mission.deaths:
            if self.alive[death.robot] and time >= death.time - 1e-9:
                self.alive[death.robot] = False
                self.events.append({"kind": "loss", "agents": [death.robot]})

    def _count_parts(self) -> None:
        # Who hangs together changes seldom, and takes long to find out.
        links, alive = self.state.world.weight > 0, self.state.world.alive
        graph = links.tobytes() + alive.tobytes()
        if graph == self.graph:
            return
        self.graph, before = graph, self.component.max()
        self.component = parts(links, alive)
        if (self.component.max() > 0) != (before > 0):
            kind = "split" if self.component.max() > 0 else "whole"
            apart = np.flatnonzero(self.component > 0).tolist()
            self.events.append({"kind": kind, "agents": apart})

    def _frame(self, time: float, asked: Float[Array, " 3"]) -> Frame:
        world, senses, _, mind = self.state
        events, self.events = tuple(self.events), []
        return Frame(
            time=time,
            position=world.position.copy(),
            velocity=senses.velocity.copy(),
            alive=world.alive.copy(),
            component=self.component,
            command=mind.command.copy(),
            yaw=world.yaw.copy(),
            lambda2=float(world.lambdas[0]),
            lambda3=float(world.lambdas[1]),
            lambda2_estimate=mind.lambda2.copy(),
            edge_weight=world.weight.copy(),
            turned=mind.turned.copy(),
            sees=senses.sees.copy(),
            counts=self._counts(),
            stick=asked,
            robot_distance=float(world.robot.min()),
            obstacle_distance=float(world.obstacle.min()),
            events=events,
        )

    def _counts(self) -> Bool[Array, "agents agents"]:
        mind, now = self.state.mind, self.number * self.mission.step
        counts = mind.weight > 0
        if self.mission.estimator == "flood":
            counts |= mind.stamp >= now - FORGET
        return counts
