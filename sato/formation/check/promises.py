"""Promises of a formation flight, each checked by recomputing it."""

from collections.abc import Iterator

import numpy as np
from numpy import ndarray as Array
from numpy.random import Generator

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
from sato.formation.check.recorded import FormationRecord, find_faults, summarize_flight
from sato.formation.mission import Formation
from sato.formation.record import collect_attributes
from sato.run_data import RunData

RESIDUAL = 1e-10  # of gains, from rounding
NOISE_SIGMAS = 2.5  # of measured coordinates, by which two may come closer than keep_out
PROMISES = tuple(
    "complete attributes times numbers alive component start frames drift formation gains flight"
    " speed climb acceleration climb_acceleration legs assignment points separation reached".split()
)
NOISE_ALLOWANCE = 0.05  # at most so much closer [m]
ROUNDING_TOLERANCE = 1e-9  # relative, of distances, speeds and accelerations


def check_run(data: RunData, mission: Formation, rng: Generator | None = None) -> Report:
    """Check the data of a run against a drawn mission; noise and losses by their effects."""
    record = FormationRecord.from_data(data, mission)
    frames, attributes = record.frames, record.attributes
    states = frames.position, frames.velocity, frames.velocity_command, frames.frame_drift
    end = "" if record.replay.is_complete else "the flight ends where it should not"
    promises = (
        common.check_complete(attributes, end),
        common.check_attributes(attributes, collect_attributes(mission)),
        common.check_times(record.events, mission.frame_period),
        common.check_finite(frames.alive, *states, time=record.time),
        common.check_alive(frames.alive, record.events),
        check_connected(record),
        check_start(record),
        check_coordinate_frames(record),
        check_drift(record),
        check_formations(record),
        check_gains(record),
        check_positions(record),
        *check_limits(record),
        check_legs(record),
        check_assignment_events(record),
        check_assignment_is_unique(record),
        check_separation(record),
        check_arrival(record),
    )
    summary = common.common_summary(attributes, frames.alive) | summarize_flight(record)
    return Report(promises, summary)


def check_connected(record: FormationRecord) -> Promise:
    """Check that all agents take part in one network."""
    odd = ~record.frames.alive | (record.frames.component != 0)
    text = "times an agent was missing, or in another network"
    return expect_none("component", odd, text, record.time)


def check_start(record: FormationRecord) -> Promise:
    """Check that vehicles start where the scenario says, at rest."""
    start, frames = record.mission.initial_positions, record.frames
    errors = np.hstack([frames.position[0] - start, frames.velocity[0]])[None]
    tolerance, text = ROUNDING_TOLERANCE * largest(start), "off from the scenario's start, at most"
    return expect_small_error("start", errors, tolerance, text, record.time)


def check_coordinate_frames(record: FormationRecord) -> Promise:
    """Check that coordinate frames are those that the seed gives."""
    drawn, found = record.mission.coordinate_frames, record.variables
    scale = max(1.0, largest(drawn.origin))
    turned = np.exp(1j * found.frame_yaw) - drawn.rotation
    worst = largest(turned, (found.frame_offset - drawn.origin) / scale)
    text = "off from the frames that the seed gives, relative"
    return expect_small_error("frames", worst, ROUNDING_TOLERANCE, text)


def check_drift(record: FormationRecord) -> Promise:
    """Check that odometry drifts with the distance flown, as the seed gives."""
    mission, drift = record.mission, record.frames.frame_drift
    rate = mission.coordinate_frames.drift_rate
    speed = np.linalg.norm(record.frames.velocity[1:], axis=2, keepdims=True)
    error = np.diff(drift, axis=0) - speed * mission.frame_period * rate
    tolerance = ROUNDING_TOLERANCE * largest(drift)
    tolerance += largest(rate) * _position_uncertainty(record)
    text = "m off from the drift of the distance flown in a step"
    errors = np.concatenate([drift[:1], error])
    return expect_small_error("drift", errors, tolerance, text, record.time)


def check_formations(record: FormationRecord) -> Promise:
    """Check that formations and graphs are those that the scenario gives."""
    formations = [gains.formation for gains in record.mission.gains]
    points, graph = record.variables.formation, record.variables.graph
    wanted, tolerance = np.array([f.points for f in formations]), ROUNDING_TOLERANCE
    is_same = wanted.shape == points.shape
    is_same = is_same and np.allclose(points, wanted, rtol=tolerance, atol=tolerance)
    is_same = is_same and np.array_equal(graph, [f.graph for f in formations])
    return expect_none("formation", not is_same, "formations that are not the scenario's")


def check_gains(record: FormationRecord) -> Promise:
    """Check that gains are stable, leave the formation at rest, and use only its graph."""
    worst, rate = 0.0, np.inf
    for leg in range(len(record.mission.gains)):
        try:
            found = record.load_gains(leg)
        except ValueError as error:
            return Promise("gains", False, np.inf, RESIDUAL, f"leg {leg + 1}: {error}")
        parts = (found.residual_kernel, found.residual_structure, found.residual_graph)
        worst, rate = max(worst, *parts), min(rate, found.convergence_rate)
    text = f"largest residual of the gains, which converge at {rate:.3g} 1/s or more"
    return expect_small_error("gains", worst, RESIDUAL, text)


