"""What was left to chance in a flight, drawn again from the seed."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.reconfiguration.check.recorded import LegRecord, ReconfigurationRecord
from sato.reconfiguration.disturbances import apply_thruster_errors, has_thruster_errors


class DisturbanceSamples(NamedTuple):
    """What was added to the truth at every instant but the last."""

    measurement_noise: Float[Array, "steps agents n"]  # to the state that an agent measured
    control_error: Float[Array, "steps agents d"]  # to the control that it commanded [m/s²]


def redraw_disturbances(
    evidence: ReconfigurationRecord, rng: np.random.Generator
) -> DisturbanceSamples:
    """Draw again, in the order of the flight: losses, measurements, disturbances, thrusts.

    Args:
        evidence: What was recorded; who was lost is taken from its events.
        rng: As the drawing of the mission left it.
    """
    mission, d = evidence.mission, evidence.axes
    noise = np.repeat([mission.position_noise, mission.velocity_noise], d)
    steps, agents, n = len(evidence.time) - 1, *evidence.state.shape[1:]
    seen, pushed = np.zeros((steps, agents, n)), np.zeros((steps, agents, d))
    for stretch in evidence.leg_records:
        for k in range(stretch.start_index, min(stretch.end_index, steps)):
            _redraw_losses(evidence, stretch, k, rng)
            if noise.any():
                seen[k] = noise * rng.standard_normal((agents, n))
            pushed[k] = mission.disturbance * rng.standard_normal((agents, d))
            if has_thruster_errors(mission):
                told = evidence.control[k]
                pushed[k] += (
                    apply_thruster_errors(mission, told, rng.standard_normal((agents, 1 + d)))
                    - told
                )
    return DisturbanceSamples(seen, pushed)


def _redraw_losses(
    evidence: ReconfigurationRecord, stretch: LegRecord, k: int, rng: np.random.Generator
) -> None:
    leg = evidence.mission.legs[stretch.leg_index]
    due = [loss for loss in leg.losses if loss.at_step == k - stretch.start_index]
    if not any(loss.kind == "random" for loss in due):
        return
    told = [e["agents"] for at, e in evidence.events.of_kind("loss") if at == k]
    lives = evidence.alive[k].copy()
    lives[[i for lost in told for i in lost]] = True
    for loss, lost in zip(due, told, strict=False):
        if loss.kind == "random":
            live = np.flatnonzero(lives)
            rng.choice(live, round((loss.share or 0.0) * len(live)), replace=False)
        lives[lost] = False
