"""What a run promises, each judged by recomputing it."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.check import common
from sato.check.promise import (
    ROUNDING_TOLERANCE,
    Promise,
    expect_below,
    expect_none,
    expect_small_error,
    max_or_zero,
)
from sato.formation import record
from sato.formation.check.evidence import FormationRecord
from sato.formation.check.replay import REPLAYED_EVENTS, ReplayedEvent

RESIDUAL = 1e-10  # of gains: what rounding leaves
NOISE_ALLOWANCE = 0.05  # than the keep-out may somebody come, for what noise does [m]
ROUNDING_TOLERANCE = 1e-9  # relative, of speeds and accelerations


def check_promises(evidence: FormationRecord) -> tuple[Promise, ...]:
    """Judge everything."""
    mission, lives = evidence.mission, evidence.alive
    return (
        check_complete(evidence),
        common.check_attributes(evidence.attributes, record.run_attributes(mission)),
        common.check_times(evidence.time, mission.frame_period),
        common.check_finite(
            lives,
            evidence.position,
            evidence.velocity,
            evidence.velocity_command,
            evidence.frame_drift,
        ),
        common.check_alive(lives, evidence.events),
        check_connected(evidence),
        check_start(evidence),
        check_coordinate_frames(evidence),
        check_drift(evidence),
        check_formations(evidence),
        check_gains(evidence),
        check_positions(evidence),
        *check_speed_limits(evidence),
        *check_acceleration_limits(evidence),
        check_legs(evidence),
        check_assignment_events(evidence),
        check_assignment_is_unique(evidence),
        check_separation(evidence),
    )


def check_complete(evidence: FormationRecord) -> Promise:
    """The flight was not interrupted, and ends where who watches it would end it."""
    cut, over = common.incomplete_reason(evidence.attributes), evidence.replay.is_complete
    text = f"every instant is there{'' if over else ', or so it should be'}"
    return expect_none("complete", int(not over or bool(cut)), f"{text}; {cut}" if cut else text)


def check_connected(evidence: FormationRecord) -> Promise:
    """All take part in one network, that of the formation's graph."""
    odd = int((~evidence.alive).sum() + (evidence.component != 0).sum())
    return expect_none("component", odd, "times an agent was not there, or in another network")


def check_start(evidence: FormationRecord) -> Promise:
    """Vehicles start where the scenario says, at rest."""
    at = evidence.mission.start
    if evidence.position.shape[1:] != at.shape:
        return expect_none("start", 1, "another number of agents than the scenario's")
    off = np.abs(evidence.position[0] - at)
    tolerance = ROUNDING_TOLERANCE * float(np.abs(at).max())
    worst = max(max_or_zero(off), max_or_zero(np.abs(evidence.velocity[0])))
    return expect_small_error(
        "start", worst, tolerance, "off from the scenario's own start, at most"
    )


def check_coordinate_frames(evidence: FormationRecord) -> Promise:
    """Frames are those that the seed gives."""
    drawn = evidence.mission.coordinate_frames
    turned = np.abs(np.exp(1j * evidence.frame_yaw) - drawn.rotation)
    shifted = np.abs(evidence.frame_origin - drawn.origin) / max(
        1.0, max_or_zero(np.abs(drawn.origin))
    )
    worst = max(max_or_zero(turned), max_or_zero(shifted))
    return expect_small_error(
        "frames", worst, ROUNDING_TOLERANCE, "off from the frames that the seed gives, relative"
    )


def check_drift(evidence: FormationRecord) -> Promise:
    """Reckoning drifts with the distance flown, as the seed gives."""
    mission = evidence.mission
    speed = np.linalg.norm(evidence.velocity[1:], axis=2, keepdims=True)
    off = (
        np.diff(evidence.frame_drift, axis=0)
        - speed * mission.frame_period * mission.coordinate_frames.drift_rate
    )
    rate = max_or_zero(np.abs(mission.coordinate_frames.drift_rate))
    tolerance = ROUNDING_TOLERANCE * max_or_zero(
        np.abs(evidence.frame_drift)
    ) + rate * _position_uncertainty(evidence)
    worst = max(max_or_zero(np.abs(off)), max_or_zero(np.abs(evidence.frame_drift[0])))
    return expect_small_error(
        "drift", worst, tolerance, "m off from the drift of the way flown in a step"
    )


def check_formations(evidence: FormationRecord) -> Promise:
    """Formations and graphs on file are those that the scenario gives."""
    shapes = [gains.formation for gains in evidence.mission.gains]
    if len(shapes) != len(evidence.formation_points):
        return expect_none("formation", 1, "another number of formations than the scenario's")
    odd = sum(
        not np.allclose(points, shape.points, rtol=ROUNDING_TOLERANCE, atol=ROUNDING_TOLERANCE)
        or not np.array_equal(graph, shape.graph)
        for points, graph, shape in zip(
            evidence.formation_points, evidence.graph, shapes, strict=True
        )
    )
    return expect_none("formation", odd, "formations or graphs that are not the scenario's")


