"""What a run promises, each judged by recomputing it."""

from math import exp

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.kinematic import Kinematic
from problems.graph import graph, laplacian
from sato.check import common
from sato.check.promise import RELATIVE, Promise, below, largest, none, within
from sato.connectivity import log
from sato.connectivity.check.evidence import Evidence
from sato.connectivity.mission import ANYWHERE
from sato.network import canonical, parts

ROUNDED = 1e-9  # of weights, eigenvalues, cosines and speeds: what rounding leaves


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
    """Robots are where their own velocities bring them, and the lost stay where they were."""
    p, there, h = evidence.position, evidence.alive[:-1], evidence.mission.step
    off = np.diff(p, axis=0)
    off[there] -= (h * _mean_velocity(evidence))[there]
    tolerance = RELATIVE * largest(np.abs(p))
    return within("flight", largest(np.abs(off)), tolerance, "m off from a step flown")


def obedience(evidence: Evidence) -> Promise:
    """Velocities are what was asked for, as far as the plant obeys."""
    plant = evidence.mission.plant
    if not isinstance(plant, Kinematic):
        return none(
            "obedience", 0, "odd velocities, for what a quadrotor makes of a command is its"
        )
    if plant.noise > 0:
        return none("obedience", 0, "odd velocities, for noise may do to them what it likes")
    keep, _ = _follows(plant.lag, evidence.mission.step)
    body, asked = log.rotated(evidence.velocity, -evidence.yaw), _asked(evidence)[:-1]
    off = body[1:] - asked - (body[:-1] - asked) * keep
    worst = largest(np.abs(off[evidence.alive[:-1]]))
    return within("obedience", worst, ROUNDED, "m/s off from what was asked for")


def heading(evidence: Evidence) -> Promise:
    """Robots turn as they asked, as far as the plant obeys, and the lost stay as they were."""
    plant, h = evidence.mission.plant, evidence.mission.step
    if isinstance(plant, Kinematic) and plant.noise > 0:
        return none("heading", 0, "odd yaws, for noise may do to them what it likes")
    lag = plant.lag if isinstance(plant, Kinematic) else plant.attitude
    keep, mean = _follows(lag, h)
    rate, worst = np.zeros(evidence.yaw.shape[1]), 0.0
    for asked, lives, gone in zip(
        evidence.turn, evidence.alive, np.diff(evidence.yaw, axis=0), strict=False
    ):
        last, rate = rate, asked + (rate - asked) * keep
        swept = asked + (last - asked) * mean
        if not isinstance(plant, Kinematic):
            swept = (last + rate) / 2
        worst = max(worst, largest(np.abs(gone - np.where(lives, h * swept, 0))))
    return within("heading", worst, ROUNDED, "rad off from a step turned as asked for")


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
        expected = operator.ask(k * evidence.mission.step, at, reached)
        worst = max(worst, largest(np.abs(expected - asked)))
    if reached < len(told):
        return none("stick", len(told) - reached, "waypoints told of and not reached")
    return within("stick", worst, ROUNDED, "m/s off from what the operator would ask")


def weights(evidence: Evidence) -> Promise:
    """Weights are those of the poses; where cameras tilt or are blocked, no more than those."""
    mission, camera = evidence.mission, evidence.mission.camera
    found = graph(evidence.position, evidence.yaw, camera)
    both = _both(evidence)
    there, said = both * found.weight, evidence.weight
    if not isinstance(mission.plant, Kinematic):
        over = np.maximum(said - both * found.reach, 0)
        text = "more than distance allows; more is not judged, for cameras tilt with the robots"
    elif mission.occlusion:
        over = np.where(said > 0, np.abs(said - there), 0)
        text = "off from that of the poses where there is one; what hides others is not judged"
    else:
        over, text = np.abs(said - there), "off from that of the poses"
    return within("weights", largest(over), ROUNDED, text)


def sight(evidence: Evidence) -> Promise:
    """Robots see whom they can see; where cameras tilt or are blocked, nobody out of range."""
    mission, camera = evidence.mission, evidence.mission.camera
    least = ANYWHERE[0] if mission.blind else camera.a_min
    odd = 0
    free = isinstance(mission.plant, Kinematic) and not mission.occlusion
    for p, yaw, lives, sees in zip(
        evidence.position, evidence.yaw, evidence.alive, evidence.sees, strict=True
    ):
        gap = p[None] - p[:, None]
        far = np.linalg.norm(gap, axis=2)
        axis = log.rotated(np.tile(camera.axis, (len(p), 1)), yaw)
        facing = (gap * axis[:, None]).sum(axis=2) / np.where(far > 0, far, 1)
        near = (camera.d_min < far) & (far < camera.d_max) & lives & lives[:, None]
        edge = np.minimum(np.abs(far - camera.d_min), np.abs(far - camera.d_max)) < ROUNDED
        if free:
            edge |= np.abs(facing - least) < ROUNDED
            odd += int(((sees != (near & (facing > least))) & ~edge).sum())
        else:
            odd += int((sees & ~near & ~edge).sum())
    return none("visibility", odd, "pairs that see each other, or not, against their poses")


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


def _both(evidence: Evidence) -> Bool[Array, "instants agents agents"]:
    return np.asarray(evidence.alive[:, None] & evidence.alive[:, :, None])


def _asked(evidence: Evidence) -> Float[Array, "instants agents 3"]:
    # The leader adds what the operator asks, which comes in the world frame.
    asked = evidence.command.copy()
    asked[:, 0] += log.rotated(evidence.stick, -evidence.yaw[:, 0])
    return asked


def _follows(lag: float, step: float) -> tuple[float, float]:
    # How much of what there was is left at the end of a step, and in the mean over it.
    if lag <= 0:
        return 0.0, 0.0
    keep = exp(-step / lag)
    return keep, lag / step * (1 - keep)


def _mean_velocity(evidence: Evidence) -> Float[Array, "steps agents 3"]:
    # Over each step, in the world frame. A quadrotor's acceleration is taken to be constant in
    # a step. Others approach what they are asked for; what noise there is adds to both their
    # mean and their last velocity, and they go straight at the yaw of the middle of the step.
    v, plant, h = evidence.velocity, evidence.mission.plant, evidence.mission.step
    if not isinstance(plant, Kinematic):
        return np.asarray((v[1:] + v[:-1]) / 2)
    body, asked = log.rotated(v, -evidence.yaw), _asked(evidence)[:-1]
    keep, mean = _follows(plant.lag, h)
    gone = body[1:] + (body[:-1] - asked) * (mean - keep)
    return log.rotated(gone, (evidence.yaw[1:] + evidence.yaw[:-1]) / 2)
