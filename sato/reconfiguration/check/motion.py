"""Promises of motion: every step propagated again, within limits, clear of the others."""

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


def check_propagation(record: ReconfigurationRecord) -> Promise:
    """Check that the plant takes every state to the next under the applied control."""
    x, scale = record.state, _state_scale(record)
    error = np.abs(record.repropagate()[:, 1] - x[1:]) / scale
    # Lost agents stay where they are, so that every number of the file is checked.
    is_absent = ~record.alive[:-1] & ~record.alive[1:]
    moved = np.abs(x[1:] - x[:-1]) / scale
    worst = max(max_or_zero(error[record.is_flying]), max_or_zero(np.nan_to_num(moved[is_absent])))
    text = "relative error of a step propagated again under its applied control"
    return expect_small_error("flight", worst, ROUNDING_TOLERANCE, text)


def check_applied_control(
    record: ReconfigurationRecord, samples: DisturbanceSamples | None
) -> Promise:
    """Check that the applied control is the commanded one with the errors of the seed."""
    mission, is_flying = record.mission, record.is_flying
    error = (record.applied_control - record.control)[:-1]
    tilt = (1 + SIGMA_BOUND * mission.thrust_error) * mission.pointing_error
    relative = mission.thrust_error + tilt * record.axes**0.5
    thrust = np.linalg.norm(record.control[:-1][is_flying], axis=-1, keepdims=True)
    return _check_samples(
        "applied",
        error[is_flying],
        None if samples is None else samples.control_error[is_flying],
        mission.disturbance + relative * thrust,
        float(np.nanmax(np.abs(record.applied_control), initial=0.0)),
        "m/s² between commanded and applied control",
    )


def check_measurements(
    record: ReconfigurationRecord, samples: DisturbanceSamples | None
) -> Promise:
    """Check that measurements are the states with the noise of the seed."""
    mission, measured = record.mission, record.measured_state
    noise = np.repeat([mission.position_noise, mission.velocity_noise], record.axes)
    if (measured is not None) != noise.any():
        text = "missing measurements, or measurements without noise"
        return expect_none("measured", 1, text)
    if measured is None:
        return expect_none("measured", 0, "measurements, for there is no noise")
    if np.isfinite(measured[-1]).any():
        return expect_none("measured", 1, "measurements after the last control")
    error = (measured - record.state)[:-1]
    drawn = None if samples is None else samples.measurement_noise
    size, text = float(np.abs(record.state).max()), "m or m/s between state and measurement"
    return _check_samples("measured", error, drawn, noise, size, text)


def check_control_limit(record: ReconfigurationRecord) -> Promise:
    """Check that no commanded control exceeds its limit."""
    mission = record.mission
    u = vector_norm(record.control[:-1][record.is_flying], mission.control_norm)
    return expect_below("control", max_or_zero(u), mission.max_control, 1e-9, "m/s² commanded")


def check_speed_limit(record: ReconfigurationRecord) -> Promise:
    """Check that no agent exceeds the speed limit by more than it could not know when it planned.

    That is the difference of the plant, the thrusters and the disturbance from the shared
    model since the last plan, recomputed to the last digit, and the possible effect of noise
    in the measured state, see `bound_speed_excess`.
    """
    limit, alive = record.mission.max_speed, record.alive
    speed = np.linalg.norm(record.velocity[alive], axis=-1)
    if not len(speed) or not np.isfinite(limit):
        return expect_below("speed", max_or_zero(speed), limit, 1e-9, "m/s flown")
    allowed = limit + bound_speed_excess(record)[alive]
    worst = int(np.argmax(speed - allowed))
    return expect_below("speed", float(speed[worst]), float(allowed[worst]), 1e-9, "m/s flown")


def check_separation(record: ReconfigurationRecord) -> Promise:
    """Check that no two agents come closer than R_col, at samples or between them."""
    found, error = record.separations
    radius = record.mission.collision_radius
    samples = float(sampled_separations(record.position, record.alive).min())
    least = min(found.minimum.distance, samples)
    i, j = found.minimum.pair
    k = max(found.minimum.piece, 0) // record.pieces_per_step
    allowed = radius * (1 - 1e-9)
    text = f"{least:.9g} m between agents {i} and {j} in step {k}, {radius:g} m allowed"
    if error:
        text += f" (the trajectory between samples is known to {error:.1g} m)"
    return Promise("separation", bool(least - error >= allowed), least, allowed, text)


def _check_samples(
    name: str,
    found: Float[Array, "*k d"],
    drawn: Float[Array, "*k d"] | None,
    sigma: Float[Array, "*s"],
    size: float,
    text: str,
) -> Promise:
    # Without the draws of the seed, errors are limited to what normal draws can be.
    if drawn is not None:
        error = max_or_zero(np.abs(found - drawn))
        text += ", beyond the draws of the seed"
        return expect_small_error(name, error, ROUNDING_TOLERANCE * size, text)
    excess = max_or_zero(np.abs(found) - SIGMA_BOUND * sigma)
    return expect_small_error(name, excess, 0.0, text + f", beyond {SIGMA_BOUND:g} sigma")


def _state_scale(record: ReconfigurationRecord) -> Float[Array, " n"]:
    p, v, u = (
        np.max(np.abs(a), initial=0.0, where=np.isfinite(a))
        for a in (record.position, record.velocity, record.applied_control)
    )
    step = record.mission.step
    return np.repeat([p + v * step, v + u * step], record.axes) + 1e-300
