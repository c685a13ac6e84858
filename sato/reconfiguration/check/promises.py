"""Promises of a reconfiguration: the file agrees with its mission, its seed and itself."""

from copy import deepcopy

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.orbit import polar_nodal_scales
from dynamics.trajectory_geometry import sampled_separations
from problems.convexify import SEPARATION_TOLERANCE
from problems.limit import LIMIT_TOLERANCE, Limit
from sato.check import common
from sato.check.report import (
    Promise,
    Report,
    expect_apart,
    expect_below,
    expect_none,
    expect_small_error,
)
from sato.reconfiguration.check import fuel, legs
from sato.reconfiguration.check.clearance import find_excess
from sato.reconfiguration.check.prediction import bound_speed_excess, redraw
from sato.reconfiguration.check.recorded import ReconfigurationRecord
from sato.reconfiguration.check.summary import find_fault, is_reached, summarize
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.network_decision import whole_steps
from sato.reconfiguration.record import CHIEF_ELEMENTS, collect_attributes, stack_targets
from sato.run_data import RunData

PROMISES = tuple(
    "complete attributes times chief numbers start alive component flight applied measured control"
    " speed targets legs assignment blocked believed separation obstacles drifts reached"
    " fuel".split()
)
# Rounding in one step, relative to the largest position, speed or control.
ROUNDING_TOLERANCE = 1e-10
MOST_REFINEMENTS = 4  # of the cubic pieces, each with a sixteenth of the error


def check_run(data: RunData, mission: Reconfiguration, rng: np.random.Generator) -> Report:
    """Check a run's data against its mission, and the generator that the drawing of it left."""
    record = ReconfigurationRecord.from_data(data, mission)
    frames, log = record.frames, record.events
    times = check_clocks(record, rng)
    alive, changes, measured, applied = redraw(record, rng)
    ended = {leg.leg_index for leg in record.leg_records if leg.end_event is not None}
    unended = "legs that did not end" if len(ended) < len(mission.legs) else ""
    promises = (
        common.check_complete(record.attributes, unended),
        common.check_attributes(
            record.attributes, {"center": "", "epoch": ""} | collect_attributes(mission)
        ),
        times,
        check_chief(record),
        check_finite(record),
        check_start(record),
        common.check_alive(frames.alive, log, alive, changes),
        common.check_components(frames, mission.comm_radius),
        check_propagation(record),
        check_applied_control(record, applied),
        check_measurements(record, measured),
        check_control_limit(record),
        check_speed_limit(record),
        check_targets(record),
        legs.check_legs(record),
        legs.check_assignment(record),
        legs.check_blocked(record),
        legs.check_target_counts(record),
        check_separation(record),
        check_obstacles(record),
        check_drifts(record),
        check_arrival(record),
        check_fuel(record),
    )
    return Report(promises, summarize(record))


def check_clocks(record: ReconfigurationRecord, rng: np.random.Generator) -> Promise:
    """Check instants, and that clocks are behind by the steps that the seed gives."""
    mission, promise = record.mission, common.check_times(record.events, record.mission.step)
    delay = deepcopy(rng).spawn(1)[0].uniform(0.0, mission.link.skew, len(mission.initial_states))
    drawn = whole_steps(mission, delay)
    if [event["steps"] for _, event in record.events.of_kind("clocks")] == [drawn] * bool(drawn):
        return promise
    return promise._replace(kept=False, message="clocks that the seed does not give")


def check_chief(record: ReconfigurationRecord) -> Promise:
    """Check that the recorded orbit of the chief is that of the plant, at every instant."""
    plant, times = record.mission.flown_plant, range(len(record.time))
    elements = [plant.chief_elements(k * record.mission.step) for k in times]
    known = np.array([each for each in elements if each is not None])
    found = np.zeros(0) if record.variables.chief is None else record.variables.chief
    names = list(CHIEF_ELEMENTS) if len(known) else None
    if found.shape != known.shape or np.array(record.variables.element).tolist() != names:
        return expect_none("chief", 1, "missing orbit of a chief, or one without a chief")
    scale = polar_nodal_scales(known[0]) if len(known) else 1.0
    text = "relative error of the orbit of the chief"
    return expect_small_error("chief", (found - known) / scale, ROUNDING_TOLERANCE, text)


