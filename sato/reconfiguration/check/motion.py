"""Promises of how agents move: every step flown again, within limits, clear of the others."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.path import sampled_separations
from sato.check.promise import RELATIVE, Promise, below, largest, none, within
from sato.reconfiguration.check.chance import Chance
from sato.reconfiguration.check.evidence import Evidence
from sato.reconfiguration.check.fuel import size
from sato.reconfiguration.check.prediction import SIGMAS, faster_than_planned


def flight(evidence: Evidence) -> Promise:
    """Every step, flown again by the plant under the applied control, ends as recorded."""
    x = evidence.state
    off = np.abs(evidence.flown()[:, 1] - x[1:]) / _scale(evidence)
    # The dead stay where they are, so that nothing of the file is beyond the check.
    still = ~evidence.alive[:-1] & ~evidence.alive[1:]
    resting = np.abs(x[1:] - x[:-1]) / _scale(evidence)
    worst = max(largest(off[evidence.flies]), largest(np.nan_to_num(resting[still])))
    text = "relative error of a step flown again by its applied control"
    return within("flight", worst, RELATIVE, text)


def applied(evidence: Evidence, chance: Chance | None) -> Promise:
    """The applied control is the commanded one, with the errors and disturbances of the seed."""
    mission = evidence.mission
    pushed = (evidence.applied - evidence.control)[:-1]
    tilt = (1 + SIGMAS * mission.thrust_error) * mission.pointing_error
    wrong = mission.thrust_error + tilt * evidence.axes**0.5
    thrust = np.linalg.norm(evidence.control[:-1][evidence.flies], axis=-1, keepdims=True)
    return _as_drawn(
        "applied",
        pushed[evidence.flies],
        None if chance is None else chance.pushed[evidence.flies],
        mission.disturbance + wrong * thrust,
        float(np.nanmax(np.abs(evidence.applied), initial=0.0)),
        "m/s² between commanded and applied control",
    )


def measured(evidence: Evidence, chance: Chance | None) -> Promise:
    """What an agent measured is its state and the noise that the seed gives."""
    mission, seen = evidence.mission, evidence.measured
    noise = np.repeat([mission.position_noise, mission.velocity_noise], evidence.axes)
    if (seen is not None) != noise.any():
        return none("measured", 1, "lack of measurements, or measurements where there is no noise")
    if seen is None:
        return none("measured", 0, "measurements, for there is no noise")
    if np.isfinite(seen[-1]).any():
        return none("measured", 1, "measurements after the last control")
    off = (seen - evidence.state)[:-1]
    drawn = None if chance is None else chance.seen
    text = "m or m/s between state and measurement"
    return _as_drawn("measured", off, drawn, noise, float(np.abs(evidence.state).max()), text)


def control_limit(evidence: Evidence) -> Promise:
    """No commanded control is above its limit."""
    mission = evidence.mission
    u = size(evidence.control[:-1][evidence.flies], mission.control_norm)
    return below("control", largest(u), mission.max_control, 1e-9, "m/s² commanded")


def speed_limit(evidence: Evidence) -> Promise:
    """No agent is faster than it may be, but for what it could not know when it planned.

    That is what the plant, the thrusters and the disturbance did otherwise than the shared
    model since the last plan, recomputed to the last digit, and what noise in the measured
    state may do, see `faster_than_planned`.
    """
    limit, there = evidence.mission.max_speed, evidence.alive
    speed = np.linalg.norm(evidence.velocity[there], axis=-1)
    if not len(speed) or not np.isfinite(limit):
        return below("speed", largest(speed), limit, 1e-9, "m/s flown")
    allowed = limit + faster_than_planned(evidence)[there]
    worst = int(np.argmax(speed - allowed))
    return below("speed", float(speed[worst]), float(allowed[worst]), 1e-9, "m/s flown")


def separation(evidence: Evidence) -> Promise:
    """No two agents come closer than the collision radius, at samples or between them."""
    found, missed = evidence.pieces
    radius = evidence.mission.collision_radius
    samples = float(sampled_separations(evidence.position, evidence.alive).min())
    least = min(found.least.distance, samples)
    i, j = found.least.pair
    k = max(found.least.piece, 0) // evidence.refinement
    allowed = radius * (1 - 1e-9)
    text = f"{least:.9g} m between agents {i} and {j} in step {k}, {radius:g} m allowed"
    if missed:
        text += f" (the path between samples is known to {missed:.1g} m)"
    return Promise("separation", bool(least - missed >= allowed), least, allowed, text)


def _as_drawn(
    name: str,
    found: Float[Array, "*k d"],
    drawn: Float[Array, "*k d"] | None,
    sigma: Float[Array, "*s"],
    size: float,
    text: str,
) -> Promise:
    # Without the draws, as large as draws can be.
    if drawn is not None:
        text += ", beyond what the seed gives"
        return within(name, largest(np.abs(found - drawn)), RELATIVE * size, text)
    beyond = largest(np.abs(found) - SIGMAS * sigma)
    return within(name, beyond, 0.0, text + ", beyond what chance can do")


def _scale(evidence: Evidence) -> Float[Array, " n"]:
    p, v, u = (
        np.max(np.abs(a), initial=0.0, where=np.isfinite(a))
        for a in (evidence.position, evidence.velocity, evidence.applied)
    )
    step, d = evidence.mission.step, evidence.axes
    return np.repeat([p + v * step, v + u * step], d) + 1e-300
