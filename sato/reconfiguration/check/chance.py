"""What was left to chance in a flight, drawn again from the seed."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from sato.reconfiguration.actuators import inexact, push
from sato.reconfiguration.check.evidence import Evidence, Stretch


class Chance(NamedTuple):
    """What was added to the truth at every instant but the last."""

    seen: Float[Array, "steps agents n"]  # to the state that an agent measured
    pushed: Float[Array, "steps agents d"]  # to the control that it commanded [m/s²]


def drawn(evidence: Evidence, rng: np.random.Generator) -> Chance:
    """Draw again, in the order of the flight: losses, measurements, disturbances, thrusts.

    Args:
        evidence: What was recorded; who was lost is taken from its events.
        rng: As the drawing of the mission left it.
    """
    mission, d = evidence.mission, evidence.axes
    noise = np.repeat([mission.position_noise, mission.velocity_noise], d)
    steps, agents, n = len(evidence.time) - 1, *evidence.state.shape[1:]
    seen, pushed = np.zeros((steps, agents, n)), np.zeros((steps, agents, d))
    for stretch in evidence.stretches:
        for k in range(stretch.first, min(stretch.last, steps)):
            _draw_losses(evidence, stretch, k, rng)
            if noise.any():
                seen[k] = noise * rng.standard_normal((agents, n))
            pushed[k] = mission.disturbance * rng.standard_normal((agents, d))
            if inexact(mission):
                told = evidence.control[k]
                pushed[k] += push(mission, told, rng.standard_normal((agents, 1 + d))) - told
    return Chance(seen, pushed)


def _draw_losses(evidence: Evidence, stretch: Stretch, k: int, rng: np.random.Generator) -> None:
    leg = evidence.mission.legs[stretch.leg]
    due = [loss for loss in leg.losses if loss.at_step == k - stretch.first]
    if not any(loss.kind == "random" for loss in due):
        return
    told = [e["agents"] for at, e in evidence.happened.told("loss") if at == k]
    lives = evidence.alive[k].copy()
    lives[[i for lost in told for i in lost]] = True
    for loss, lost in zip(due, told, strict=False):
        if loss.kind == "random":
            live = np.flatnonzero(lives)
            rng.choice(live, round(loss.share * len(live)), replace=False)
        lives[lost] = False
