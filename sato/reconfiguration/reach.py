"""Reach of targets in a number of steps: what is refused, and how many steps are enough."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from sato.reconfiguration.departure import Departure, count_wanted, depart_leg, room_at_start
from sato.scenario.errors import InputError, join_names, round_up

if TYPE_CHECKING:
    from sato.reconfiguration.mission import Reconfiguration

MAX_TIME_FACTOR = 64  # times the steps that were asked for; beyond, time is not what is missing
MAX_CONTROL_FACTOR = 64  # times the control that there is
CONTROL_PRECISION = 1.01  # relative, of the control that would do
MAX_PAIRS_TIMES_STEPS = 20_000_000  # above which no longer time is tried
MAX_SOLVED_PAIRS_TIMES_STEPS = 100_000  # above which bounds alone decide
MAX_ENERGY_STEPS = 500  # above which the matrices of the least energy are too large
MAX_SOLVES = 300  # transfers solved one by one, where no bound decides


def check_reach(mission: "Reconfiguration") -> None:
    """Refuse a drawn mission in which an agent cannot reach a target, whatever the others do.

    Raises:
        InputError: An agent can reach none of the targets that it bids on, or too few of them
            can be reached for every agent to have one; says for which agent, and what time or
            control would do.
    """
    for number, leg in enumerate(mission.legs):
        if departure := depart_leg(mission, number):
            _check_leg(mission, number, departure, leg.targets[: count_wanted(mission, number)])


def _check_leg(
    mission: "Reconfiguration", number: int, departure: Departure, targets: Float[Array, "k n"]
) -> None:
    steps, control = mission.legs[number].steps, float(mission.largest_control.max())
    room = 1.0 if number == 0 else room_at_start(mission, departure, steps)
    fault = find_stranded(mission, departure, targets, steps, room)
    if fault is None:
        return
    longest = min(MAX_TIME_FACTOR * steps, _longest(departure, targets))
    bounds = cache(lambda steps: _bound_controls(mission, departure, targets, steps))

    def is_enough(steps: float, factor: float = 1.0) -> bool:
        return find_stranded(mission, departure, targets, int(steps), factor, bounds) is None

    time = _find_least(is_enough, steps, longest)
    factor = _find_least(lambda f: is_enough(steps, f), 1.0, MAX_CONTROL_FACTOR, CONTROL_PRECISION)
    cures = [f"steps = {time}"] if time else []
    if factor and isinstance(mission.max_control, float | int):
        cures.append(f"model.max_control_m_s2 = {round_up(factor * control)}")
    elif factor:
        cures.append(f"{round_up(factor)} times the limits of the control")
    cures = cures or ["far more steps, a larger model.max_control_m_s2 or max_speed_m_s"]
    within = f"in {steps} steps of {mission.step:g} s"
    raise InputError(f"leg.{number}.steps", f"{fault} {within}; {join_names(cures)} would do")


def find_least_steps(
    mission: "Reconfiguration",
    where: str,
    departure: Departure,
    targets_after: Callable[[int], Float[Array, "targets n"]],
) -> int:
    """Find the least number of steps in which each vehicle can arrive, without the others.

    A search by bisection: with one step less some vehicle cannot.

    Args:
        mission: Model and limits.
        where: Key of the steps, for the error.
        departure: Vehicles at the start of the leg.
        targets_after: States to reach after a number of steps.

    Raises:
        InputError: No number of steps is enough.
    """

    def is_enough(steps: float) -> bool:
        targets = targets_after(int(steps))
        return find_stranded(mission, departure, targets, int(steps)) is None

    longest = _longest(departure, targets_after(1))
    least = 1 if is_enough(1) else _find_least(is_enough, 1, longest)
    if least is None:
        reason = f"no time of up to {longest} steps is enough for all to reach targets"
        raise InputError(where, f"{reason}; a larger model.max_control_m_s2 would do")
    return int(least)


def _longest(departure: Departure, targets: Float[Array, "targets n"]) -> int:
    return MAX_PAIRS_TIMES_STEPS // (len(departure.agents) * len(targets))


def _find_least(
    does: Callable[[float], bool], low: float, most: float, precision: float | None = None
) -> float | None:
    # The least value above one that does not do: a whole number, or with a relative precision.
    high = 2 * low
    while not does(high):
        low, high = high, 2 * high
        if high > most:
            return None
    while high - low > 1 if precision is None else high > low * precision:
        middle = (low + high) // 2 if precision is None else (low * high) ** 0.5
        low, high = (low, middle) if does(middle) else (middle, high)
    return high


def find_stranded(
    mission: "Reconfiguration",
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
    from scipy.optimize import linear_sum_assignment

    at_rest = _are_at_rest(mission, departure.state, targets)
    is_short = not at_rest and steps <= MAX_ENERGY_STEPS
    if is_short and _is_surely_reached(mission, departure, targets, steps, factor):
        return None
    agents, spare = departure.agents, departure.spare
    names = departure.names or [f"agent {i}" for i in agents]
    bounds = bounds or cache(lambda steps: _bound_controls(mission, departure, targets, steps))
    possible, sure = np.zeros((2, len(agents), len(targets)), dtype=bool)
    for rows in mission.group_by_limits(agents):
        part, least = _select(departure, rows), partial(_take, bounds, rows)
        found = _bound_reach(mission, part, targets, steps, factor, least)
        possible[rows], sure[rows] = found
    if mission.assignment == "given":
        is_own = agents[:, None] == np.arange(len(targets))
        possible, sure = possible & is_own, sure & is_own
    solves = 0
    while True:
        none = np.flatnonzero(~possible.any(axis=1))
        if len(none) > departure.lost:
            return f"{names[none[0]]} can reach none of its targets"
        unsure = np.flatnonzero(~sure.any(axis=1))
        if _find_unmatched(sure).sum() <= spare and len(unsure) <= departure.lost:
            return None
        if (left := _find_unmatched(possible)).sum() > spare:
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
                one = _select(departure, np.array([i]))
                possible[i, j] = sure[i, j] = _can_transfer(mission, one, targets[j], steps, factor)
                solves += 1


def _are_at_rest(mission: "Reconfiguration", start: Array, targets: Array) -> bool:
    # Then closed forms decide.
    d = mission.axes
    return mission.is_point_mass and not start[:, d:].any() and not targets[:, d:].any()


def _is_surely_reached(
    mission: "Reconfiguration",
    departure: Departure,
    targets: Float[Array, "targets n"],
    steps: int,
    factor: float,
) -> bool:
    """Return True where the transfers of least energy in all keep the limits of their agents."""
    from scipy.optimize import linear_sum_assignment

    from dynamics.discretize import discretize_zoh

    agents, state, given = departure.agents, departure.state, mission.assignment == "given"
    model = discretize_zoh(mission.linear_model, mission.step, steps, departure.time)
    if len(targets) < (agents.max() + 1 if given else len(agents)):
        return False
    transfer = mission.make_transfer(model, int(agents[0]))
    factor_of_reach = transfer.response_matrices[1]  # energy is the square of L⁻¹ b
    ends = np.linalg.solve(factor_of_reach, np.vstack([targets, transfer.coast(state)[:, -1]]).T).T
    goals, free = ends[: len(targets)], ends[len(targets) :]
    energy = ((goals[None] - free[:, None]) ** 2).sum(axis=2)
    held = agents if given else linear_sum_assignment(energy)[1]
    for rows in mission.group_by_limits(agents):
        transfer = mission.make_transfer(model, int(agents[rows[0]]))
        transfer = replace(transfer, max_control=factor * transfer.max_control)
        if not transfer.solve_without_limits(state[rows], targets[held[rows]])[2].all():
            return False
    return True


def _take(bounds: Callable[[int], Array], rows: Int[Array, " k"], steps: int) -> Array:
    return np.asarray(bounds(steps)[rows])


def _select(departure: Departure, rows: Int[Array, " k"]) -> Departure:
    return departure._replace(agents=departure.agents[rows], state=departure.state[rows])


def _find_unmatched(reachable: Bool[Array, "k targets"]) -> Bool[Array, " k"]:
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import maximum_bipartite_matching

    return np.asarray(maximum_bipartite_matching(csr_array(reachable), perm_type="column") < 0)


def _bound_reach(
    mission: "Reconfiguration",
    departure: Departure,
    targets: Float[Array, "targets n"],
    steps: int,
    factor: float,
    bounds: Callable[[int], Array],
) -> tuple[Bool[Array, "k targets"], Bool[Array, "k targets"]]:
    """Return the pairs that may be within reach, and those that certainly are.

    The vehicles have equal limits. Where there are more than `MAX_SOLVED_PAIRS_TIMES_STEPS`,
    bounds alone decide, and pairs that are possible count as certain.
    """
    start, d, h, agent = departure.state, mission.axes, mission.step, int(departure.agents[0])
    control, speed = mission.control_limit(agent), mission.speed_limit(agent)
    starts_at_rest = ~start[:, d:].any(axis=1, keepdims=True)
    ends = 1.0 * starts_at_rest + ~targets[:, d:].any(axis=1)
    way = np.abs(targets[None, :, :d] - start[:, None, :d])
    far = np.linalg.norm(way, axis=2)
    # The most of a vector along a direction is that of the dual norm; less on a straight line.
    unit = way / np.where(far > 0, far, 1.0)[..., None] + (far == 0)[..., None] * np.eye(d)[0]
    most, V = factor * control.most_along(unit), speed.most_along(unit)
    if _are_at_rest(mission, start, targets):
        strength = factor * control.most / control.measure(unit)
        line = _farthest(strength, steps, h, speed.most / speed.measure(unit))
        widest = factor * control.most / (unit / control.shares).max(axis=2)
        box = _farthest(widest, steps, h, np.full_like(far, inf))
        limit = far / (1 + 1e-9)
        return (limit <= box) & (limit <= _farthest(most, steps, h, V)), limit <= line
    from dynamics.discretize import discretize_zoh
    from problems.auction_cost import compute_transfer_costs
    from problems.transfer import TransferProblem

    # The box of r = ∞ contains the balls of the other norms: out of its reach is out of theirs.
    possible = bounds(steps) <= factor * control.most * (1 + 1e-9)
    if _find_unmatched(possible).sum() > departure.spare:
        return possible, np.zeros_like(possible)
    if possible.size * steps > MAX_SOLVED_PAIRS_TIMES_STEPS:
        return possible, possible
    model = discretize_zoh(mission.linear_model, h, steps, departure.time)
    transfer = TransferProblem(model, factor * control.bound, speed.bound, speed_norm=speed.norm)
    found = compute_transfer_costs(transfer, start, targets)
    possible, sure = found.is_reachable.copy(), found.is_reachable & found.is_exact
    if mission.is_point_mass and speed.most < inf:
        # In continuous time, from rest or to rest at one end, or at speed at both.
        at_full_speed, below = far / V + ends * V / (2 * most), np.sqrt(2 * ends * far / most)
        least_time = np.where(2 * far * most >= ends * V**2, at_full_speed, below)
        possible &= least_time <= steps * h * (1 + 1e-9)
    return possible, sure & possible & (mission.control_norm == "inf")


def _bound_controls(
    mission: "Reconfiguration", departure: Departure, targets: Float[Array, "targets n"], steps: int
) -> Float[Array, "k targets"]:
    """Compute lower bounds of the control that each pair takes, without the speed limit."""
    from dynamics.discretize import discretize_zoh
    from problems.auction_cost import compute_displacements
    from problems.reach import bound_least_controls

    model = discretize_zoh(mission.linear_model, mission.step, steps, departure.time)
    b = compute_displacements(model, departure.state, targets)
    lower = bound_least_controls(model, b.reshape(-1, b.shape[2]))
    return np.asarray(lower.reshape(b.shape[:2]))


def _farthest(
    a: Float[Array, "*k"], steps: int, h: float, V: Float[Array, "*k"]
) -> Float[Array, "*k"]:
    """Compute the longest way on a line from rest to rest, a held for each step [m].

    The speed after k steps is at most min(k a h, (steps − k) a h, V).
    """
    ramp = np.minimum(np.floor(V / (a * h)), steps)  # steps until V
    with_coast = a * h * ramp * (ramp + 1) + V * (steps - 1 - 2 * ramp)
    return np.asarray(h * np.where(ramp >= steps // 2, a * h * (steps**2 // 4), with_coast))


def _can_transfer(
    mission: "Reconfiguration",
    departure: Departure,
    target: Float[Array, " n"],
    steps: int,
    factor: float,
) -> bool:
    from dynamics.discretize import discretize_zoh
    from problems.auction_cost import solve_transfer

    model = discretize_zoh(mission.linear_model, mission.step, steps, departure.time)
    transfer = mission.make_transfer(model, int(departure.agents[0]))
    transfer = replace(transfer, max_control=factor * transfer.max_control)
    return solve_transfer(transfer, departure.state[0], target) is not None
