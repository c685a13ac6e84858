"""What a run promises, each judged by recomputing it."""

from math import exp

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.kinematic import KinematicVehicle
from problems.interaction_graph import laplacian
from sato.check import common
from sato.check.promise import (
    ROUNDING_TOLERANCE,
    Promise,
    expect_below,
    expect_none,
    expect_small_error,
    max_or_zero,
)
from sato.connectivity import record
from sato.connectivity.check.evidence import ConnectivityRecord
from sato.connectivity.mission import OMNIDIRECTIONAL
from sato.network.graph import canonicalize_labels, label_components

ROUNDING_TOLERANCE = 1e-9  # of weights, eigenvalues, cosines and speeds: what rounding leaves
NOISE_SIGMAS = 8  # standard deviations that noise may do: beyond are 1 in 10¹⁵


def check_promises(evidence: ConnectivityRecord) -> tuple[Promise, ...]:
    """Judge everything."""
    mission, lives = evidence.mission, evidence.alive
    return (
        check_complete(evidence),
        common.check_attributes(evidence.attributes, record.run_attributes(mission)),
        common.check_times(evidence.time, mission.step),
        common.check_finite(lives, _stack_states(evidence)),
        common.check_alive(lives, evidence.events),
        check_losses(evidence),
        check_start(evidence),
        check_positions(evidence),
        check_velocities(evidence),
        check_yaw(evidence),
        check_commanded_speed(evidence),
        check_commanded_yaw_rate(evidence),
        check_stick(evidence),
        check_edge_weights(evidence),
        check_visibility(evidence),
        check_eigenvalues(evidence),
        check_components(evidence),
        check_connectivity(evidence),
        check_separation(evidence),
        check_obstacle_clearance(evidence),
    )


def check_complete(evidence: ConnectivityRecord) -> Promise:
    """The flight lasts as long as the scenario says."""
    cut = common.incomplete_reason(evidence.attributes)
    steps = round(evidence.mission.duration / evidence.mission.step)
    short = len(evidence.time) != steps + 1
    text = "every instant is there"
    return expect_none("complete", int(short or bool(cut)), f"{text}; {cut}" if cut else text)


def check_losses(evidence: ConnectivityRecord) -> Promise:
    """Robots are lost when the scenario says."""
    step, expected = evidence.mission.step, np.ones_like(evidence.alive)
    for death in evidence.mission.losses:
        expected[
            step * np.arange(len(expected)) >= death.time - ROUNDING_TOLERANCE, death.agent
        ] = False
    odd = int((expected != evidence.alive).sum())
    return expect_none("losses", odd, "times a robot was there or not against the scenario")


def check_start(evidence: ConnectivityRecord) -> Promise:
    """Robots start where the scenario says, at rest."""
    mission = evidence.mission
    if evidence.position.shape[1:] != mission.initial_position.shape:
        return expect_none("start", 1, "another number of agents than the scenario's")
    worst = max(
        max_or_zero(np.abs(evidence.position[0] - mission.initial_position)),
        max_or_zero(np.abs(evidence.yaw[0] - mission.yaw)),
        max_or_zero(np.abs(evidence.velocity[0])),
    )
    tolerance = ROUNDING_TOLERANCE * float(np.abs(mission.initial_position).max())
    return expect_small_error(
        "start", worst, tolerance, "off from the scenario's own start, at most"
    )


def check_positions(evidence: ConnectivityRecord) -> Promise:
    """Robots are where what they were asked for brings them, and the lost stay where they were."""
    p, again, lives = evidence.position, evidence.replay, evidence.alive
    if again is None:
        off = np.abs(np.diff(p, axis=0) - _expected_displacement(evidence))
        lost = lives[:-1] & ~lives[1:]  # in this step: what noise did in it is not on file
        off[lost] = np.maximum(off[lost] - evidence.mission.step * _noise_bound(evidence), 0)
    else:
        off = np.abs(p - again.position)
    tolerance = ROUNDING_TOLERANCE * max_or_zero(np.abs(p))
    return expect_small_error(
        "flight", max_or_zero(off), tolerance, "m off from where commands lead"
    )


def check_velocities(evidence: ConnectivityRecord) -> Promise:
    """Velocities are what was asked for, as far as the plant obeys."""
    again, lives = evidence.replay, evidence.alive
    if again is None:
        off = np.abs(_velocity_residual(evidence))
    else:
        off = np.abs(evidence.velocity - again.velocity)[lives]
    text = "m/s off from what was asked for"
    return expect_small_error(
        "obedience", max_or_zero(off), ROUNDING_TOLERANCE + _noise_bound(evidence), text
    )


