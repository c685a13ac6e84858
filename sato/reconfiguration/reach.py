"""Reach of targets in a number of steps: what is refused, and how many steps are enough."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment

from sato.reconfiguration.departure import Departure, count_wanted, depart_leg, room_at_start
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.pair_reach import (
    are_at_rest,
    bound_controls,
    bound_reach,
    can_transfer,
    find_unmatched,
    group_alike,
    is_surely_reached,
)
from sato.scenario.errors import InputError, join_names, round_up

MAX_TIME_FACTOR = 64  # times the steps that were asked for; beyond, time is not what is missing
MAX_CONTROL_FACTOR = 64  # times the control that there is
CONTROL_PRECISION = 1.01  # relative, of the control that would do
MAX_PAIRS_TIMES_STEPS = 20_000_000  # above which no longer time is tried
MAX_ENERGY_STEPS = 500  # above which the matrices of the least energy are too large
MAX_SOLVES = 300  # transfers solved one by one, where no bound decides


def check_reach(mission: Reconfiguration) -> None:
    """Refuse a drawn mission in which an agent cannot reach a target, whatever the others do.

    Raises:
        InputError: An agent can reach none of the targets that it bids on, or too few of them
            can be reached for every agent to have one; says for which agent, and what time or
            control would do.
    """
    for number, leg in enumerate(mission.legs):
        if departure := depart_leg(mission, number):
            _check_leg(number, departure, leg.targets[: count_wanted(mission, number)])


def _check_leg(number: int, departure: Departure, targets: Float[Array, "k n"]) -> None:
    mission = departure.mission
    steps, control = mission.legs[number].steps, float(mission.largest_control.max())
    room = 1.0 if number == 0 else room_at_start(departure, steps)
    fault = find_stranded(departure, targets, steps, room)
    if fault is None:
        return
    longest = min(MAX_TIME_FACTOR * steps, _longest(departure, targets))
    bounds = cache(partial(bound_controls, departure, targets))

    def is_enough(steps: float, factor: float = 1.0) -> bool:
        return find_stranded(departure, targets, int(steps), factor, bounds) is None

    time = _find_least(is_enough, steps, longest)
    factor = _find_least(lambda f: is_enough(steps, f), 1.0, MAX_CONTROL_FACTOR, CONTROL_PRECISION)
    cures = [f"steps = {time}"] if time else []
    if factor and isinstance(mission.max_control, float | int):
        cures.append(f"model.max_control_m_s2 = {round_up(factor * control)}")
    elif factor:
        cures.append(f"{round_up(factor)} times the limits of the control")
    within, slow = f"in {steps} steps of {mission.step:g} s", mission.slow_speed
    if slow is not None:
        within += f", at {slow:.3g} m/s, from which vehicles stop before they meet others unheard"
        fast = departure._replace(mission=replace(mission, allow_undetectable=True))
        if find_stranded(fast, targets, steps, room) is None:
            cures.append(f"swarm.comm_radius_m = {round_up(mission.radius_for_full_speed)}")
    cures = cures or ["far more steps, a larger model.max_control_m_s2 or max_speed_m_s"]
    raise InputError(f"leg.{number}.steps", f"{fault} {within}; {join_names(cures)} would do")


def find_least_steps(
    where: str, departure: Departure, targets_after: Callable[[int], Float[Array, "targets n"]]
) -> int:
    """Find the least number of steps in which each vehicle can arrive, without the others.

    A search by bisection: with one step less some vehicle cannot.

    Args:
        where: Key of the steps, for the error.
        departure: Vehicles at the start of the leg.
        targets_after: States to reach after a number of steps.

    Raises:
        InputError: No number of steps is enough.
    """

    def is_enough(steps: float) -> bool:
        targets = targets_after(int(steps))
        return find_stranded(departure, targets, int(steps)) is None

    longest = _longest(departure, targets_after(1))
    least = 1 if is_enough(1) else _find_least(is_enough, 1, longest)
    if least is None:
        reason = f"no time of up to {longest} steps is enough for all to reach targets"
        raise InputError(where, f"{reason}; a larger model.max_control_m_s2 would do")
    return int(least)


def _longest(departure: Departure, targets: Float[Array, "targets n"]) -> int:
    each = 1 if departure.mission.assignment == "given" else len(targets)
    return max(1, MAX_PAIRS_TIMES_STEPS // max(1, len(departure.agents) * each))


def _find_least(
    does: Callable[[float], bool], low: float, most: float, precision: float | None = None
) -> float | None:
    # The least value above one that does not do: a whole number, or with a relative precision.
    high = min(2 * low, most)
    while not does(high):
        if high >= most:
            return None
        low, high = high, min(2 * high, most)
    while high - low > 1 if precision is None else high > low * precision:
        middle = (low + high) // 2 if precision is None else (low * high) ** 0.5
        low, high = (low, middle) if does(middle) else (middle, high)
    return high


def find_stranded(
    departure: Departure,
    targets: Float[Array, "targets n"],
    steps: int,
    factor: float = 1.0,
    bounds: Callable[[int], Array] | None = None,
) -> str | None:
    """Say which agent has no target that it can reach, and why; None where each has one.

    The factor is of all limits of the control.

    Bounds decide most pairs. Of the others, transfers are solved one by one, as far as an
    assignment depends on them, up to `MAX_SOLVES`; beyond, they are taken as possible.
    """
    is_short, least = steps <= MAX_ENERGY_STEPS, None
    if not are_at_rest(departure, targets):
        if is_short and is_surely_reached(departure, targets, steps, factor):
            return None
        least = (bounds or partial(bound_controls, departure, targets))(steps)
    agents, spare = departure.agents, departure.spare
    names = departure.names or [f"agent {i}" for i in agents]
    possible, sure = np.zeros((2, len(agents), len(targets)), dtype=bool)
    for rows in group_alike(departure, factor):
        part, own = departure.select(rows), None if least is None else least[rows]
        possible[rows], sure[rows] = bound_reach(part, targets, steps, factor, own)
    if departure.mission.assignment == "given":
        is_own = agents[:, None] == np.arange(len(targets))
        possible, sure = possible & is_own, sure & is_own
    solves = 0
    while True:
        none = np.flatnonzero(~possible.any(axis=1))
        if len(none) > departure.lost:
            return f"{names[none[0]]} can reach none of its targets"
        unsure = np.flatnonzero(~sure.any(axis=1))
        if find_unmatched(sure).sum() <= spare and len(unsure) <= departure.lost:
            return None
        if (left := find_unmatched(possible)).sum() > spare:
            why = "for the others need all that it can reach,"
            return f"{names[np.flatnonzero(left)[0]]} is left without a target, {why}"
        doubt = np.where(sure, 0, np.where(possible, 1, 1 + len(agents)))
        pairs = np.transpose(linear_sum_assignment(doubt)).tolist()
        if spare > departure.lost:  # some share targets, and each has to reach one
            pairs += [(i, int(possible[i].argmax())) for i in unsure]
        for i, j in pairs:
            if possible[i, j] and not sure[i, j]:
                if solves == MAX_SOLVES:
                    return None
                one = departure.select(np.array([i]))
                possible[i, j] = sure[i, j] = can_transfer(one, targets[j], steps, factor)
                solves += 1
                if not possible[i].any():
                    break
