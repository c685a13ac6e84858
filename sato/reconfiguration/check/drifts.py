"""Drifts after a loss of all thrust, from each recorded step, by the plant."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int
from numpy import ndarray as Array

from dynamics.model import StateSamples
from dynamics.trajectory_geometry import evaluate_bezier, hull_distance
from problems.drifts import DriftHorizon, Drifts
from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.check.subdivision import minimize_along
from sato.reconfiguration.passive_safety import make_horizon

PRECISION = 1e-6  # of the distance, over that which is asked for
THRUST = 1e-6  # of the largest control: less is none
CHANGES = "loss", "join", "assignment", "reset", "closed"  # after which others fly other plans


class DriftApproach(NamedTuple):
    """Nearest approach of a vehicle that drifts to another that flies on."""

    distance: float  # [m]
    agent: int  # that lost its thrust
    other: int
    step: int  # of the run, at which it lost it


class DriftApproaches(NamedTuple):
    """Losses of thrust that a run may have had after a vehicle's first thrust in a leg."""

    nearest: DriftApproach | None  # of those that count; None where none does
    counted: int
    left_out: int  # at and before steps at which others have changed what they fly


class FlownDrifts(NamedTuple):
    """Drifts from each step of a leg as it was flown, of the agents that are there at its end."""

    leg: LegRecord
    horizon: DriftHorizon
    drifts: Drifts


def find_drift_approaches(record: ReconfigurationRecord) -> DriftApproaches:
    """Find the nearest approach after a loss of thrust at any step after a vehicle's first thrust.

    Before that it drifts as it began. Others fly as recorded to the end of the leg, and freely
    after it; so losses count from the step on after which no plans have changed.
    """
    nearest, enough, counted, left_out = None, np.inf, 0, 0
    for leg in record.leg_records:
        if leg.end_event is None:
            continue
        flown, first = follow_leg(record, leg), find_first_losses(record, leg)
        thrust = _find_first_thrusts(record, leg)
        counted += int((leg.step_count - 1 - first).clip(0).sum())
        left_out += int((first - thrust).clip(0, leg.step_count - 1 - thrust).clip(0).sum())
        for row, step in enumerate(first.tolist()):
            found = approach_others(flown, row, flown.horizon.step > step, enough)
            if found is not None:
                nearest, enough = found, found.distance
    return DriftApproaches(nearest, counted, left_out)


def find_first_losses(record: ReconfigurationRecord, leg: LegRecord) -> Int[Array, " survivors"]:
    """Find the last step of a leg at which a loss of thrust of each agent does not count yet."""
    changes = [k - leg.start_index for k, _ in record.events.of_kind(*CHANGES)]
    period = record.mission.replan_steps
    # Those that could not commit to their plans do so at the next decision, or at a later one.
    changes += [k - leg.start_index + period for k, _ in record.events.of_kind("cautious")]
    since = max((k for k in changes if 0 <= k < leg.step_count), default=0)
    return np.asarray(np.maximum(_find_first_thrusts(record, leg), since))


def _find_first_thrusts(record: ReconfigurationRecord, leg: LegRecord) -> Int[Array, " survivors"]:
    """Find the step of a leg at which each agent thrusts for the first time."""
    flown = record.frames.applied_control[leg.start_index : leg.end_index, leg.alive]
    thrusts = (np.abs(flown) > THRUST * record.mission.largest_control.max()).any(axis=2)
    return np.asarray(np.where(thrusts.any(axis=0), thrusts.argmax(axis=0), leg.step_count))


def follow_leg(record: ReconfigurationRecord, leg: LegRecord) -> FlownDrifts:
    """Return the drifts of the vehicles that are there at the end of a leg, by the plant."""
    mission, plant, d = record.mission, record.mission.flown_plant, record.mission.axes

    def move(x: StateSamples, t: float, length: float) -> StateSamples:
        flat = x.reshape(-1, 2 * d)
        if not len(flat):
            return x
        moved = plant.propagate(flat, np.zeros((len(flat), d)), t, length)[1]
        return np.asarray(moved.reshape(x.shape))

    time = leg.start_index * mission.step
    horizon = replace(make_horizon(mission, time, leg.step_count), move=move)
    flown = slice(leg.start_index, leg.end_index)
    x = np.moveaxis(record.state[leg.start_index : leg.end_index + 1, leg.alive], 0, 1)
    u = np.moveaxis(record.frames.applied_control[flown, leg.alive], 0, 1)
    return FlownDrifts(leg, horizon, horizon.follow(x, u))


def approach_others(
    flown: FlownDrifts, row: int, counts: Bool[Array, " drifts"], enough: float = np.inf
) -> DriftApproach | None:
    """Return the nearest approach of an agent's drifts to others, if it is nearer than enough [m].

    The row of the agent is that among the agents at the end of the leg.
    """
    (leg, horizon, drifts), agents = flown, np.flatnonzero(flown.leg.alive)
    pieces, others = np.flatnonzero(counts), np.flatnonzero(np.arange(len(agents)) != row)
    relative = drifts.drifts[row, pieces] - drifts.path[others][:, horizon.piece[pieces]]

    def measure(parts: Array, _: Array) -> tuple[Array, Array]:
        return np.linalg.norm(evaluate_bezier(parts, 0.5), axis=1), hull_distance(parts)[0]

    flat, precision = relative.reshape(-1, *relative.shape[2:]), PRECISION * horizon.distance
    distance, number, _ = minimize_along(flat, measure, precision, enough)
    if number < 0:
        return None
    other, drift = divmod(number, len(pieces))
    step = leg.start_index + int(horizon.step[pieces[drift]])
    return DriftApproach(distance, int(agents[row]), int(agents[others[other]]), step)
