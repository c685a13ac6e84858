"""Promises of how agents move: every step flown again, within limits, clear of the others."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.path import sampled_separations
from sato.check.chance import Chance
from sato.check.evidence import Evidence
from sato.check.fuel import size
from sato.check.promise import RELATIVE, Promise, below, largest, none, within

SIGMAS = 8.0  # a normal draw is further out once in 10¹⁵


def flight(evidence: Evidence) -> Promise:
    """Every step, flown again from the recorded state by the applied control, ends as recorded."""
    x, u, steps = evidence.state, evidence.applied[:-1], evidence.steps
    flown = (
        np.einsum("kab,kib->kia", steps.A, x[:-1])
        + np.einsum("kab,kib->kia", steps.B, u)
        + steps.z[:, None]
    )
    off = np.abs(flown - x[1:]) / _scale(evidence)
    # The dead stay where they are, so that nothing of the file is beyond the check.
    still = ~evidence.alive[:-1] & ~evidence.alive[1:]
    resting = np.abs(x[1:] - x[:-1]) / _scale(evidence)
    worst = max(largest(off[evidence.flies]), largest(np.nan_to_num(resting[still])))
    text = "relative error of a step flown again by its applied control"
    return within("flight", worst, RELATIVE, text)


def applied(evidence: Evidence, chance: Chance | None) -> Promise:
    """The applied control is the commanded one and the disturbance that the seed gives."""
    pushed = (evidence.applied - evidence.control)[:-1]
    text = "m/s² between commanded and applied control"
    return _as_drawn(
        "applied",
        pushed[evidence.flies],
        None if chance is None else chance.pushed[evidence.flies],
        np.asarray(evidence.mission.disturbance),
        float(np.nanmax(np.abs(evidence.applied), initial=0.0)),
        text,
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
    """No agent is faster than it may be, but for what noise adds before it is noticed."""
    mission = evidence.mission
    speed = np.linalg.norm(evidence.velocity[evidence.alive], axis=-1)
    noise = mission.replan_steps * mission.step * mission.disturbance + mission.velocity_noise
    slack = SIGMAS * noise * evidence.axes**0.5
    limit = mission.max_speed + slack if slack else mission.max_speed
    return below("speed", largest(speed), limit, 1e-9, "m/s flown")


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
