"""Reach of targets in a number of steps: what is refused, and how many steps are enough."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment

from sato.reconfiguration import pair_reach
from sato.reconfiguration.departure import Departure, count_wanted, depart_leg, room_at_start
from sato.reconfiguration.mission import Reconfiguration
from sato.scenario.errors import InputError, join_names, round_up

MAX_TIME_FACTOR = 64  # times the steps that were asked for; beyond, time is not what is missing
MAX_CONTROL_FACTOR = 64  # times the control that there is
CONTROL_PRECISION = 1.01  # relative, of the control that would do
MAX_PAIRS_TIMES_STEPS = 20_000_000  # above which no longer time is tried
MAX_ENERGY_STEPS = 500  # above which the matrices of the least energy are too large
CHECK_TIME = 4.0  # of programs that refuse a mission, in all [s]
SEARCH_TIME = 1.5  # of programs that look for the time, or for the control, that would do [s]
AUTOMATIC_TIME = 6.0  # of programs that look for the automatic steps of a leg [s]

TargetsAfter = Callable[[int], Float[Array, "targets n"]]  # states to reach in so many steps


def check_reach(
    mission: Reconfiguration, targets_after: Callable[[int, int], Array] | None = None
) -> None:
    """Refuse a drawn mission in which an agent cannot reach a target, whatever the others do.

    Or too few targets can be reached for every agent to have one. Where neither bounds nor the
    programs of some seconds decide, the mission is not refused. What would do is found by bounds
    and such programs too, and proven: less may be enough. States to reach in a leg are given after
    a number of steps, where they depend on it.
    """
    budget = pair_reach.Budget(CHECK_TIME)
    for number, leg in enumerate(mission.legs):
        if departure := depart_leg(mission, number):
            wanted = leg.targets[: count_wanted(mission, number)]
            after = partial(targets_after, number) if targets_after else lambda _, y=wanted: y
            _check_leg(number, departure, wanted, after, budget)


def _check_leg(
    number: int,
    departure: Departure,
    targets: Float[Array, "k n"],
    targets_after: TargetsAfter,
    budget: pair_reach.Budget,
) -> None:
    mission, departure = departure.mission, departure._replace(last={})
    steps, control = mission.legs[number].steps, float(mission.largest_control.max())
    room = 1.0 if number == 0 else room_at_start(departure, steps)
    try:
        fault = find_stranded(departure, targets, steps, room, budget=budget)
    except pair_reach.Unstable as error:
        reason = f"is so unstable that rounding decides what {steps} steps of leg {number} do"
        raise InputError("model", f"{reason}; fewer steps would do") from error
    except pair_reach.Undecided:
        return
    if fault is None:
        return
    longest = min(MAX_TIME_FACTOR * steps, _longest(departure, targets))
    timed = _Search(departure, targets_after, SEARCH_TIME)

    def is_time_enough(steps: float) -> bool:
        try:
            return timed.is_enough(steps)
        except InputError:  # no velocity keeps vehicles at the targets then
            return False

    time = _find_least(is_time_enough, steps, longest)
    search = _Search(departure, lambda _: targets, SEARCH_TIME)
    factor = _find_least(
        lambda f: search.is_enough(steps, f), 1.0, MAX_CONTROL_FACTOR, CONTROL_PRECISION
    )
    cures = [f"steps = {time}"] if time else []
    if factor and isinstance(mission.max_control, float | int):
        cures.append(f"model.max_control_m_s2 = {round_up(factor * control)}")
    elif factor:
        cures.append(f"{round_up(factor)} times the limits of the control")
    within, slow = f"in {steps} steps of {mission.step:g} s", mission.slow_speed
    if slow is not None:
        within += f", at {slow:.3g} m/s, from which vehicles stop before they meet others unheard"
        fast = departure._replace(mission=replace(mission, allow_undetectable=True), last={})
        if _Search(fast, lambda _: targets, SEARCH_TIME).is_enough(steps, room):
            cures.append(f"{mission.reaching_key} = {round_up(mission.radius_for_full_speed)}")
    where = f"leg.{number}.steps"
    if cures:
        raise InputError(where, f"{fault} {within}; {join_names(cures)} would do")
    most = f"neither up to {longest} steps nor up to {MAX_CONTROL_FACTOR} times the control"
    nearer = "targets that are nearer, or a larger model.max_speed_m_s, may do"
    raise InputError(where, f"{fault} {within}; {most} is found to be enough; {nearer}")


class _Search:
    """Search for what is enough, within a budget: what is not decided does not count as enough."""

    def __init__(self, departure: Departure, targets_after: TargetsAfter, seconds: float) -> None:
        self.departure, self.targets_after = departure, targets_after
        self.budget = pair_reach.Budget(seconds)
        self.bounds = cache(
            lambda steps: pair_reach.bound_controls(departure, targets_after(steps), steps)
        )

    def is_enough(self, steps: float, factor: float = 1.0, trusts_bounds: bool = False) -> bool:
        steps, departure, mission = int(steps), self.departure, self.departure.mission
        try:
            each = pair_reach.STEP_TIME[mission.linear_model.is_time_invariant]
            if mission.chief is not None:  # in the time of which targets move
                self.budget.spend(max(pair_reach.ORBIT_TIME, each) * steps)
            targets = self.targets_after(steps)
            if mission.chief is None and not pair_reach.are_at_rest(departure, targets):
                self.budget.spend(each * steps)
            own = steps, factor, self.bounds, self.budget
            return find_stranded(departure, targets, *own) is None
        except pair_reach.Undecided as undecided:
            return trusts_bounds and undecided.is_too_large


def find_least_steps(where: str, departure: Departure, targets_after: TargetsAfter) -> int:
    """Find the least number of steps in which each vehicle can arrive, without the others.

    A search by bisection: with one step less some vehicle cannot, or it takes too long to tell
    that it can.

    Args:
        where: Key of the steps, for the error.
        departure: Vehicles at the start of the leg.
        targets_after: States to reach after a number of steps.

    Raises:
        InputError: No number of steps is enough.
    """
    search = _Search(departure._replace(last={}), targets_after, AUTOMATIC_TIME)
    longest = _longest(departure, targets_after(1))
    is_enough = partial(search.is_enough, trusts_bounds=True)
    least = 1 if is_enough(1) else _find_least(is_enough, 1, longest)
    if least is None:
        reason = f"no time of up to {longest} steps is found to be enough for all to reach targets"
        raise InputError(
            where, f"{reason}; a larger model.max_control_m_s2 or max_speed_m_s may do"
        )
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
    bounds: Callable[[int], Float[Array, "2 k targets"]] | None = None,
    budget: pair_reach.Budget | None = None,
) -> str | None:
    """Say which agent has no target that it can reach, and why; None where each has one.

    The factor is of all limits of the control. Bounds decide most pairs. Of the others, transfers
    are solved one by one, as far as an assignment depends on them, and as the budget allows;
    Undecided where more would be needed.
    """
    budget = budget or pair_reach.Budget(CHECK_TIME)
    is_short, given = steps <= MAX_ENERGY_STEPS, None
    if not pair_reach.are_at_rest(departure, targets):
        pair_reach.check_growth(departure, steps)
        if is_short and pair_reach.is_surely_reached(departure, targets, steps, factor):
            return None
        given = (bounds or partial(pair_reach.bound_controls, departure, targets))(steps)
    agents, spare = departure.agents, departure.spare
    names = departure.names or [f"agent {i}" for i in agents]
    possible, sure = np.zeros((2, len(agents), len(targets)), dtype=bool)
    for rows in pair_reach.group_alike(departure, factor):
        part, own = departure.select(rows), None if given is None else given[:, rows]
        possible[rows], sure[rows] = pair_reach.bound_reach(part, targets, steps, factor, own)
    if departure.mission.assignment == "given":
        is_own = agents[:, None] == np.arange(len(targets))
        possible, sure = possible & is_own, sure & is_own
    has_many = departure.mission.assignment != "given" and pair_reach.is_too_large(possible, steps)
    while True:
        none = np.flatnonzero(~possible.any(axis=1))
        if len(none) > departure.lost:
            return f"{names[none[0]]} can reach none of its targets"
        unsure = np.flatnonzero(~sure.any(axis=1))
        if pair_reach.find_unmatched(sure).sum() <= spare and len(unsure) <= departure.lost:
            return None
        if (left := pair_reach.find_unmatched(possible)).sum() > spare:
            why = "for the others need all that it can reach,"
            return f"{names[np.flatnonzero(left)[0]]} is left without a target, {why}"
        if has_many and given is not None:
            raise pair_reach.Undecided(is_too_large=True)
        doubt = np.where(sure, 0, np.where(possible, 1, 1 + len(agents)))
        pairs = np.transpose(linear_sum_assignment(doubt)).tolist()
        if spare > departure.lost:  # some share targets, and each has to reach one
            pairs += [(i, int(possible[i].argmax())) for i in unsure]
        for i, j in pairs:
            if possible[i, j] and not sure[i, j]:
                alone = departure.select(np.array([i]))
                possible[i, j] = sure[i, j] = budget.solve(alone, targets[j], steps, factor)
                if not possible[i].any():
                    break
