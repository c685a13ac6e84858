"""Promises of how agents move: every step flown again, within limits, clear of the others."""

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import sampled_separations
from sato.check.promise import (
    ROUNDING_TOLERANCE,
    Promise,
    expect_below,
    expect_none,
    expect_small_error,
    max_or_zero,
)
from sato.reconfiguration.check.fuel import vector_norm
from sato.reconfiguration.check.prediction import SIGMA_BOUND, bound_speed_excess
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.check.redraw import DisturbanceSamples


def check_propagation(evidence: ReconfigurationRecord) -> Promise:
    """Every step, flown again by the plant under the applied control, ends as recorded."""
    x = evidence.state
    off = np.abs(evidence.repropagate()[:, 1] - x[1:]) / _state_scale(evidence)
    # The dead stay where they are, so that nothing of the file is beyond the check.
    still = ~evidence.alive[:-1] & ~evidence.alive[1:]
    resting = np.abs(x[1:] - x[:-1]) / _state_scale(evidence)
    worst = max(max_or_zero(off[evidence.is_flying]), max_or_zero(np.nan_to_num(resting[still])))
    text = "relative error of a step flown again by its applied control"
    return expect_small_error("flight", worst, ROUNDING_TOLERANCE, text)


def check_applied_control(
    evidence: ReconfigurationRecord, chance: DisturbanceSamples | None
) -> Promise:
    """The applied control is the commanded one, with the errors and disturbances of the seed."""
    mission = evidence.mission
    pushed = (evidence.applied_control - evidence.control)[:-1]
    tilt = (1 + SIGMA_BOUND * mission.thrust_error) * mission.pointing_error
    wrong = mission.thrust_error + tilt * evidence.axes**0.5
    thrust = np.linalg.norm(evidence.control[:-1][evidence.is_flying], axis=-1, keepdims=True)
    return _check_samples(
        "applied",
        pushed[evidence.is_flying],
        None if chance is None else chance.control_error[evidence.is_flying],
        mission.disturbance + wrong * thrust,
        float(np.nanmax(np.abs(evidence.applied_control), initial=0.0)),
        "m/s² between commanded and applied control",
    )


def check_measurements(
    evidence: ReconfigurationRecord, chance: DisturbanceSamples | None
) -> Promise:
    """What an agent measured is its state and the noise that the seed gives."""
    mission, seen = evidence.mission, evidence.measured_state
    noise = np.repeat([mission.position_noise, mission.velocity_noise], evidence.axes)
    if (seen is not None) != noise.any():
        return expect_none(
            "measured", 1, "lack of measurements, or measurements where there is no noise"
        )
    if seen is None:
        return expect_none("measured", 0, "measurements, for there is no noise")
    if np.isfinite(seen[-1]).any():
        return expect_none("measured", 1, "measurements after the last control")
    off = (seen - evidence.state)[:-1]
    drawn = None if chance is None else chance.measurement_noise
    text = "m or m/s between state and measurement"
    return _check_samples("measured", off, drawn, noise, float(np.abs(evidence.state).max()), text)


def check_control_limit(evidence: ReconfigurationRecord) -> Promise:
    """No commanded control is above its limit."""
    mission = evidence.mission
    u = vector_norm(evidence.control[:-1][evidence.is_flying], mission.control_norm)
    return expect_below("control", max_or_zero(u), mission.max_control, 1e-9, "m/s² commanded")


def check_speed_limit(evidence: ReconfigurationRecord) -> Promise:
    """No agent is faster than it may be, but for what it could not know when it planned.

    That is what the plant, the thrusters and the disturbance did otherwise than the shared
    model since the last plan, recomputed to the last digit, and what noise in the measured
    state may do, see `faster_than_planned`.
    """
    limit, there = evidence.mission.max_speed, evidence.alive
    speed = np.linalg.norm(evidence.velocity[there], axis=-1)
    if not len(speed) or not np.isfinite(limit):
        return expect_below("speed", max_or_zero(speed), limit, 1e-9, "m/s flown")
    allowed = limit + bound_speed_excess(evidence)[there]
    worst = int(np.argmax(speed - allowed))
    return expect_below("speed", float(speed[worst]), float(allowed[worst]), 1e-9, "m/s flown")


def check_separation(evidence: ReconfigurationRecord) -> Promise:
    """No two agents come closer than the collision radius, at samples or between them."""
    found, missed = evidence.separations
    radius = evidence.mission.collision_radius
    samples = float(sampled_separations(evidence.position, evidence.alive).min())
    least = min(found.minimum.distance, samples)
    i, j = found.minimum.pair
    k = max(found.minimum.piece, 0) // evidence.pieces_per_step
    allowed = radius * (1 - 1e-9)
    text = f"{least:.9g} m between agents {i} and {j} in step {k}, {radius:g} m allowed"
    if missed:
        text += f" (the path between samples is known to {missed:.1g} m)"
    return Promise("separation", bool(least - missed >= allowed), least, allowed, text)


def _check_samples(
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
        return expect_small_error(
            name, max_or_zero(np.abs(found - drawn)), ROUNDING_TOLERANCE * size, text
        )
    beyond = max_or_zero(np.abs(found) - SIGMA_BOUND * sigma)
    return expect_small_error(name, beyond, 0.0, text + ", beyond what chance can do")


def _state_scale(evidence: ReconfigurationRecord) -> Float[Array, " n"]:
    p, v, u = (
        np.max(np.abs(a), initial=0.0, where=np.isfinite(a))
        for a in (evidence.position, evidence.velocity, evidence.applied_control)
    )
    step, d = evidence.mission.step, evidence.axes
    return np.repeat([p + v * step, v + u * step], d) + 1e-300
