"""Promises of a connectivity run, each checked by recomputing it."""

from collections.abc import Iterator

import numpy as np
from numpy.random import Generator

from dynamics.vehicle import rotate_by_yaw
from problems.interaction_graph import laplacian
from sato.check import common
from sato.check.report import (
    Promise,
    Report,
    expect_below,
    expect_none,
    expect_small_error,
    largest,
)
from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.mission import Connectivity
from sato.connectivity.record import run_attributes
from sato.network.graph import canonicalize_labels, label_components
from sato.run_data import RunData

PROMISES = tuple(
    "complete attributes times numbers alive start flight obedience heading speed turn stick"
    " weights visibility eigenvalues component connectivity separation obstacles".split()
)
TOLERANCE = 1e-9  # rounding of weights, eigenvalues, cosines and speeds
MAX_CHATTERING = 0.01  # share of commands; a jumping gradient makes some tenths of them
NOISE_SIGMAS = 8  # standard deviations of noise that are allowed; 1 in 10¹⁵ is beyond


def check_run(data: RunData, mission: Connectivity, rng: Generator | None = None) -> Report:
    """Check the data of a run against a drawn mission; noise and losses by their effects."""
    record = ConnectivityRecord.from_data(data, mission)
    frames = record.frames
    states = (
        frames.position, frames.velocity, frames.yaw, frames.velocity_command, frames.yaw_rate,
        frames.edge_weight, frames.yaw_estimate_error,
    )  # fmt: skip
    is_short = len(frames.time) != round(mission.duration / mission.step) + 1
    lacking = "another number of instants than the duration gives" if is_short else ""
    promises = (
        common.check_complete(record.attributes, lacking),
        common.check_attributes(record.attributes, run_attributes(mission)),
        common.check_times(record.events, mission.step),
        common.check_finite(frames.alive, *states),
        common.check_alive(frames.alive, record.events, schedule_losses(record)),
        *check_start(record),
        *check_motion(record),
        *check_commands(record),
        check_stick(record),
        *check_views(record),
        *check_graph(record),
        *check_distances(record),
    )
    return Report(promises, record.summarize())


def schedule_losses(record: ConnectivityRecord) -> common.Schedule:
    """Return the losses of the mission, each at the first instant that is not before it."""
    mission, (instants, agents) = record.mission, record.frames.alive.shape
    time, events = mission.step * np.arange(instants), list[common.Change]()
    for loss in mission.losses:
        is_late = time >= loss.time - TOLERANCE
        events += [(int(np.argmax(is_late)), "loss", int(loss.agent))] * bool(is_late.any())
    return common.Schedule.from_events(np.ones(agents, dtype=bool), instants, events)


def check_start(record: ConnectivityRecord) -> Iterator[Promise]:
    """Check that agents start at rest as the scenario says."""
    mission, frames, start = record.mission, record.frames, record.mission.initial_position
    if frames.position.shape[1:] != start.shape:
        yield expect_none("start", 1, "another number of agents than the scenario's")
        return
    worst = largest(frames.position[0] - start, frames.yaw[0] - mission.yaw, frames.velocity[0])
    tolerance = TOLERANCE * largest(start)
    yield expect_small_error("start", worst, tolerance, "off from the scenario's start at most")


def check_motion(record: ConnectivityRecord) -> Iterator[Promise]:
    """Check that agents move as commanded, and that lost ones stay where they are."""
    frames, replay, step = record.frames, record.replay, record.mission.step
    noise = NOISE_SIGMAS * record.noise_std  # largest change of a velocity in a step
    off = np.abs(frames.position - replay.position)
    # The noise of the step in which an agent is lost is not recorded.
    off[1:][frames.alive[:-1] & ~frames.alive[1:]] -= step * noise
    off, tolerance = np.maximum(off, 0), TOLERANCE * largest(frames.position)
    yield expect_small_error("flight", off, tolerance, "m off from the commands")
    off = (frames.velocity - rotate_by_yaw(replay.velocity, frames.yaw))[frames.alive]
    yield expect_small_error("obedience", off, TOLERANCE + noise, "m/s off from the commands")
    turned, tolerance = frames.yaw - replay.yaw, TOLERANCE + step * noise
    yield expect_small_error("heading", turned, tolerance, "rad off from the commands")