def check_finite(record: ReconfigurationRecord) -> Promise:
    """Check that live agents have states at all instants and controls at all but the last."""
    frames, alive = record.frames, record.frames.alive
    is_lacking = alive & ~np.isfinite(record.state).all(axis=2)
    controls = np.isfinite(np.concatenate([frames.control, frames.applied_control], axis=2))
    has_control = np.vstack([record.is_flying, np.zeros_like(alive[:1])])
    is_odd = (controls != has_control[..., None]).any(axis=2)
    text = "states or controls that are not finite, or of agents that are not alive"
    return expect_none("numbers", is_lacking | is_odd, text, record.time)


def check_start(record: ReconfigurationRecord) -> Promise:
    """Check that agents start, and join, with the states of the mission."""
    start, alive = record.mission.initial_states, record.frames.alive
    begins = np.vstack([alive[:1], alive[1:] & ~alive[:-1]])
    errors = np.where(begins[..., None], record.state - start, 0.0)
    tolerance = ROUNDING_TOLERANCE * float(np.abs(start).max())
    text = "error of an initial state, at most"
    return expect_small_error("start", errors, tolerance, text, record.time)


def check_propagation(record: ReconfigurationRecord) -> Promise:
    """Check that the plant takes every state to the next under the applied control."""
    x, frames, step = record.state, record.frames, record.mission.step
    p, v, u = (
        np.max(np.abs(a), initial=0.0, where=np.isfinite(a))
        for a in (frames.position, frames.velocity, frames.applied_control)
    )
    scale = np.repeat([p + v * step, v + u * step], record.mission.axes) + 1e-300
    errors = (record.repropagate()[:, 1] - x[1:]) / scale
    # Lost agents stay where they are or drift, so that every number of the file is checked.
    is_adrift = record.is_adrift[:-1]
    is_absent = ~frames.alive[:-1] & ~frames.alive[1:] & ~is_adrift
    moved = np.nan_to_num((x[1:] - x[:-1]) / scale)
    errors[~(record.is_flying | is_adrift)] = 0.0
    errors[is_absent] = moved[is_absent]
    text = "relative error of a step propagated again under its applied control"
    return expect_small_error("flight", errors, ROUNDING_TOLERANCE, text, record.time[1:])


def check_applied_control(
    record: ReconfigurationRecord, drawn: Float[Array, "steps agents d"]
) -> Promise:
    """Check that the applied control is the commanded one with the errors of the seed."""
    applied = record.frames.applied_control
    errors = np.where(record.is_flying[..., None], applied[:-1] - drawn, 0.0)
    tolerance = ROUNDING_TOLERANCE * float(np.nanmax(np.abs(applied), initial=0.0))
    text = "m/s² between the applied control and the draws of the seed"
    return expect_small_error("applied", errors, tolerance, text, record.time)


def check_measurements(
    record: ReconfigurationRecord, drawn: Float[Array, "steps agents n"]
) -> Promise:
    """Check that measurements are the states with the noise of the seed."""
    mission, frames = record.mission, record.frames
    parts = [a for a in (frames.measured_position, frames.measured_velocity) if a is not None]
    has_noise = bool(mission.position_noise or mission.velocity_noise)
    if len(parts) != 2 * has_noise:
        return expect_none("measured", 1, "missing measurements, or measurements without noise")
    if not parts:
        return expect_none("measured", 0, "measurements, for there is no noise")
    measured = np.concatenate(parts, axis=-1)
    if np.isfinite(measured[-1]).any():
        return expect_none("measured", 1, "measurements after the last control")
    tolerance = ROUNDING_TOLERANCE * float(np.abs(record.state).max())
    text = "m or m/s between measurements and the draws of the seed"
    return expect_small_error("measured", measured[:-1] - drawn, tolerance, text, record.time)