def check_gains(evidence: FormationRecord) -> Promise:
    """Gains are stable, leave the formation alone, and use no more than the graph gives."""
    worst, rate = 0.0, np.inf
    for leg in range(len(evidence.mission.gains)):
        try:
            found = evidence.load_gains(leg)
        except ValueError as error:
            return Promise("gains", False, np.inf, RESIDUAL, f"leg {leg + 1}: {error}")
        parts = (found.residual_kernel, found.residual_structure, found.residual_graph)
        worst, rate = max(worst, *parts), min(rate, found.convergence_rate)
    text = f"largest residual of the gains, whose rate is {rate:.3g} 1/s or more"
    return expect_small_error("gains", worst, RESIDUAL, text)


def check_positions(evidence: FormationRecord) -> Promise:
    """Vehicles are where their own velocities bring them."""
    p, v = evidence.position, evidence.velocity
    off = np.abs(np.diff(p, axis=0) - v[1:] * evidence.mission.frame_period)
    tolerance = ROUNDING_TOLERANCE * max_or_zero(np.abs(p)) + _position_uncertainty(evidence)
    return expect_small_error(
        "flight", max_or_zero(off), tolerance, "m off from a step flown by its velocity"
    )


def check_speed_limits(evidence: FormationRecord) -> tuple[Promise, Promise]:
    """Nobody is faster than it may be."""
    limits = evidence.mission.limits
    flat, up = _planar_and_vertical_norms(evidence, evidence.velocity)
    return (
        expect_below("speed", flat, limits.speed, ROUNDING_TOLERANCE, "m/s flown in the plane"),
        expect_below("climb", up, limits.climb, ROUNDING_TOLERANCE, "m/s flown up or down"),
    )


def check_acceleration_limits(evidence: FormationRecord) -> tuple[Promise, Promise]:
    """Nobody changes its velocity faster than it may."""
    limits = evidence.mission.limits
    flat, up = _planar_and_vertical_norms(
        evidence, np.diff(evidence.velocity, axis=0) / evidence.mission.frame_period
    )
    return (
        expect_below(
            "acceleration", flat, limits.acceleration, ROUNDING_TOLERANCE, "m/s² in the plane"
        ),
        expect_below(
            "climb_acceleration",
            up,
            limits.climb_acceleration,
            ROUNDING_TOLERANCE,
            "m/s² up or down",
        ),
    )


def check_legs(evidence: FormationRecord) -> Promise:
    """Legs, auctions and gridlocks come and go as commands and avoidance on file have it."""
    told = [
        ReplayedEvent(k, e["kind"], int(e["leg"]))
        for k, e in evidence.events.of_kind(*REPLAYED_EVENTS)
    ]
    odd = len(set(told) ^ set(evidence.replay.events)) + len(told) - len(set(told))
    odd += int((evidence.leg != evidence.replay.leg).sum())
    return expect_none("legs", odd, "entries of legs and their events that commands do not give")


def check_assignment_events(evidence: FormationRecord) -> Promise:
    """A point changes with an event, and only so; at the start of a leg it is one's number."""
    agents = evidence.assignment.shape[1]
    expected = np.tile(np.arange(agents), (len(evidence.assignment), 1))
    odd = 0
    for k, event in evidence.events.of_kind("leg_start", "assignment"):
        called = event["kind"] == "leg_start"
        now = np.arange(agents) if called else np.asarray(event["point"], dtype=np.int64)
        changed = np.flatnonzero(expected[k] != now)
        odd += not called and changed.tolist() != event["agents"]
        expected[k:] = now
    odd += int((expected != evidence.assignment).sum())
    return expect_none("assignment", odd, "points held against the events")


def check_assignment_is_unique(evidence: FormationRecord) -> Promise:
    """No two vehicles hold one point; where messages are lost, not when a leg is taken up.

    Who has not heard how an auction ended keeps the point that it had until the next.
    """
    held = evidence.assignment
    if evidence.mission.radio.loss_probability > 0:
        held = held[[s.end_instant for s in evidence.replay.legs if s.completed]]
    everyone = np.arange(held.shape[1])
    odd = int((np.sort(held, axis=1) != everyone).any(axis=1).sum())
    return expect_none("points", odd, "instants at which two hold one point")


def check_separation(evidence: FormationRecord) -> Promise:
    """No two vehicles come nearer in the plane than the keep-out, but for what noise does."""
    keep_out, found = evidence.mission.avoidance.keep_out, evidence.closest_approach
    allowed = keep_out - NOISE_ALLOWANCE
    i, j = found.pair
    text = (
        f"{found.distance:.6g} m between agents {i} and {j} after {found.piece} steps, a "
        f"keep-out of {keep_out:g} m less {NOISE_ALLOWANCE:g} m for noise"
    )
    return Promise("separation", bool(found.distance >= allowed), found.distance, allowed, text)


def _planar_and_vertical_norms(
    evidence: FormationRecord, vectors: Float[Array, "instants agents 3"]
) -> tuple[float, float]:
    # In the plane and upwards; in the printed code each axis of the plane by itself is limited.
    flat = np.abs(vectors[..., :2])
    size = flat if evidence.mission.limits.per_axis else np.linalg.norm(flat, axis=2)
    return max_or_zero(size), max_or_zero(np.abs(vectors[..., 2]))


def _position_uncertainty(evidence: FormationRecord) -> float:
    # How far control steps between two instants can lead from the last velocity [m].
    mission, limits = evidence.mission, evidence.mission.limits
    most = max(limits.acceleration, limits.climb_acceleration)
    return (
        mission.control_step**2 * most * mission.steps_per_frame * (mission.steps_per_frame - 1) / 2
    )
