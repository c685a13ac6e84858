"""Random draws of a run, made again from its seed."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.disturbances import apply_thruster_errors, has_thruster_errors


class DisturbanceSamples(NamedTuple):
    """Errors that the seed gives, for every control step."""

    measurement_noise: Float[Array, "steps agents n"]  # of the state that an agent measures
    control_error: Float[Array, "steps agents d"]  # of the control that it commands [m/s²]


def redraw_disturbances(
    record: ReconfigurationRecord, rng: np.random.Generator
) -> DisturbanceSamples:
    """Draw again, in the order of the loop: losses, measurements, disturbances, thruster errors.

    Args:
        record: Run; the agents that are lost are taken from its events.
        rng: Generator as the drawing of the mission left it.
    """
    mission, d = record.mission, record.axes
    noise = np.repeat([mission.position_noise, mission.velocity_noise], d)
    steps, agents, n = len(record.time) - 1, *record.state.shape[1:]
    measured, applied = np.zeros((steps, agents, n)), np.zeros((steps, agents, d))
    for leg in record.leg_records:
        for k in range(leg.start_index, min(leg.end_index, steps)):
            _redraw_losses(record, leg, k, rng)
            if noise.any():
                measured[k] = noise * rng.standard_normal((agents, n))
            applied[k] = mission.disturbance * rng.standard_normal((agents, d))
            if has_thruster_errors(mission):
                control, draws = record.control[k], rng.standard_normal((agents, 1 + d))
                applied[k] += apply_thruster_errors(mission, control, draws) - control
    return DisturbanceSamples(measured, applied)


def _redraw_losses(
    record: ReconfigurationRecord, leg: LegRecord, k: int, rng: np.random.Generator
) -> None:
    losses = record.mission.legs[leg.leg_index].losses
    due = [loss for loss in losses if loss.at_step == k - leg.start_index]
    if not any(loss.kind == "random" for loss in due):
        return
    events = [e["agents"] for at, e in record.events.of_kind("loss") if at == k]
    alive = record.alive[k].copy()
    alive[[i for lost in events for i in lost]] = True
    for loss, lost in zip(due, events, strict=False):
        if loss.kind == "random":
            live = np.flatnonzero(alive)
            rng.choice(live, round((loss.share or 0.0) * len(live)), replace=False)
        alive[lost] = False
