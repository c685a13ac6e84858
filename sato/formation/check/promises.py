"""What a run promises, each judged by recomputing it."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.check import common
from sato.check.promise import RELATIVE, Promise, below, largest, none, within
from sato.formation import log
from sato.formation.check.evidence import Evidence
from sato.formation.check.replay import TOLD, Told

RESIDUAL = 1e-10  # of gains: what rounding leaves
NEARER = 0.05  # than the keep-out may somebody come, for what noise does [m]
ROUNDED = 1e-9  # relative, of speeds and accelerations


def promises(evidence: Evidence) -> tuple[Promise, ...]:
    """Judge everything."""
    mission, lives = evidence.mission, evidence.alive
    return (
        complete(evidence),
        common.attributes(evidence.attributes, log.attributes(mission)),
        common.times(evidence.time, mission.sample),
        common.numbers(
            lives, evidence.position, evidence.velocity, evidence.command, evidence.drift
        ),
        common.alive(lives, evidence.happened),
        together(evidence),
        start(evidence),
        frames(evidence),
        drift(evidence),
        formation(evidence),
        gains(evidence),
        flight(evidence),
        *speeds(evidence),
        *accelerations(evidence),
        legs(evidence),
        assignment(evidence),
        points(evidence),
        separation(evidence),
    )


def complete(evidence: Evidence) -> Promise:
    """The flight was not interrupted, and ends where who watches it would end it."""
    cut, over = common.cut_short(evidence.attributes), evidence.replay.complete
    text = f"every instant is there{'' if over else ', or so it should be'}"
    return none("complete", int(not over or bool(cut)), f"{text}; {cut}" if cut else text)


def together(evidence: Evidence) -> Promise:
    """All take part in one network, that of the formation's graph."""
    odd = int((~evidence.alive).sum() + (evidence.component != 0).sum())
    return none("component", odd, "times an agent was not there, or in another network")


def start(evidence: Evidence) -> Promise:
    """Vehicles start where the scenario says, at rest."""
    at = evidence.mission.start
    if evidence.position.shape[1:] != at.shape:
        return none("start", 1, "another number of agents than the scenario's")
    off = np.abs(evidence.position[0] - at)
    tolerance = RELATIVE * float(np.abs(at).max())
    worst = max(largest(off), largest(np.abs(evidence.velocity[0])))
    return within("start", worst, tolerance, "off from the scenario's own start, at most")


def frames(evidence: Evidence) -> Promise:
    """Frames are those that the seed gives."""
    drawn = evidence.mission.frames
    turned = np.abs(np.exp(1j * evidence.yaw) - drawn.heading)
    shifted = np.abs(evidence.offset - drawn.offset) / max(1.0, largest(np.abs(drawn.offset)))
    worst = max(largest(turned), largest(shifted))
    return within("frames", worst, RELATIVE, "off from the frames that the seed gives, relative")


def drift(evidence: Evidence) -> Promise:
    """Reckoning drifts with the distance flown, as the seed gives."""
    mission = evidence.mission
    speed = np.linalg.norm(evidence.velocity[1:], axis=2, keepdims=True)
    off = np.diff(evidence.drift, axis=0) - speed * mission.sample * mission.frames.drift
    rate = largest(np.abs(mission.frames.drift))
    tolerance = RELATIVE * largest(np.abs(evidence.drift)) + rate * _unseen(evidence)
    worst = max(largest(np.abs(off)), largest(np.abs(evidence.drift[0])))
    return within("drift", worst, tolerance, "m off from the drift of the way flown in a step")


def formation(evidence: Evidence) -> Promise:
    """Formations and graphs on file are those that the scenario gives."""
    shapes = [gains.formation for gains in evidence.mission.shapes]
    if len(shapes) != len(evidence.formation):
        return none("formation", 1, "another number of formations than the scenario's")
    odd = sum(
        not np.allclose(points, shape.points, rtol=RELATIVE, atol=RELATIVE)
        or not np.array_equal(graph, shape.graph)
        for points, graph, shape in zip(evidence.formation, evidence.graph, shapes, strict=True)
    )
    return none("formation", odd, "formations or graphs that are not the scenario's")


def gains(evidence: Evidence) -> Promise:
    """Gains are stable, leave the formation alone, and use no more than the graph gives."""
    worst, rate = 0.0, np.inf
    for leg in range(len(evidence.mission.shapes)):
        try:
            found = evidence.gains(leg)
        except ValueError as error:
            return Promise("gains", False, np.inf, RESIDUAL, f"leg {leg + 1}: {error}")
        parts = (found.residual_kernel, found.residual_structure, found.residual_graph)
        worst, rate = max(worst, *parts), min(rate, found.rate)
    text = f"largest residual of the gains, whose rate is {rate:.3g} 1/s or more"
    return within("gains", worst, RESIDUAL, text)


