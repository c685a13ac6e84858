"""What a run promises, each judged by recomputing it."""

from math import exp

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.kinematic import Kinematic
from problems.graph import laplacian
from sato.check import common
from sato.check.promise import RELATIVE, Promise, below, largest, none, within
from sato.connectivity import log
from sato.connectivity.check.evidence import Evidence
from sato.connectivity.mission import ANYWHERE
from sato.network import canonical, parts

ROUNDED = 1e-9  # of weights, eigenvalues, cosines and speeds: what rounding leaves
SHAKEN = 8  # standard deviations that noise may do: beyond are 1 in 10¹⁵


def promises(evidence: Evidence) -> tuple[Promise, ...]:
    """Judge everything."""
    mission, lives = evidence.mission, evidence.alive
    return (
        complete(evidence),
        common.attributes(evidence.attributes, log.attributes(mission)),
        common.times(evidence.time, mission.step),
        common.numbers(lives, _states(evidence)),
        common.alive(lives, evidence.happened),
        losses(evidence),
        start(evidence),
        flight(evidence),
        obedience(evidence),
        heading(evidence),
        speed(evidence),
        turn(evidence),
        stick(evidence),
        weights(evidence),
        sight(evidence),
        eigenvalues(evidence),
        components(evidence),
        connected(evidence),
        separation(evidence),
        clearance(evidence),
    )


def complete(evidence: Evidence) -> Promise:
    """The flight lasts as long as the scenario says."""
    cut = common.cut_short(evidence.attributes)
    steps = round(evidence.mission.duration / evidence.mission.step)
    short = len(evidence.time) != steps + 1
    text = "every instant is there"
    return none("complete", int(short or bool(cut)), f"{text}; {cut}" if cut else text)


def losses(evidence: Evidence) -> Promise:
    """Robots are lost when the scenario says."""
    step, expected = evidence.mission.step, np.ones_like(evidence.alive)
    for death in evidence.mission.deaths:
        expected[step * np.arange(len(expected)) >= death.time - ROUNDED, death.robot] = False
    odd = int((expected != evidence.alive).sum())
    return none("losses", odd, "times a robot was there or not against the scenario")


def start(evidence: Evidence) -> Promise:
    """Robots start where the scenario says, at rest."""
    mission = evidence.mission
    if evidence.position.shape[1:] != mission.start.shape:
        return none("start", 1, "another number of agents than the scenario's")
    worst = max(
        largest(np.abs(evidence.position[0] - mission.start)),
        largest(np.abs(evidence.yaw[0] - mission.yaw)),
        largest(np.abs(evidence.velocity[0])),
    )
    tolerance = RELATIVE * float(np.abs(mission.start).max())
    return within("start", worst, tolerance, "off from the scenario's own start, at most")


def flight(evidence: Evidence) -> Promise:
    """Robots are where what they were asked for brings them, and the lost stay where they were."""
    p, again, lives = evidence.position, evidence.again, evidence.alive
    if again is None:
        off = np.abs(np.diff(p, axis=0) - _swept(evidence))
        lost = lives[:-1] & ~lives[1:]  # in this step: what noise did in it is not on file
        off[lost] = np.maximum(off[lost] - evidence.mission.step * _shakes(evidence), 0)
    else:
        off = np.abs(p - again.position)
    tolerance = RELATIVE * largest(np.abs(p))
    return within("flight", largest(off), tolerance, "m off from where commands lead")


def obedience(evidence: Evidence) -> Promise:
    """Velocities are what was asked for, as far as the plant obeys."""
    again, lives = evidence.again, evidence.alive
    if again is None:
        off = np.abs(_shaken(evidence))
    else:
        off = np.abs(evidence.velocity - again.velocity)[lives]
    text = "m/s off from what was asked for"
    return within("obedience", largest(off), ROUNDED + _shakes(evidence), text)


