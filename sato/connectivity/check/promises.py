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
    expect_apart,
    expect_below,
    expect_none,
    expect_small_error,
    largest,
)
from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.mission import Connectivity
from sato.connectivity.obstacles import obstacle_distances
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
        common.check_finite(frames.alive, *states, time=frames.time),
        common.check_alive(frames.alive, record.events, *expect_losses(record)),
        check_start(record),
        *check_motion(record),
        *check_commands(record),
        check_stick(record),
        *check_views(record),
        *check_distances(record),
        *check_graph(record),
    )
    return Report(promises, record.summarize())


def expect_losses(record: ConnectivityRecord) -> tuple[common.Alive, list[common.Change]]:
    """Return who is there, and the losses, each at the first instant that is not before it."""
    mission, (instants, agents) = record.mission, record.frames.alive.shape
    time, events = mission.step * np.arange(instants), list[common.Change]()
    for loss in mission.losses:
        is_late = time >= loss.time - TOLERANCE
        events += [(int(np.argmax(is_late)), "loss", int(loss.agent))] * bool(is_late.any())
    return common.apply_changes(np.ones(agents, dtype=bool), instants, events), events


def check_start(record: ConnectivityRecord) -> Promise:
    """Check that agents start at rest as the scenario says."""
    mission, frames, start = record.mission, record.frames, record.mission.initial_position
    yaw = frames.yaw[0] - mission.yaw
    errors = np.column_stack([frames.position[0] - start, yaw, frames.velocity[0]])
    tolerance, text = TOLERANCE * largest(start), "off from the scenario's start at most"
    return expect_small_error("start", errors[None], tolerance, text, frames.time)


def check_motion(record: ConnectivityRecord) -> Iterator[Promise]:
    """Check that agents move as commanded, and that lost ones stay where they are."""
    frames, replay, step = record.frames, record.replay, record.mission.step
    noise = NOISE_SIGMAS * record.noise_std  # largest change of a velocity in a step
    off = np.abs(frames.position - replay.position)
    # The noise of the step in which an agent is lost is not recorded.
    off[1:][frames.alive[:-1] & ~frames.alive[1:]] -= step * noise
    off, tolerance = np.maximum(off, 0), TOLERANCE * largest(frames.position)
    time, text = frames.time, "off from the commands"
    yield expect_small_error("flight", off, tolerance, f"m {text}", time)
    off = frames.velocity - rotate_by_yaw(replay.velocity, frames.yaw)
    off[~frames.alive] = 0.0
    yield expect_small_error("obedience", off, TOLERANCE + noise, f"m/s {text}", time)
    turned, tolerance = frames.yaw - replay.yaw, TOLERANCE + step * noise
    yield expect_small_error("heading", turned, tolerance, f"rad {text}", time)


def check_commands(record: ConnectivityRecord) -> Iterator[Promise]:
    """Check that commanded speeds and yaw rates are within their limits."""
    frames, limits = record.frames, record.mission.limits
    for name, values, limit, unit in (
        ("speed", np.linalg.norm(frames.velocity_command, axis=2), limits.speed, "m/s"),
        ("turn", frames.yaw_rate, limits.yaw_rate, "rad/s"),
    ):
        size, text = np.where(frames.alive, values, 0.0), f"{unit} commanded at most"
        yield expect_below(name, size, limit, TOLERANCE, text, frames.time)
    mission, link = record.mission, record.mission.link
    disturbances = (
        mission.camera_noise, record.noise_std, link.loses_messages, link.late,
        mission.occlusion, mission.losses,
    )  # fmt: skip
    is_smooth = mission.potential.of == "spectrum" and not any(disturbances)
    if is_smooth and np.isfinite(record.chattering):
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
    yield expect_small_error("weights", off, TOLERANCE, "off from those of the poses", frames.time)
    beyond = views.view_cosine - record.mission.assumed_camera.a_min
    odd = (frames.visibility != (beyond > 0)) & (np.abs(beyond) >= TOLERANCE)
    yield expect_none("visibility", odd, "visibilities that the poses do not give", frames.time)


def check_graph(record: ConnectivityRecord) -> Iterator[Promise]:
    """Check λ₂, λ₃ and components against recorded weights, and that λ₂ stays above λ₂^min."""
    frames, limit = record.frames, record.mission.potential.lambda2_min
    alive, lambda2 = frames.alive, frames.lambda2
    weight = np.nan_to_num(frames.edge_weight, posinf=0)
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
    yield expect_none("component", odd, "labels that the weights do not give", frames.time)
    is_lost, least = lambda2 <= limit, float(lambda2.min())
    text = f"λ₂ is {least:.6g} at least, more than {limit:g} is asked"
    if is_lost.any():
        text += f"; from {frames.time[int(np.argmax(is_lost))]:g} s on it was not always"
    time = float(frames.time[int(np.argmin(lambda2))])
    yield Promise("connectivity", not is_lost.any(), least, limit, text, (), time, "safety")


def check_distances(record: ConnectivityRecord) -> Iterator[Promise]:
    """Check that agents keep the distance at which repulsion is infinite."""
    limit, time = record.mission.repulsion.min_distance, record.frames.time
    near = record.closest_pair
    yield expect_apart(near.distance, limit, near.pair, near.time(time))
    place, at = tuple[int, ...](), 0.0
    away = obstacle_distances(record.frames.position, record.mission.obstacle_arrays)
    if away.size:  # nearest at an instant, as good as on the way to the next
        moved = record.frames.alive.copy()
        moved[1:] |= moved[:-1]  # until it was lost
        away[~moved] = np.inf
        k, i, _ = map(int, np.unravel_index(int(np.argmin(away)), away.shape))
        place, at = (i,), float(time[k])
    yield expect_apart(record.min_obstacle_distance, limit, place, at, name="obstacles")