def check_control_limit(record: ReconfigurationRecord) -> Promise:
    """Check that no commanded control exceeds its limit."""
    limits = [record.mission.control_limit(i) for i in range(record.state.shape[1])]
    size = np.where(record.is_flying, _measure(limits, record.frames.control[:-1]), 0.0)
    most = [limit.most for limit in limits]
    return expect_below("control", size, most, LIMIT_TOLERANCE, "m/s² commanded", record.time)


def check_speed_limit(record: ReconfigurationRecord) -> Promise:
    """Check that no agent exceeds the speed limit by more than it could not know when it planned.

    That is the difference of the plant, the thrusters and the disturbance from the shared
    model since the last plan, recomputed to the last digit, and the possible effect of noise
    in the measured state; or what noise takes it from its reference, see `bound_speed_excess`.
    """
    alive = record.frames.alive
    limits = [record.mission.speed_limit(i) for i in range(alive.shape[1])]
    speed = np.where(alive, _measure(limits, record.frames.velocity), 0.0)
    most = np.array([limit.most for limit in limits])
    # A vector of length 1 is at most so large in the norm of the limit.
    stretch = np.array([1 / limit.shares.min() for limit in limits])
    stretch *= np.sqrt(record.mission.axes) if record.mission.speed_norm == 1 else 1.0
    if alive.any() and not np.isinf(most).all():
        most = most + bound_speed_excess(record) * stretch
    return expect_below("speed", speed, most, LIMIT_TOLERANCE, "m/s flown", record.time)


def _measure(
    limits: list[Limit], vectors: Float[Array, "instants agents d"]
) -> Float[Array, "instants agents"]:
    return np.stack([one.measure(vectors[:, i]) for i, one in enumerate(limits)], axis=1)


def check_targets(record: ReconfigurationRecord) -> Promise:
    """Check that the recorded targets are those of the mission."""
    found, expected = record.targets, np.concatenate(stack_targets(record.mission), axis=-1)
    if found.shape != expected.shape or (np.isfinite(found) != np.isfinite(expected)).any():
        return expect_none("targets", 1, "another number of targets than in the mission")
    is_target = np.isfinite(expected)
    tolerance = ROUNDING_TOLERANCE * float(np.abs(expected[is_target]).max())
    errors = (found - expected)[is_target]
    return expect_small_error("targets", errors, tolerance, "error of a target, at most")


def check_separation(record: ReconfigurationRecord, finer: int = MOST_REFINEMENTS) -> Promise:
    """Check that no two agents come closer than R_col, at samples or between them.

    With more pieces, so many times at most, where their error decides.
    """
    mission, frames, radius = record.mission, record.frames, record.mission.largest_separation
    if mission.has_own_separations:
        found, error = record.relative_separations
        sampled, radius = _least_relative(record), 1.0
        unit = "(R_i + R_j)/2" if mission.ellipsoid is None else "of the ellipsoid"
    else:
        (found, error), unit = record.separations, "m"
        sampled = float(sampled_separations(frames.position, frames.alive).min())
    nearest, allowed = found.minimum, radius * (1 - 1e-9)
    time = record.pieces.duration * (nearest.piece + nearest.fraction)
    least = min(nearest.distance, sampled)
    if finer and least - error < allowed <= least:
        return check_separation(record.refined(), finer - 1)
    return expect_apart(least, allowed, nearest.pair, time, error, unit=unit)


def _least_relative(record: ReconfigurationRecord) -> float:
    # At samples, relative to the distance that each pair keeps in its direction.
    radii, alive = record.mission.radii, record.frames.alive
    position = record.mission.scale_separations(record.frames.position)
    i, j = np.triu_indices(len(radii), 1)
    distance = np.linalg.norm(position[:, i] - position[:, j], axis=2) / ((radii[i] + radii[j]) / 2)
    return float(np.min(distance, where=alive[:, i] & alive[:, j], initial=np.inf))