def heading(evidence: Evidence) -> Promise:
    """Robots turn as they asked, as far as the plant obeys, and the lost stay as they were."""
    h, again, text = evidence.mission.step, evidence.again, "rad off from what was asked for"
    if again is not None:
        return within("heading", largest(np.abs(evidence.yaw - again.yaw)), ROUNDED, text)
    (keep, mean), shakes = _follows(evidence), _shakes(evidence)
    rate, worst = np.zeros(evidence.yaw.shape[1]), 0.0
    for asked, lives, gone in zip(
        evidence.turn, evidence.alive, np.diff(evidence.yaw, axis=0), strict=False
    ):
        off = gone - np.where(lives, h * (asked + (rate - asked) * mean), 0)
        rate = asked + (rate - asked) * keep
        if shakes > 0:
            rate += off / h
        worst = max(worst, largest(np.abs(off)))
    return within("heading", worst, ROUNDED + h * shakes, text)


def speed(evidence: Evidence) -> Promise:
    """Nobody asks more of itself than it may."""
    asked = np.linalg.norm(evidence.command, axis=2)[evidence.alive]
    limit = evidence.mission.limits.speed
    return below("speed", largest(asked), limit, ROUNDED, "m/s asked for at most")


def turn(evidence: Evidence) -> Promise:
    """Nobody asks to turn faster than it may."""
    asked, limit = np.abs(evidence.turn[evidence.alive]), evidence.mission.limits.turn
    return below("turn", largest(asked), limit, ROUNDED, "rad/s asked for at most")


def stick(evidence: Evidence) -> Promise:
    """The stick asks what the operator would, and waypoints are reached where the leader is."""
    told = [k for k, _ in evidence.happened.told("waypoint")]
    operator, worst, reached = evidence.mission.stick, 0.0, 0
    for k, asked in enumerate(evidence.stick):
        at = evidence.position[k, 0]
        if evidence.alive[k, 0] and operator.arrives(at, reached):
            if reached >= len(told) or told[reached] != k:
                return none("stick", 1, f"waypoints reached and not told of, at instant {k}")
            reached += 1
        expected = np.zeros(3)
        if evidence.alive[k, 0]:
            expected = operator.ask(k * evidence.mission.step, at, reached)
        worst = max(worst, largest(np.abs(expected - asked)))
    if reached < len(told):
        return none("stick", len(told) - reached, "waypoints told of and not reached")
    return within("stick", worst, ROUNDED, "m/s off from what the operator would ask")


def weights(evidence: Evidence) -> Promise:
    """Weights are those of the poses, of tilted cameras and of what stands between robots."""
    off = np.abs(evidence.weight - evidence.views.weight)
    return within("weights", largest(off), ROUNDED, "off from that of the poses")


def sight(evidence: Evidence) -> Promise:
    """Robots see whom they can see, and nobody else."""
    least = ANYWHERE[0] if evidence.mission.blind else evidence.mission.camera.a_min
    facing = evidence.views.facing
    odd = (evidence.sees != (facing > least)) & ~(np.abs(facing - least) < ROUNDED)
    text = "pairs that see each other, or not, against their poses"
    return none("visibility", int(odd.sum()), text)


def eigenvalues(evidence: Evidence) -> Promise:
    """λ₂ and λ₃ are those of the weights on file, of those who are there."""
    worst = 0.0
    for lives in np.unique(evidence.alive, axis=0):
        k = np.flatnonzero((evidence.alive == lives).all(axis=1))
        who = np.flatnonzero(lives)
        if len(who) < 2:
            worst = np.inf if np.isfinite(evidence.lambda2[k]).any() else worst
            continue
        value = np.linalg.eigvalsh(laplacian(evidence.weight[np.ix_(k, who, who)]))
        worst = max(worst, largest(np.abs(value[:, 1] - evidence.lambda2[k])))
        if len(who) > 2:
            worst = max(worst, largest(np.abs(value[:, 2] - evidence.lambda3[k])))
    return within("eigenvalues", worst, ROUNDED * evidence.weight.shape[1], "off from the weights'")