def check_positions(record: FormationRecord) -> Promise:
    """Check that positions follow from velocities."""
    p, v = record.frames.position, record.frames.velocity
    error = np.diff(p, axis=0) - v[1:] * record.mission.frame_period
    tolerance = ROUNDING_TOLERANCE * largest(p) + _position_uncertainty(record)
    text = "m off from a step by its velocity"
    return expect_small_error("flight", error, tolerance, text, record.time[1:])


def check_limits(record: FormationRecord) -> Iterator[Promise]:
    """Check the limits of speed and acceleration, in the plane and vertical."""
    mission, velocity = record.mission, record.frames.velocity
    acceleration = np.diff(velocity, axis=0) / mission.frame_period
    planar, climb = _planar(record, acceleration), mission.max_climb_acceleration
    for name, values, limit, text in (
        ("speed", _planar(record, velocity), mission.max_speed, "m/s in the plane"),
        ("climb", velocity[..., 2], mission.max_climb, "m/s up or down"),
        ("acceleration", planar, mission.max_acceleration, "m/s² in the plane"),
        ("climb_acceleration", acceleration[..., 2], climb, "m/s² up or down"),
    ):
        time = record.time[-len(values) :]
        yield expect_below(name, values, limit, ROUNDING_TOLERANCE, text, time)


def check_legs(record: FormationRecord) -> Promise:
    """Check legs, auctions and gridlocks against the recorded commands and avoidance."""
    kinds = ("leg_start", "leg_end", "given_up", "gridlock", "gridlock_end", "auction")
    found = [(k, e["kind"], int(e["leg"])) for k, e in record.events.of_kind(*kinds)]
    odd = common.count_differences(found, record.replay.events)
    odd += int((record.leg_index != record.replay.leg).sum())
    return expect_none("legs", odd, "entries of legs and their events that commands do not give")


def check_assignment_events(record: FormationRecord) -> Promise:
    """Check that assignments change with an event, and only so.

    At the start of a leg every agent holds the point of its own number.
    """
    held = record.frames.point_index
    agents = held.shape[1]
    expected = np.tile(np.arange(agents), (len(held), 1))
    odd = 0  # events
    for k, event in record.events.of_kind("leg_start", "assignment"):
        is_start = event["kind"] == "leg_start"
        now = np.arange(agents) if is_start else np.asarray(event["point"], dtype=np.int64)
        changed = np.flatnonzero(expected[k] != now)
        odd += not is_start and changed.tolist() != event["agents"]
        expected[k:] = now
    wrong, text = expected != held, "points held against the events"
    return expect_none("assignment", *((wrong, text, record.time) if wrong.any() else (odd, text)))


def check_assignment_is_unique(record: FormationRecord) -> Promise:
    """Check that no two vehicles hold one point.

    With lost messages this is checked at the end of legs alone: an agent that has not learned
    the outcome of an auction keeps its point until the next.
    """
    held = record.frames.point_index
    if record.mission.timed_link.loses_messages:
        held = held[[leg.end_instant for leg in record.replay.legs if leg.completed]]
    odd = (np.sort(held, axis=1) != np.arange(held.shape[1])).any(axis=1)
    return expect_none("points", odd, "instants at which two hold one point")


def check_separation(record: FormationRecord) -> Promise:
    """Check that no two vehicles come closer in the plane than keep_out, but for noise."""
    keep_out, found = record.mission.keep_out, record.closest_approach
    noise = min(NOISE_SIGMAS * record.mission.frames.noise, NOISE_ALLOWANCE)
    allowed = keep_out * (1 - ROUNDING_TOLERANCE) - noise
    text = f", the keep-out of {keep_out:g} m less {noise:g} m for noise" * (noise > 0)
    return expect_apart(found.distance, allowed, found.pair, found.time(record.time), text=text)


def check_arrival(record: FormationRecord) -> Promise:
    """Check that every formation was taken up, within the tolerance of its shape."""
    faults = find_faults(record)
    text = faults[0] if faults else "all formations taken up"
    return Promise("reached", not faults, float(len(faults)), 0.0, text, kind="aim")


def _planar(record: FormationRecord, vectors: Array) -> Array:
    # The paper's code limits each axis of the plane by itself.
    flat = vectors[..., :2]
    return flat if record.mission.avoidance.legacy else np.linalg.norm(flat, axis=2)


def _position_uncertainty(record: FormationRecord) -> float:
    # Distance by which control steps between two instants can depart from the last velocity [m].
    mission, steps = record.mission, record.mission.steps_per_frame
    in_plane = mission.max_acceleration * (2**0.5 if mission.avoidance.legacy else 1.0)
    most = np.hypot(in_plane, mission.max_climb_acceleration)
    return float(mission.step**2 * most * steps * (steps - 1) / 2)
