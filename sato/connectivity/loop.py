"""Simulation of connectivity maintenance, one frame a control step [Bernard2023]."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from sato.connectivity.kernel import MAX_ROW_AGE, advance
from sato.connectivity.mission import Connectivity
from sato.connectivity.record import ConnectivityFrame, rotate_by_yaw
from sato.connectivity.state import ConnectivityState, initial_state
from sato.network.graph import label_components

POWER_ITERATION_WARMUP = 5.0  # time for which the power iteration runs before agents move [s]


def simulate(mission: Connectivity, rng: np.random.Generator) -> Iterator[ConnectivityFrame]:
    """Simulate a drawn mission.

    Args:
        mission: Drawn mission.
        rng: Draws noise, message losses, and the first iterates of the power iteration.
    """
    n, step, stick = mission.agents, mission.step, mission.stick
    state = initial_state(
        mission.initial_position,
        mission.yaw,
        mission.initial_relative_yaw,
        mission.link.delay_messages,
        mission.obstacle_arrays.total,
        rng,
    )
    truth, alive, command = state.truth, np.ones(n, dtype=bool), np.zeros(3)
    number, waypoints_reached = 0, 0
    component, graph = np.zeros(n, dtype=np.int64), b""
    if mission.estimator == "power_pi":
        for _ in range(round(POWER_ITERATION_WARMUP / step)):
            advance(state, mission.parameters, command, alive, number, False, rng)
            number += 1
    for instant in range(round(mission.duration / step) + 1):
        time, events = instant * step, list[dict[str, Any]]()
        for loss in mission.losses:
            if alive[loss.agent] and time >= loss.time - 1e-9:
                alive[loss.agent] = False
                events.append({"kind": "loss", "agents": [loss.agent]})
        advance(state, mission.parameters, command, alive, number, instant > 0, rng)
        command = np.zeros(3)
        if alive[0]:
            if stick.has_arrived(truth.position[0], waypoints_reached):
                events.append({"kind": "waypoint", "agents": [0], "number": waypoints_reached})
                waypoints_reached += 1
            command = stick.command_velocity(time, truth.position[0], waypoints_reached)
        # Edges change seldom, and components take long to find.
        edges = truth.weight > 0
        if (now := edges.tobytes() + alive.tobytes()) != graph:
            graph, was_split = now, component.max() > 0
            component = label_components(edges, truth.alive)
            if (component.max() > 0) != was_split:
                kind = "whole" if was_split else "split"
                events.append({"kind": kind, "agents": np.flatnonzero(component > 0).tolist()})
        known = _known_agents(mission, state, number * step)
        yield _make_frame(state, time, component, command, known, tuple(events))
        number += 1


def _make_frame(
    state: ConnectivityState,
    time: float,
    component: Array,
    command: Float[Array, " 3"],
    known: Bool[Array, "agents agents"],
    events: tuple[dict[str, Any], ...],
) -> ConnectivityFrame:
    truth, measurements, _, estimates = state
    error = estimates.relative_yaw - (truth.yaw - truth.yaw[:, None])
    return ConnectivityFrame(
        time=time,
        position=truth.position.copy(),
        velocity=rotate_by_yaw(measurements.velocity, truth.yaw),
        alive=truth.alive.copy(),
        component=component,
        velocity_command=estimates.command[:, :3].copy(),
        yaw_rate=estimates.command[:, 3].copy(),
        yaw=truth.yaw.copy(),
        lambda2=float(truth.eigenvalues[0]),
        lambda3=float(truth.eigenvalues[1]),
        lambda2_estimate=estimates.lambda2.copy(),
        edge_weight=truth.weight.copy(),
        yaw_estimate_error=(error + np.pi) % (2 * np.pi) - np.pi,
        visibility=measurements.visibility.copy(),
        stick=command,
        known_agents=known,
        events=events,
    )


def _known_agents(
    mission: Connectivity, state: ConnectivityState, now: float
) -> Bool[Array, "agents agents"]:
    known = state.estimates.weight > 0
    if mission.estimator == "flood":
        known |= state.estimates.row_time >= now - MAX_ROW_AGE
    return np.asarray(known)