def components(evidence: Evidence) -> Promise:
    """Components are those of the weights on file."""
    # Edges seldom come and go, and what hangs together takes long to find out.
    lives, agents = evidence.alive, evidence.alive.shape[1]
    links = (evidence.weight > 0).reshape(len(lives), -1)
    cases, case = np.unique(np.hstack([links, lives]), axis=0, return_inverse=True)
    found = [parts(c[:-agents].reshape(agents, agents), c[-agents:]) for c in cases]
    said = [canonical(labels) for labels in evidence.component]
    odd = int((np.array(found)[case] != np.array(said)).sum())
    return none("component", odd, "labels that the weights do not give")


def connected(evidence: Evidence) -> Promise:
    """The swarm hangs together at all instants."""
    apart = evidence.lambda2 <= evidence.mission.potential.least
    least, limit = float(evidence.lambda2.min()), evidence.mission.potential.least
    text = f"λ₂ is {least:.6g} at least, more than {limit:g} is asked"
    if apart.any():
        text += f"; from {evidence.time[int(np.argmax(apart))]:g} s on it was not always"
    return Promise("connectivity", not apart.any(), least, limit, text)


def separation(evidence: Evidence) -> Promise:
    """No two robots come as near as where they push without limit."""
    return _far("separation", evidence.to_robots, evidence, "from robot to robot")


def clearance(evidence: Evidence) -> Promise:
    """No robot comes as near to an obstacle."""
    return _far("obstacles", evidence.to_obstacles, evidence, "from robot to obstacle")


def _far(name: str, found: float, evidence: Evidence, what: str) -> Promise:
    limit = evidence.mission.repulsion.nearest
    text = f"{found:.6g} m {what} at least, {limit:g} m asked"
    return Promise(name, bool(found >= limit), found, limit, text)


def _states(evidence: Evidence) -> Float[Array, "instants agents k"]:
    # All that a live robot must have, side by side; of λ₂ it may know nothing.
    poses = (evidence.position, evidence.velocity, evidence.yaw[..., None])
    asked = (evidence.command, evidence.turn[..., None])
    return np.concatenate([*poses, *asked, evidence.weight, evidence.yaw_error], axis=2)


def _follows(evidence: Evidence) -> tuple[float, float]:
    # How much of what there was is left at the end of a step, and in the mean over it.
    plant, step = evidence.mission.plant, evidence.mission.step
    if not isinstance(plant, Kinematic) or plant.lag <= 0:
        return 0.0, 0.0
    keep = exp(-step / plant.lag)
    return keep, plant.lag / step * (1 - keep)


def _shakes(evidence: Evidence) -> float:
    # What noise may do to a velocity in a step.
    plant = evidence.mission.plant
    return SHAKEN * plant.noise if isinstance(plant, Kinematic) else 0.0


def _shaken(evidence: Evidence) -> Float[Array, "steps agents 3"]:
    # What velocities are off from those asked for, as the plant follows. The last velocity of
    # who is lost is not on file.
    body, asked = log.rotated(evidence.velocity, -evidence.yaw), evidence.asked[:-1]
    off = body[1:] - asked - (body[:-1] - asked) * _follows(evidence)[0]
    off[~(evidence.alive[1:] & evidence.alive[:-1])] = 0
    return np.asarray(off)


def _swept(evidence: Evidence) -> Float[Array, "steps agents 3"]:
    # How far robots come in each step, in the world frame: at their mean velocity, to which
    # noise adds what it adds to the last one, and the yaw of the middle of the step.
    v, asked, lives = evidence.velocity[:-1], evidence.asked[:-1], evidence.alive[:-1]
    body = log.rotated(v, -evidence.yaw[:-1])
    gone = asked + (body - asked) * _follows(evidence)[1] + _shaken(evidence)
    gone[~lives] = 0
    middle = (evidence.yaw[1:] + evidence.yaw[:-1]) / 2
    return np.asarray(evidence.mission.step * log.rotated(gone, middle))