def check_yaw(evidence: ConnectivityRecord) -> Promise:
    """Robots turn as they asked, as far as the plant obeys, and the lost stay as they were."""
    h, again, text = evidence.mission.step, evidence.replay, "rad off from what was asked for"
    if again is not None:
        return expect_small_error(
            "heading", max_or_zero(np.abs(evidence.yaw - again.yaw)), ROUNDING_TOLERANCE, text
        )
    (keep, mean), shakes = _lag_factors(evidence), _noise_bound(evidence)
    rate, worst = np.zeros(evidence.yaw.shape[1]), 0.0
    for asked, lives, gone in zip(
        evidence.yaw_rate_command, evidence.alive, np.diff(evidence.yaw, axis=0), strict=False
    ):
        off = gone - np.where(lives, h * (asked + (rate - asked) * mean), 0)
        rate = asked + (rate - asked) * keep
        if shakes > 0:
            rate += off / h
        worst = max(worst, max_or_zero(np.abs(off)))
    return expect_small_error("heading", worst, ROUNDING_TOLERANCE + h * shakes, text)


def check_commanded_speed(evidence: ConnectivityRecord) -> Promise:
    """Nobody asks more of itself than it may."""
    asked = np.linalg.norm(evidence.velocity_command, axis=2)[evidence.alive]
    limit = evidence.mission.limits.speed
    return expect_below(
        "speed", max_or_zero(asked), limit, ROUNDING_TOLERANCE, "m/s asked for at most"
    )


def check_commanded_yaw_rate(evidence: ConnectivityRecord) -> Promise:
    """Nobody asks to turn faster than it may."""
    asked, limit = (
        np.abs(evidence.yaw_rate_command[evidence.alive]),
        evidence.mission.limits.yaw_rate,
    )
    return expect_below(
        "turn", max_or_zero(asked), limit, ROUNDING_TOLERANCE, "rad/s asked for at most"
    )


def check_stick(evidence: ConnectivityRecord) -> Promise:
    """The stick asks what the operator would, and waypoints are reached where the leader is."""
    told = [k for k, _ in evidence.events.of_kind("waypoint")]
    operator, worst, reached = evidence.mission.stick, 0.0, 0
    for k, asked in enumerate(evidence.stick):
        at = evidence.position[k, 0]
        if evidence.alive[k, 0] and operator.has_arrived(at, reached):
            if reached >= len(told) or told[reached] != k:
                return expect_none("stick", 1, f"waypoints reached and not told of, at instant {k}")
            reached += 1
        expected = np.zeros(3)
        if evidence.alive[k, 0]:
            expected = operator.command_velocity(k * evidence.mission.step, at, reached)
        worst = max(worst, max_or_zero(np.abs(expected - asked)))
    if reached < len(told):
        return expect_none("stick", len(told) - reached, "waypoints told of and not reached")
    return expect_small_error(
        "stick", worst, ROUNDING_TOLERANCE, "m/s off from what the operator would ask"
    )


def check_edge_weights(evidence: ConnectivityRecord) -> Promise:
    """Weights are those of the poses, of tilted cameras and of what stands between robots."""
    off = np.abs(evidence.edge_weight - evidence.views.weight)
    return expect_small_error(
        "weights", max_or_zero(off), ROUNDING_TOLERANCE, "off from that of the poses"
    )


def check_visibility(evidence: ConnectivityRecord) -> Promise:
    """Robots see whom they can see, and nobody else."""
    least = OMNIDIRECTIONAL[0] if evidence.mission.range_only else evidence.mission.camera.a_min
    facing = evidence.views.view_cosine
    odd = (evidence.visibility != (facing > least)) & ~(np.abs(facing - least) < ROUNDING_TOLERANCE)
    text = "pairs that see each other, or not, against their poses"
    return expect_none("visibility", int(odd.sum()), text)


def check_eigenvalues(evidence: ConnectivityRecord) -> Promise:
    """λ₂ and λ₃ are those of the weights on file, of those who are there."""
    worst = 0.0
    for lives in np.unique(evidence.alive, axis=0):
        k = np.flatnonzero((evidence.alive == lives).all(axis=1))
        who = np.flatnonzero(lives)
        if len(who) < 2:
            worst = np.inf if np.isfinite(evidence.lambda2[k]).any() else worst
            continue
        value = np.linalg.eigvalsh(laplacian(evidence.edge_weight[np.ix_(k, who, who)]))
        worst = max(worst, max_or_zero(np.abs(value[:, 1] - evidence.lambda2[k])))
        if len(who) > 2:
            worst = max(worst, max_or_zero(np.abs(value[:, 2] - evidence.lambda3[k])))
    return expect_small_error(
        "eigenvalues",
        worst,
        ROUNDING_TOLERANCE * evidence.edge_weight.shape[1],
        "off from the weights'",
    )


