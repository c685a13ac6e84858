"""Whether everybody can be somewhere in time, asked before anything is flown."""

from dataclasses import replace
from math import floor, inf
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from dynamics import DoubleIntegrator, discretize_zoh
from problems.auction_cost import compute_transfer_costs
from sato.reconfiguration.mission import Reconfiguration
from sato.former.refusal import Refusal, listed, upward

LONGEST = 64  # times the steps that were asked for; beyond, time is not what is missing
STRONGEST = 64  # times the control that there is; beyond, it is not what is missing either
FINE = 1.01  # to which part the control that would do is found
MUCH = 20_000_000  # pairs × steps, above which no longer time is tried


class Lacking(NamedTuple):
    """An agent with nowhere to be."""

    agent: int
    alone: bool  # it reaches nothing at all; else the others need all that it reaches


def check_reach(mission: Reconfiguration) -> None:
    """Refuse a first leg in which somebody has nowhere to be.

    Looks at the limits on control, and on speed where a necessary condition has a closed
    form: what passes can still turn out to be out of reach on the way.

    Raises:
        Refusal: An agent can reach none of the targets that it bids on, or too few of them can
            be reached for everybody to have one; says for which agent, and what time or thrust
            would do.
    """
    steps = mission.legs[0].steps
    lacking = _lacking(mission, steps)
    if lacking is None:
        return
    what = (
        "can reach none of its targets"
        if lacking.alone
        else "is left without a target, for the others need all that it can reach,"
    )
    time, thrust = _enough(mission, steps), _strong(mission, steps)
    cures = [f"steps = {time}"] if time else []
    cures += [f"model.max_control_m_s2 = {thrust}"] if thrust else []
    cures = cures or ["far more steps, a larger model.max_control_m_s2 or max_speed_m_s"]
    raise Refusal(
        "leg.0.steps",
        f"agent {lacking.agent} {what} in {steps} steps of {mission.step:g} s; "
        f"{listed(cures)} would do",
    )


def _enough(mission: Reconfiguration, steps: int) -> int | None:
    pairs = len(mission.initial_states) * len(mission.legs[0].targets)
    few, many = steps, 2 * steps
    while _lacking(mission, many) is not None:
        few, many = many, 2 * many
        if many > LONGEST * steps or many * pairs > MUCH:
            return None
    while many - few > 1:
        middle = (few + many) // 2
        few, many = (few, middle) if _lacking(mission, middle) is None else (middle, many)
    return many


def _strong(mission: Reconfiguration, steps: int) -> str | None:
    def does(thrust: float) -> bool:
        return _lacking(replace(mission, max_control=thrust), steps) is None

    weak, strong = mission.max_control, 2 * mission.max_control
    while not does(strong):
        weak, strong = strong, 2 * strong
        if strong > STRONGEST * mission.max_control:
            return None
    while strong > weak * FINE:
        middle = (weak * strong) ** 0.5
        weak, strong = (weak, middle) if does(middle) else (middle, strong)
    return upward(strong)


def _lacking(mission: Reconfiguration, steps: int) -> Lacking | None:
    live, spare = _starting(mission)
    wanted = max(mission.target_count, len(live) - spare)
    reachable = _reachable(
        mission, mission.initial_states[live], mission.legs[0].targets[:wanted], steps
    )
    nowhere = np.flatnonzero(~reachable.any(axis=1))
    if nowhere.size > spare:
        return Lacking(int(live[nowhere[0]]), True)
    matched = maximum_bipartite_matching(csr_array(reachable), perm_type="column")
    left = np.flatnonzero(matched < 0)
    return Lacking(int(live[left[0]]), False) if left.size > spare else None


def _starting(mission: Reconfiguration) -> tuple[Int[Array, " live"], int]:
    # Who begins the first leg, and how many of them at least are lost before it, yet unnamed.
    alive, spare = mission.alive.copy(), 0
    for loss in (loss for loss in mission.legs[0].losses if loss.at_step == 0):
        alive[list(loss.agents)] = False
        spare += floor(loss.share * (alive.sum() - spare))
    return np.flatnonzero(alive), spare


def _reachable(
    mission: Reconfiguration, start: Float[Array, "k n"], goals: Float[Array, "m n"], steps: int
) -> Bool[Array, "k m"]:
    held = discretize_zoh(mission.linear_model, mission.step, steps)
    # The box of r = ∞ holds the other norms' balls: what is out of its reach is out of theirs.
    reachable = compute_transfer_costs(held, start, goals, mission.max_control).is_reachable
    if isinstance(mission.linear_model, DoubleIntegrator) and mission.max_speed < inf:
        reachable &= _least_time(mission, start, goals) <= steps * mission.step * (1 + 1e-9)
    return np.asarray(reachable)


def _least_time(
    mission: Reconfiguration, start: Float[Array, "k n"], goals: Float[Array, "m n"]
) -> Float[Array, "k m"]:
    # Along the straight line from start to goal, a point that is no faster than V and, where it
    # starts at rest, no stronger than the box is in that direction: a bound from below.
    d = mission.linear_model.axes
    way = goals[None, :, :d] - start[:, None, :d]
    far = np.linalg.norm(way, axis=2)
    V = mission.max_speed
    strength = mission.max_control * np.abs(way).sum(axis=2) / np.where(far > 0, far, 1.0)
    strength = np.where(far > 0, strength, 1.0)
    trapezium = np.where(
        far * strength >= V**2, far / V + V / strength, 2 * np.sqrt(far / strength)
    )
    at_rest = ~start[:, None, d:].any(axis=2)
    return np.asarray(np.where(at_rest, trapezium, far / V))