def check_commands(record: ConnectivityRecord) -> Iterator[Promise]:
    """Check that commanded speeds and yaw rates are within their limits."""
    frames, limits = record.frames, record.mission.limits
    speed = np.linalg.norm(frames.velocity_command, axis=2)[frames.alive]
    yield expect_below("speed", speed, limits.speed, TOLERANCE, "m/s commanded at most")
    rate = frames.yaw_rate[frames.alive]
    yield expect_below("turn", rate, limits.yaw_rate, TOLERANCE, "rad/s commanded at most")
    mission, link = record.mission, record.mission.link
    disturbances = (
        mission.camera_noise, record.noise_std, link.loses_messages, link.late,
        mission.occlusion, mission.losses,
    )  # fmt: skip
    if (
        mission.potential.of == "spectrum"
        and not any(disturbances)
        and np.isfinite(record.chattering)
    ):
        text = "of the followers' commands jump and return in two steps"
        yield expect_below("chattering", record.chattering, MAX_CHATTERING, 0.0, text)


def check_stick(record: ConnectivityRecord) -> Promise:
    """Check the operator's commands, and that waypoints are reached where the leader is."""
    frames, stick = record.frames, record.mission.stick
    instants = [k for k, _ in record.events.of_kind("waypoint")]
    worst, reached = 0.0, 0
    for k, command in enumerate(frames.stick):
        position, expected = frames.position[k, 0], np.zeros(3)
        if frames.alive[k, 0]:
            if stick.has_arrived(position, reached):
                if reached >= len(instants) or instants[reached] != k:
                    text = f"waypoints reached without an event, at instant {k}"
                    return expect_none("stick", 1, text)
                reached += 1
            expected = stick.command_velocity(k * record.mission.step, position, reached)
        worst = largest(worst, expected - command)
    if reached < len(instants):
        return expect_none("stick", len(instants) - reached, "events of waypoints not reached")
    return expect_small_error("stick", worst, TOLERANCE, "m/s off from the operator's commands")


def check_views(record: ConnectivityRecord) -> Iterator[Promise]:
    """Check weights and visibility against poses, tilted cameras and occlusion."""
    frames, views = record.frames, record.views
    off = frames.edge_weight - views.weight
    yield expect_small_error("weights", off, TOLERANCE, "off from those of the poses")
    beyond = views.view_cosine - record.mission.assumed_camera.a_min
    odd = (frames.visibility != (beyond > 0)) & (np.abs(beyond) >= TOLERANCE)
    yield expect_none("visibility", odd, "visibilities that the poses do not give")


def check_graph(record: ConnectivityRecord) -> Iterator[Promise]:
    """Check λ₂, λ₃ and components against recorded weights, and that λ₂ stays above λ₂^min."""
    frames, limit = record.frames, record.mission.potential.lambda2_min
    weight, alive, lambda2 = frames.edge_weight, frames.alive, frames.lambda2
    # Of the live agents alone, and not by the function that the flight used.
    found = np.full((len(alive), 2), np.inf)  # infinite where there is no such eigenvalue
    swarms, number = np.unique(alive, axis=0, return_inverse=True)
    for k, live in enumerate(swarms):
        value = np.linalg.eigvalsh(laplacian(weight[number == k][:, live][:, :, live]))[:, 1:3]
        found[number == k, : value.shape[1]] = value
    with np.errstate(invalid="ignore"):
        off = found - np.column_stack([lambda2, frames.lambda3])
    off, tolerance = off[~(np.isinf(found) & np.isnan(off))], TOLERANCE * weight.shape[1]
    yield expect_small_error("eigenvalues", off, tolerance, "off from those of the weights")
    graph, component = weight > 0, frames.component
    differs = (graph[1:] != graph[:-1]).any(axis=(1, 2)) | (alive[1:] != alive[:-1]).any(axis=1)
    differs |= (component[1:] != component[:-1]).any(axis=1)
    first = np.append(0, np.flatnonzero(differs) + 1)
    labels = np.array([label_components(graph[k], alive[k]) for k in first])
    odd = labels != np.array([canonicalize_labels(component[k]) for k in first])
    odd = np.repeat(odd, np.diff(first, append=len(graph)), axis=0)
    yield expect_none("component", odd, "labels that the weights do not give")
    is_lost, least = lambda2 <= limit, float(lambda2.min())
    text = f"λ₂ is {least:.6g} at least, more than {limit:g} is asked"
    if is_lost.any():
        text += f"; from {frames.time[int(np.argmax(is_lost))]:g} s on it was not always"
    yield Promise("connectivity", not is_lost.any(), least, limit, text)


def check_distances(record: ConnectivityRecord) -> Iterator[Promise]:
    """Check that agents keep the distance at which repulsion is infinite."""
    limit = record.mission.repulsion.min_distance
    for name, found, where in (
        ("separation", record.min_separation, "between agents"),
        ("obstacles", record.min_obstacle_distance, "to obstacles"),
    ):
        text = f"{found:.6g} m {where} at least, {limit:g} m asked"
        yield Promise(name, bool(found >= limit), found, limit, text)