def check_obstacles(record: ReconfigurationRecord, finer: int = MOST_REFINEMENTS) -> Promise:
    """Check that no agent comes closer than R to an obstacle, or leaves the allowed positions.

    With more pieces, so many times at most, where their error decides.
    """
    error, mission = record.pieces.error, record.mission
    beyond, agent, time = find_excess(record)
    # Walls stand so much farther away that vehicles reach targets on the bounds.
    spare = 2 * SEPARATION_TOLERANCE * mission.largest_separation * mission.widest_axis
    rounding = ROUNDING_TOLERANCE * float(np.abs(record.frames.position).max())
    if beyond > spare + rounding + error:
        text = f"{beyond:.3g} m out of the allowed positions"
        return Promise("obstacles", False, beyond, 0.0, text, (agent,), time, "safety")
    found = record.clearance
    if found is None:
        return Promise("obstacles", True, 0.0, 0.0, "there are none")
    radius = float(record.mission.radii[found.agent])
    kind = record.mission.obstacles[found.obstacle].kind
    text, allowed = f" to obstacle {found.obstacle}, a {kind}", radius * (1 - 1e-9)
    if finer and found.room + radius - error < allowed <= found.room + radius:
        return check_obstacles(record.refined(), finer - 1)
    near = (found.room + radius, allowed, (found.agent,), found.time, error)
    return expect_apart(*near, name="obstacles", text=text)


def check_drifts(record: ReconfigurationRecord) -> Promise:
    """Check that no agent drifts too near to another after a loss of thrust at any step."""
    found, allowed = record.drift_approaches, record.mission.passive_safety
    if allowed is None or found is None:
        return Promise("drifts", True, 0.0, 0.0, "no loss of thrust is asked for")
    losses = f"{found.counted} losses of thrust, {found.left_out} more as others changed plans"
    if found.nearest is None:
        return Promise("drifts", True, 0.0, allowed, losses)
    distance, agent, other, step = found.nearest
    text = f" after a loss of thrust of agent {agent}, of {losses}"
    near = (distance, allowed, (agent, other), step * record.mission.step)
    return expect_apart(*near, name="drifts", text=text)


def check_arrival(record: ReconfigurationRecord) -> Promise:
    """Check that every leg was reached."""
    count, begun = len(record.mission.legs), [leg.leg_index for leg in record.leg_records]
    faults = [fault for leg in record.leg_records if (fault := find_fault(record, leg))]
    faults += [f"leg {leg + 1} did not begin" for leg in range(count) if leg not in begun]
    text = faults[0] if faults else "all legs reached" if count > 1 else "the leg reached"
    return Promise("reached", not faults, float(len(faults)), 0.0, text, kind="aim")


def check_fuel(record: ReconfigurationRecord) -> Promise:
    """Check that no leg that was reached burned less than its lower bound.

    The bound is that of the shared model. A plant that differs from it may have saved as much
    as it would cost the model to correct that (`FuelBound.correction_fuel`). Where energy is the
    objective, so is its bound.
    """
    burned, shortfalls = fuel.compute_step_fuel(record), [0.0]
    for k, (leg, bound) in enumerate(zip(record.leg_records, record.fuel_bounds, strict=True)):
        if not is_reached(record, leg):
            continue
        if bound is not None:
            used = float(burned[leg.start_index : leg.end_index, bound.agents].sum())
            shortfalls.append(fuel.compute_fuel_shortfall(record, leg, bound, used))
        if record.mission.objective == "energy":
            shortfalls.append(fuel.compute_energy_shortfall(record, leg, record.energy_bounds[k]))
    text = "a leg's fuel or energy below its lower bound, relative"
    return expect_small_error("fuel", np.maximum(shortfalls, 0), 1e-6, text)