def flight(evidence: Evidence) -> Promise:
    """Vehicles are where their own velocities bring them."""
    p, v = evidence.position, evidence.velocity
    off = np.abs(np.diff(p, axis=0) - v[1:] * evidence.mission.sample)
    tolerance = RELATIVE * largest(np.abs(p)) + _unseen(evidence)
    return within("flight", largest(off), tolerance, "m off from a step flown by its velocity")


def speeds(evidence: Evidence) -> tuple[Promise, Promise]:
    """Nobody is faster than it may be."""
    limits = evidence.mission.limits
    flat, up = _sizes(evidence, evidence.velocity)
    return (
        below("speed", flat, limits.speed, ROUNDED, "m/s flown in the plane"),
        below("climb", up, limits.climb, ROUNDED, "m/s flown up or down"),
    )


def accelerations(evidence: Evidence) -> tuple[Promise, Promise]:
    """Nobody changes its velocity faster than it may."""
    limits = evidence.mission.limits
    flat, up = _sizes(evidence, np.diff(evidence.velocity, axis=0) / evidence.mission.sample)
    return (
        below("acceleration", flat, limits.acceleration, ROUNDED, "m/s² in the plane"),
        below("climb_acceleration", up, limits.climb_acceleration, ROUNDED, "m/s² up or down"),
    )


def legs(evidence: Evidence) -> Promise:
    """Legs, auctions and gridlocks come and go as commands and avoidance on file have it."""
    told = [Told(k, e["kind"], int(e["leg"])) for k, e in evidence.happened.told(*TOLD)]
    odd = len(set(told) ^ set(evidence.replay.told)) + len(told) - len(set(told))
    odd += int((evidence.leg != evidence.replay.leg).sum())
    return none("legs", odd, "entries of legs and their events that commands do not give")


def assignment(evidence: Evidence) -> Promise:
    """A point changes with an event, and only so; at the start of a leg it is one's number."""
    agents = evidence.point.shape[1]
    expected = np.tile(np.arange(agents), (len(evidence.point), 1))
    odd = 0
    for k, event in evidence.happened.told("leg_start", "assignment"):
        called = event["kind"] == "leg_start"
        now = np.arange(agents) if called else np.asarray(event["point"], dtype=np.int64)
        changed = np.flatnonzero(expected[k] != now)
        odd += not called and changed.tolist() != event["agents"]
        expected[k:] = now
    odd += int((expected != evidence.point).sum())
    return none("assignment", odd, "points held against the events")


def points(evidence: Evidence) -> Promise:
    """No two vehicles hold one point; where messages are lost, not when a leg is taken up.

    Who has not heard how an auction ended keeps the point that it had until the next.
    """
    held = evidence.point
    if evidence.mission.radio.loss > 0:
        held = held[[s.end for s in evidence.replay.stretches if s.settled]]
    everyone = np.arange(held.shape[1])
    odd = int((np.sort(held, axis=1) != everyone).any(axis=1).sum())
    return none("points", odd, "instants at which two hold one point")


def separation(evidence: Evidence) -> Promise:
    """No two vehicles come nearer in the plane than the keep-out, but for what noise does."""
    keep_out, found = evidence.mission.avoidance.keep_out, evidence.closest
    allowed = keep_out - NEARER
    i, j = found.pair
    text = (
        f"{found.distance:.6g} m between agents {i} and {j} after {found.instant} steps, a "
        f"keep-out of {keep_out:g} m less {NEARER:g} m for noise"
    )
    return Promise("separation", bool(found.distance >= allowed), found.distance, allowed, text)


def _sizes(evidence: Evidence, vectors: Float[Array, "instants agents 3"]) -> tuple[float, float]:
    # In the plane and upwards; in the printed code each axis of the plane by itself is limited.
    flat = np.abs(vectors[..., :2])
    size = flat if evidence.mission.limits.each_axis else np.linalg.norm(flat, axis=2)
    return largest(size), largest(np.abs(vectors[..., 2]))


def _unseen(evidence: Evidence) -> float:
    # How far control steps between two instants can lead from the last velocity [m].
    mission, limits = evidence.mission, evidence.mission.limits
    most = max(limits.acceleration, limits.climb_acceleration)
    return mission.step**2 * most * mission.every * (mission.every - 1) / 2
