"""Promises of a connectivity run, each checked by recomputing it."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from dynamics.vehicle import rotate_by_yaw
from problems.interaction_graph import algebraic_connectivity
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
from sato.connectivity.mission import OMNIDIRECTIONAL, Connectivity
from sato.connectivity.record import run_attributes
from sato.network.graph import canonicalize_labels, label_components

if TYPE_CHECKING:
    import xarray

TOLERANCE = 1e-9  # rounding of weights, eigenvalues, cosines and speeds
NOISE_SIGMAS = 8  # standard deviations of noise that are allowed; 1 in 10¹⁵ is beyond


def check_run(
    data: "xarray.Dataset", mission: Connectivity, rng: np.random.Generator | None = None
) -> Report:
    """Check the data of a run against a drawn mission.

    Args:
        data: Data of the run.
        mission: Mission that was to be flown, drawn.
        rng: Not used: noise and losses are checked by their effects.
    """
    record = ConnectivityRecord.from_dataset(data, mission)
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
        common.check_times(frames.time, mission.step),
        common.check_finite(frames.alive, *states),
        common.check_alive(frames.alive, record.events),
        check_losses(record),
        check_start(record),
        *check_motion(record),
        *check_commands(record),
        check_stick(record),
        check_edge_weights(record),
        check_visibility(record),
        check_eigenvalues(record),
        check_components(record),
        check_connectivity(record),
        *check_distances(record),
    )
    return Report(promises, record.summarize())


def check_losses(record: ConnectivityRecord) -> Promise:
    """Check that agents are lost when the scenario says."""
    alive, step = record.frames.alive, record.mission.step
    expected = np.ones_like(alive)
    for loss in record.mission.losses:
        expected[step * np.arange(len(alive)) >= loss.time - TOLERANCE, loss.agent] = False
    text = "times an agent was alive or not against the scenario"
    return expect_none("losses", expected != alive, text)


def check_start(record: ConnectivityRecord) -> Promise:
    """Check that agents start at rest, at the poses of the scenario."""
    mission, frames = record.mission, record.frames
    start = mission.initial_position
    if frames.position.shape[1:] != start.shape:
        return expect_none("start", 1, "another number of agents than the scenario's")
    worst = largest(frames.position[0] - start, frames.yaw[0] - mission.yaw, frames.velocity[0])
    tolerance = TOLERANCE * float(np.abs(start).max())
    return expect_small_error("start", worst, tolerance, "off from the scenario's start at most")


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


def check_edge_weights(record: ConnectivityRecord) -> Promise:
    """Check weights against poses, tilted cameras and occlusion."""
    error = record.frames.edge_weight - record.views.weight
    return expect_small_error("weights", error, TOLERANCE, "off from those of the poses")


def check_visibility(record: ConnectivityRecord) -> Promise:
    """Check which agents see which."""
    mission, cosine = record.mission, record.views.view_cosine
    least = OMNIDIRECTIONAL[0] if mission.range_only else mission.camera.a_min
    odd = (record.frames.visibility != (cosine > least)) & ~(np.abs(cosine - least) < TOLERANCE)
    return expect_none("visibility", odd, "visibilities that the poses do not give")


def check_eigenvalues(record: ConnectivityRecord) -> Promise:
    """Check λ₂ and λ₃ against the recorded weights of live agents."""
    frames = record.frames
    found = algebraic_connectivity(frames.edge_weight, frames.alive)
    with np.errstate(invalid="ignore"):  # infinite where there is no such eigenvalue
        off = np.abs([found.lambda2 - frames.lambda2, found.lambda3 - frames.lambda3])
    off = off[~(np.isinf([found.lambda2, found.lambda3]) & np.isnan(off))]
    tolerance = TOLERANCE * frames.edge_weight.shape[1]
    return expect_small_error("eigenvalues", off, tolerance, "off from those of the weights")


def check_components(record: ConnectivityRecord) -> Promise:
    """Check components against the recorded weights."""
    frames, odd = record.frames, 0
    for weight, alive, labels in zip(
        frames.edge_weight, frames.alive, frames.component, strict=True
    ):
        odd += int((label_components(weight > 0, alive) != canonicalize_labels(labels)).sum())
    return expect_none("component", odd, "labels that the weights do not give")


def check_connectivity(record: ConnectivityRecord) -> Promise:
    """Check that λ₂ stays above λ₂^min."""
    lambda2, limit = record.frames.lambda2, record.mission.potential.lambda2_min
    is_lost, least = lambda2 <= limit, float(lambda2.min())
    text = f"λ₂ is {least:.6g} at least, more than {limit:g} is asked"
    if is_lost.any():
        text += f"; from {record.frames.time[int(np.argmax(is_lost))]:g} s on it was not always"
    return Promise("connectivity", not is_lost.any(), least, limit, text)


def check_distances(record: ConnectivityRecord) -> Iterator[Promise]:
    """Check that agents keep the distance at which repulsion is infinite."""
    limit = record.mission.repulsion.min_distance
    for name, found, where in (
        ("separation", record.min_separation, "between agents"),
        ("obstacles", record.min_obstacle_distance, "to obstacles"),
    ):
        text = f"{found:.6g} m {where} at least, {limit:g} m asked"
        yield Promise(name, bool(found >= limit), found, limit, text)