def check_components(evidence: ConnectivityRecord) -> Promise:
    """Components are those of the weights on file."""
    # Edges seldom come and go, and what hangs together takes long to find out.
    lives, agents = evidence.alive, evidence.alive.shape[1]
    links = (evidence.edge_weight > 0).reshape(len(lives), -1)
    cases, case = np.unique(np.hstack([links, lives]), axis=0, return_inverse=True)
    found = [label_components(c[:-agents].reshape(agents, agents), c[-agents:]) for c in cases]
    said = [canonicalize_labels(labels) for labels in evidence.component]
    odd = int((np.array(found)[case] != np.array(said)).sum())
    return expect_none("component", odd, "labels that the weights do not give")


def check_connectivity(evidence: ConnectivityRecord) -> Promise:
    """The swarm hangs together at all instants."""
    apart = evidence.lambda2 <= evidence.mission.potential.lambda2_min
    least, limit = float(evidence.lambda2.min()), evidence.mission.potential.lambda2_min
    text = f"λ₂ is {least:.6g} at least, more than {limit:g} is asked"
    if apart.any():
        text += f"; from {evidence.time[int(np.argmax(apart))]:g} s on it was not always"
    return Promise("connectivity", not apart.any(), least, limit, text)


def check_separation(evidence: ConnectivityRecord) -> Promise:
    """No two robots come as near as where they push without limit."""
    return _check_distance("separation", evidence.min_separation, evidence, "from robot to robot")


def check_obstacle_clearance(evidence: ConnectivityRecord) -> Promise:
    """No robot comes as near to an obstacle."""
    return _check_distance(
        "obstacles", evidence.min_obstacle_distance, evidence, "from robot to obstacle"
    )


def _check_distance(name: str, found: float, evidence: ConnectivityRecord, what: str) -> Promise:
    limit = evidence.mission.repulsion.min_distance
    text = f"{found:.6g} m {what} at least, {limit:g} m asked"
    return Promise(name, bool(found >= limit), found, limit, text)


def _stack_states(evidence: ConnectivityRecord) -> Float[Array, "instants agents k"]:
    # All that a live robot must have, side by side; of λ₂ it may know nothing.
    poses = (evidence.position, evidence.velocity, evidence.yaw[..., None])
    asked = (evidence.velocity_command, evidence.yaw_rate_command[..., None])
    return np.concatenate(
        [*poses, *asked, evidence.edge_weight, evidence.yaw_estimate_error], axis=2
    )


def _lag_factors(evidence: ConnectivityRecord) -> tuple[float, float]:
    # How much of what there was is left at the end of a step, and in the mean over it.
    plant, step = evidence.mission.plant, evidence.mission.step
    if not isinstance(plant, KinematicVehicle) or plant.time_constant <= 0:
        return 0.0, 0.0
    keep = exp(-step / plant.time_constant)
    return keep, plant.time_constant / step * (1 - keep)


def _noise_bound(evidence: ConnectivityRecord) -> float:
    # What noise may do to a velocity in a step.
    plant = evidence.mission.plant
    return NOISE_SIGMAS * plant.noise_std if isinstance(plant, KinematicVehicle) else 0.0


def _velocity_residual(evidence: ConnectivityRecord) -> Float[Array, "steps agents 3"]:
    # What velocities are off from those asked for, as the plant follows. The last velocity of
    # who is lost is not on file.
    body, asked = (
        record.rotate_by_yaw(evidence.velocity, -evidence.yaw),
        evidence.total_command[:-1],
    )
    off = body[1:] - asked - (body[:-1] - asked) * _lag_factors(evidence)[0]
    off[~(evidence.alive[1:] & evidence.alive[:-1])] = 0
    return np.asarray(off)


def _expected_displacement(evidence: ConnectivityRecord) -> Float[Array, "steps agents 3"]:
    # How far robots come in each step, in the world frame: at their mean velocity, to which
    # noise adds what it adds to the last one, and the yaw of the middle of the step.
    v, asked, lives = evidence.velocity[:-1], evidence.total_command[:-1], evidence.alive[:-1]
    body = record.rotate_by_yaw(v, -evidence.yaw[:-1])
    gone = asked + (body - asked) * _lag_factors(evidence)[1] + _velocity_residual(evidence)
    gone[~lives] = 0
    middle = (evidence.yaw[1:] + evidence.yaw[:-1]) / 2
    return np.asarray(evidence.mission.step * record.rotate_by_yaw(gone, middle))
