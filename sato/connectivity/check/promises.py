"""Promises of a connectivity run, each checked by recomputing it."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.kinematic import KinematicVehicle
from dynamics.vehicle import rotate_by_yaw
from problems.interaction_graph import algebraic_connectivity
from sato.check import common
from sato.check.promise import (
    Promise,
    expect_below,
    expect_none,
    expect_small_error,
    max_or_zero,
)
from sato.connectivity.check.recorded import ConnectivityRecord
from sato.connectivity.mission import OMNIDIRECTIONAL
from sato.connectivity.record import run_attributes
from sato.network.graph import canonicalize_labels, label_components

TOLERANCE = 1e-9  # rounding of weights, eigenvalues, cosines and speeds
NOISE_SIGMAS = 8  # standard deviations of noise that are allowed; 1 in 10¹⁵ is beyond


def check_promises(record: ConnectivityRecord) -> tuple[Promise, ...]:
    """Check all promises."""
    mission, frames = record.mission, record.frames
    return (
        check_complete(record),
        common.check_attributes(record.attributes, run_attributes(mission)),
        common.check_times(frames.time, mission.step),
        common.check_finite(frames.alive, _states(record)),
        common.check_alive(frames.alive, record.events),
        check_losses(record),
        check_start(record),
        check_positions(record),
        check_velocities(record),
        check_yaw(record),
        check_commanded_speed(record),
        check_commanded_yaw_rate(record),
        check_stick(record),
        check_edge_weights(record),
        check_visibility(record),
        check_eigenvalues(record),
        check_components(record),
        check_connectivity(record),
        check_separation(record),
        check_obstacle_clearance(record),
    )


def check_complete(record: ConnectivityRecord) -> Promise:
    """Check that the flight lasts as long as the scenario says."""
    reason = common.incomplete_reason(record.attributes)
    steps = round(record.mission.duration / record.mission.step)
    is_short = len(record.frames.time) != steps + 1
    text = "every instant is recorded" + (f"; {reason}" if reason else "")
    return expect_none("complete", int(is_short or bool(reason)), text)


def check_losses(record: ConnectivityRecord) -> Promise:
    """Check that agents are lost when the scenario says."""
    alive, step = record.frames.alive, record.mission.step
    expected = np.ones_like(alive)
    for loss in record.mission.losses:
        expected[step * np.arange(len(alive)) >= loss.time - TOLERANCE, loss.agent] = False
    odd = int((expected != alive).sum())
    return expect_none("losses", odd, "times an agent was alive or not against the scenario")


def check_start(record: ConnectivityRecord) -> Promise:
    """Check that agents start at rest, at the poses of the scenario."""
    mission, frames = record.mission, record.frames
    start = mission.initial_position
    if frames.position.shape[1:] != start.shape:
        return expect_none("start", 1, "another number of agents than the scenario's")
    worst = max(
        max_or_zero(np.abs(frames.position[0] - start)),
        max_or_zero(np.abs(frames.yaw[0] - mission.yaw)),
        max_or_zero(np.abs(frames.velocity[0])),
    )
    tolerance = TOLERANCE * float(np.abs(start).max())
    return expect_small_error("start", worst, tolerance, "off from the scenario's start at most")


def check_positions(record: ConnectivityRecord) -> Promise:
    """Check that agents move as commanded, and that lost ones stay where they are."""
    p, replay, alive = record.frames.position, record.replay, record.frames.alive
    if replay is None:
        error = np.abs(np.diff(p, axis=0) - _expected_displacement(record))
        lost = alive[:-1] & ~alive[1:]  # the noise of this step is not recorded
        error[lost] = np.maximum(error[lost] - record.mission.step * _noise_bound(record), 0)
    else:
        error = np.abs(p - replay.position)
    tolerance = TOLERANCE * max_or_zero(np.abs(p))
    return expect_small_error("flight", max_or_zero(error), tolerance, "m off from the commands")


def check_velocities(record: ConnectivityRecord) -> Promise:
    """Check that velocities follow the commands, as far as the plant does."""
    replay, frames = record.replay, record.frames
    if replay is None:
        error = np.abs(_velocity_residual(record))
    else:
        flown = rotate_by_yaw(replay.velocity, replay.yaw)
        error = np.abs(frames.velocity - flown)[frames.alive]
    tolerance = TOLERANCE + _noise_bound(record)
    return expect_small_error(
        "obedience", max_or_zero(error), tolerance, "m/s off from the commands"
    )


def check_yaw(record: ConnectivityRecord) -> Promise:
    """Check that yaw follows the commands, and that lost agents stay as they are."""
    h, replay, frames = record.mission.step, record.replay, record.frames
    text = "rad off from the commands"
    if replay is not None:
        error = max_or_zero(np.abs(frames.yaw - replay.yaw))
        return expect_small_error("heading", error, TOLERANCE, text)
    (keep, mean), noise = _lag_factors(record), _noise_bound(record)
    rate, worst = np.zeros(frames.yaw.shape[1]), 0.0
    steps = zip(frames.yaw_rate, frames.alive, np.diff(frames.yaw, axis=0), strict=False)
    for command, alive, turned in steps:
        off = turned - np.where(alive, h * (command + (rate - command) * mean), 0)
        rate = command + (rate - command) * keep
        if noise > 0:
            rate += off / h
        worst = max(worst, max_or_zero(np.abs(off)))
    return expect_small_error("heading", worst, TOLERANCE + h * noise, text)


def check_commanded_speed(record: ConnectivityRecord) -> Promise:
    """Check that commanded speeds are within their limit."""
    speed = np.linalg.norm(record.frames.velocity_command, axis=2)[record.frames.alive]
    limit = record.mission.limits.speed
    return expect_below("speed", max_or_zero(speed), limit, TOLERANCE, "m/s commanded at most")


def check_commanded_yaw_rate(record: ConnectivityRecord) -> Promise:
    """Check that commanded yaw rates are within their limit."""
    rate, limit = record.frames.yaw_rate[record.frames.alive], record.mission.limits.yaw_rate
    largest = max_or_zero(np.abs(rate))
    return expect_below("turn", largest, limit, TOLERANCE, "rad/s commanded at most")


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
        worst = max(worst, max_or_zero(np.abs(expected - command)))
    if reached < len(instants):
        return expect_none("stick", len(instants) - reached, "events of waypoints not reached")
    return expect_small_error("stick", worst, TOLERANCE, "m/s off from the operator's commands")


def check_edge_weights(record: ConnectivityRecord) -> Promise:
    """Check weights against poses, tilted cameras and occlusion."""
    error = max_or_zero(np.abs(record.frames.edge_weight - record.views.weight))
    return expect_small_error("weights", error, TOLERANCE, "off from those of the poses")


def check_visibility(record: ConnectivityRecord) -> Promise:
    """Check which agents see which."""
    mission, cosine = record.mission, record.views.view_cosine
    least = OMNIDIRECTIONAL[0] if mission.range_only else mission.camera.a_min
    odd = (record.frames.visibility != (cosine > least)) & ~(np.abs(cosine - least) < TOLERANCE)
    return expect_none("visibility", int(odd.sum()), "visibilities that the poses do not give")


def check_eigenvalues(record: ConnectivityRecord) -> Promise:
    """Check λ₂ and λ₃ against the recorded weights of live agents."""
    frames = record.frames
    found = algebraic_connectivity(frames.edge_weight, frames.alive)
    with np.errstate(invalid="ignore"):  # infinite where there is no such eigenvalue
        off = np.abs([found.lambda2 - frames.lambda2, found.lambda3 - frames.lambda3])
    worst = max_or_zero(off[~(np.isinf([found.lambda2, found.lambda3]) & np.isnan(off))])
    tolerance = TOLERANCE * frames.edge_weight.shape[1]
    return expect_small_error("eigenvalues", worst, tolerance, "off from those of the weights")


def check_components(record: ConnectivityRecord) -> Promise:
    """Check components against the recorded weights."""
    # Edges seldom change and components take long to find, so each graph is labeled once.
    alive, agents = record.frames.alive, record.frames.alive.shape[1]
    edges = (record.frames.edge_weight > 0).reshape(len(alive), -1)
    graphs, graph = np.unique(np.hstack([edges, alive]), axis=0, return_inverse=True)
    found = [label_components(g[:-agents].reshape(agents, agents), g[-agents:]) for g in graphs]
    recorded = [canonicalize_labels(labels) for labels in record.frames.component]
    odd = int((np.array(found)[graph] != np.array(recorded)).sum())
    return expect_none("component", odd, "labels that the weights do not give")


def check_connectivity(record: ConnectivityRecord) -> Promise:
    """Check that λ₂ stays above λ₂^min."""
    lambda2, limit = record.frames.lambda2, record.mission.potential.lambda2_min
    is_lost, least = lambda2 <= limit, float(lambda2.min())
    text = f"λ₂ is {least:.6g} at least, more than {limit:g} is asked"
    if is_lost.any():
        text += f"; from {record.frames.time[int(np.argmax(is_lost))]:g} s on it was not always"
    return Promise("connectivity", not is_lost.any(), least, limit, text)


def check_separation(record: ConnectivityRecord) -> Promise:
    """Check that agents keep the distance at which repulsion is infinite."""
    return _check_distance("separation", record.min_separation, record, "between agents")


def check_obstacle_clearance(record: ConnectivityRecord) -> Promise:
    """Check that agents keep that distance from obstacles."""
    return _check_distance("obstacles", record.min_obstacle_distance, record, "to obstacles")


def _check_distance(name: str, found: float, record: ConnectivityRecord, where: str) -> Promise:
    limit = record.mission.repulsion.min_distance
    text = f"{found:.6g} m {where} at least, {limit:g} m asked"
    return Promise(name, bool(found >= limit), found, limit, text)


def _states(record: ConnectivityRecord) -> Float[Array, "instants agents k"]:
    # All that is finite for a live agent; λ₂ may be unknown.
    names = "position velocity yaw velocity_command yaw_rate edge_weight yaw_estimate_error"
    stacked = (getattr(record.frames, name) for name in names.split())
    return np.concatenate([v if v.ndim == 3 else v[..., None] for v in stacked], axis=2)


def _lag_factors(record: ConnectivityRecord) -> tuple[float, float]:
    # Share of a velocity error that is left at the end of a step, and its mean in the step.
    plant = record.mission.plant
    return plant.lag_factors(record.mission.step) if isinstance(plant, KinematicVehicle) else (0, 0)


def _noise_bound(record: ConnectivityRecord) -> float:
    # Largest change of a velocity by noise in a step.
    plant = record.mission.plant
    return NOISE_SIGMAS * plant.noise_std if isinstance(plant, KinematicVehicle) else 0.0


def _velocity_residual(record: ConnectivityRecord) -> Float[Array, "steps agents 3"]:
    # The velocity at which an agent was lost is not recorded.
    frames, command = record.frames, record.total_command[:-1, :, :3]
    body = rotate_by_yaw(frames.velocity, -frames.yaw)
    error = body[1:] - command - (body[:-1] - command) * _lag_factors(record)[0]
    error[~(frames.alive[1:] & frames.alive[:-1])] = 0
    return np.asarray(error)


def _expected_displacement(record: ConnectivityRecord) -> Float[Array, "steps agents 3"]:
    # In the world frame: the mean velocity in the step, with its noise, at the middle yaw.
    frames, command = record.frames, record.total_command[:-1, :, :3]
    body = rotate_by_yaw(frames.velocity[:-1], -frames.yaw[:-1])
    mean = command + (body - command) * _lag_factors(record)[1] + _velocity_residual(record)
    mean[~frames.alive[:-1]] = 0
    middle = (frames.yaw[1:] + frames.yaw[:-1]) / 2
    return np.asarray(record.mission.step * rotate_by_yaw(mean, middle))
