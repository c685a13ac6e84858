"""Reach of targets by vehicles that are alone: bounds for all pairs, and single transfers."""

from collections.abc import Iterator
from math import inf, isfinite

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from dynamics.discretize import DiscreteModel
from problems.auction_cost import compute_displacements, compute_transfer_costs, solve_transfer
from problems.limit import Limit
from problems.reach import bound_least_controls
from problems.transfer import TransferProblem
from sato.reconfiguration.departure import Departure

MAX_SOLVED_PAIRS_TIMES_STEPS = 100_000  # above which bounds alone decide
PROGRAM_TIME = 2e-3, 5e-5, 4e-7, 6e-10  # of a program, by powers of its steps [s]
LINEAR = 0.15  # of the time of a program with cones,
LINEAR_STEPS = 500  # up to so many steps; beyond, both take their time to be assembled
INFEASIBLE = 5  # times as long it takes in addition to tell that there is no transfer
SPEED_TIME = 1.5e-7  # of a cubed step, to tell that none keeps a speed limit, at worst [s]
STEP_TIME = 4e-4, 1.2e-5  # of a step of a model, that changes with time and that does not [s]
ORBIT_TIME = 1e-4  # of a step of a chief on its orbit [s]
MOST_GROWTH = 1e12  # of a unit state, beyond which transfers are lost in rounding
MAX_PAIRS = 20_000  # of vehicles and targets that are compared at once


class Undecided(Exception):
    """Bounds do not tell whether targets are within reach, and no more programs are allowed."""

    def __init__(self, is_too_large: bool) -> None:
        super().__init__()
        self.is_too_large = is_too_large  # for programs of single transfers at all


class Unstable(Undecided):
    """Free motion grows so much that rounding would decide."""


def check_growth(departure: Departure, steps: int) -> None:
    """Raise `Unstable` where the free motion of unit states grows too much in some steps."""
    model = departure.discretize(steps)
    with np.errstate(over="ignore", invalid="ignore"):
        free = model.coast_to_end(np.vstack([np.zeros(2 * model.axes), np.eye(2 * model.axes)]))
        growth = np.abs(free[1:] - free[0]).max()
    if not growth < MOST_GROWTH:
        raise Unstable(is_too_large=False)


class Budget:
    """Time that programs of transfers may take on a common machine, however long it is on others.

    The answer of a search is the same on all of them.
    """

    def __init__(self, seconds: float) -> None:
        self._left = seconds

    def spend(self, seconds: float) -> None:
        """Take the time of a computation [s]; raise Undecided where there is less."""
        if seconds > self._left:
            raise Undecided(is_too_large=False)
        self._left -= seconds

    def solve(self, departure: Departure, target: Array, steps: int, factor: float) -> bool:
        """Tell whether an agent can reach a target, by the program of its transfer.

        Undecided where there is less time than that takes.
        """
        seconds = float(np.polynomial.Polynomial(PROGRAM_TIME)(steps))
        refusal = INFEASIBLE * seconds
        if isfinite(_speed_limit(departure, factor).most) and not departure.mission.is_point_mass:
            refusal = max(refusal, SPEED_TIME * steps**3)
            if refusal > self._left:
                raise Undecided(is_too_large=False)
        is_short = departure.mission.control_norm == "inf" and steps <= LINEAR_STEPS
        self.spend(seconds * (LINEAR if is_short else 1.0))
        transfer = _make_transfer(departure, departure.discretize(steps), factor)
        is_reachable = solve_transfer(transfer, departure.state[0], target) is not None
        if not is_reachable:
            self._left -= refusal
        return is_reachable


def is_surely_reached(
    departure: Departure, targets: Float[Array, "targets n"], steps: int, factor: float
) -> bool:
    """Return True where the transfers of least energy in all keep the limits of their agents."""
    agents, state, model = departure.agents, departure.state, departure.discretize(steps)
    given = departure.mission.assignment == "given"
    if len(targets) < (agents.max() + 1 if given else len(agents)):
        return False
    transfer = _make_transfer(departure, model, factor)
    factor_of_reach = transfer.response_matrices[1]  # energy is the square of L⁻¹ b
    ends = np.linalg.solve(factor_of_reach, np.vstack([targets, transfer.coast(state)[:, -1]]).T).T
    goals, free = ends[: len(targets)], ends[len(targets) :]
    energy = ((goals[None] - free[:, None]) ** 2).sum(axis=2)
    held = agents if given else linear_sum_assignment(energy)[1]
    for rows in group_alike(departure, factor):
        transfer = _make_transfer(departure.select(rows), model, factor)
        if not transfer.solve_without_limits(state[rows], targets[held[rows]])[2].all():
            return False
    return True


def bound_reach(
    departure: Departure,
    targets: Float[Array, "targets n"],
    steps: int,
    factor: float,
    bounds: Float[Array, "2 k targets"] | None,
) -> tuple[Bool[Array, "k targets"], Bool[Array, "k targets"]]:
    """Return the pairs that may be within reach, and those that certainly are.

    The vehicles have equal limits. Lower and upper bounds of the control that pairs take [m/s²] are
    given, unless all are at rest. Where there are more than `MAX_SOLVED_PAIRS_TIMES_STEPS`, bounds
    alone decide. Given targets of vehicles in motion are left to single transfers.
    """
    mission, start, agent = departure.mission, departure.state, int(departure.agents[0])
    d, h, speed = mission.axes, mission.step, _speed_limit(departure, factor)
    control = mission.planned_control_limit(agent)
    if bounds is None or are_at_rest(departure, targets):
        count = max(1, MAX_PAIRS // max(1, len(targets)))  # few enough to stay in the cache
        parts = [
            _bound_at_rest(some, targets[:, :d], steps, h, factor, control, speed)
            for some in np.split(start[:, :d], range(count, len(start), count))
        ]
        possible, sure = (np.concatenate(each) for each in zip(*parts, strict=True))
        return possible, sure
    lower, upper = bounds
    possible = lower <= factor * control.most * (1 + 1e-9)
    sure = possible & (upper * (1 + 1e-9) <= factor * control.most) & (speed.most == inf)
    if mission.is_point_mass and speed.most < inf:
        starts_at_rest = ~start[:, d:].any(axis=1, keepdims=True)
        ends = 1.0 * starts_at_rest + ~targets[:, d:].any(axis=1)
        far, unit = _directions(start[:, :d], targets[:, :d])
        most, V = factor * control.most_along(unit), speed.most_along(unit)
        # In continuous time, from rest or to rest at one end, or at speed at both.
        at_full_speed, below = far / V + ends * V / (2 * most), np.sqrt(2 * ends * far / most)
        least_time = np.where(2 * far * most >= ends * V**2, at_full_speed, below)
        possible &= least_time <= steps * h * (1 + 1e-9)
    if mission.assignment == "given" or find_unmatched(possible).sum() > departure.spare:
        return possible, sure
    if is_too_large(possible, steps) or sure[possible].all():
        return possible, sure
    model = departure.discretize(steps)
    transfer = TransferProblem(model, factor * control.bound, speed.bound, speed_norm=speed.norm)
    found = compute_transfer_costs(transfer, start, targets)
    possible &= found.is_reachable
    sure |= found.is_exact & (mission.control_norm == "inf")
    return possible, possible & sure


def is_too_large(pairs: Bool[Array, "k targets"], steps: int) -> bool:
    """Tell whether pairs are too many, over so many steps, for programs of single transfers."""
    return pairs.size * steps > MAX_SOLVED_PAIRS_TIMES_STEPS


def _bound_at_rest(
    start: Float[Array, "k d"],
    targets: Float[Array, "targets d"],
    steps: int,
    h: float,
    factor: float,
    control: Limit,
    speed: Limit,
) -> tuple[Bool[Array, "k targets"], Bool[Array, "k targets"]]:
    """Return the pairs from rest to rest that may be within reach, and those that certainly are."""
    far, unit = _directions(start, targets)
    # The most of a vector along a direction is that of the dual norm; less on a straight line.
    most, V = factor * control.most_along(unit), speed.most_along(unit)
    strength = factor * control.most / control.measure(unit)
    line = farthest(strength, steps, h, speed.most / speed.measure(unit))
    widest = factor * control.most / (unit / control.shares).max(axis=2)
    box = farthest(widest, steps, h, np.full_like(far, inf))
    limit = far / (1 + 1e-9)
    return (limit <= box) & (limit <= farthest(most, steps, h, V)), limit <= line


def _directions(
    start: Float[Array, "k d"], targets: Float[Array, "targets d"]
) -> tuple[Float[Array, "k targets"], Float[Array, "k targets d"]]:
    """Return the distances of all pairs, and the directions, all axes positive by symmetry."""
    way = np.abs(targets - start[:, None])
    far = np.sqrt(np.einsum("ijd,ijd->ij", way, way))
    unit = way / np.where(far > 0, far, 1.0)[..., None]
    unit[far == 0] = np.eye(start.shape[1])[0]
    return far, unit


def bound_controls(
    departure: Departure, targets: Float[Array, "targets n"], steps: int
) -> Float[Array, "2 k targets"]:
    """Bound the control that each pair takes, without the speed limit, from below and above."""
    model, limit = departure.discretize(steps), departure.mission.control_limits[0]
    b = compute_displacements(model, departure.state, targets)
    bounds = bound_least_controls(model, b.reshape(-1, b.shape[2]), limit)
    return np.reshape(bounds, (2, *b.shape[:2]))


def group_alike(departure: Departure, factor: float) -> Iterator[Int[Array, " k"]]:
    """Group agents that have the same limits, and start faster than they plan to fly or not."""
    mission = departure.mission
    velocity = departure.state[:, mission.axes :]
    for rows in mission.group_by_limits(departure.agents):
        planned = mission.planned_speed_limit(int(departure.agents[rows[0]]), factor)
        is_faster = planned.measure(velocity[rows]) > planned.most
        yield from (part for part in (rows[is_faster], rows[~is_faster]) if len(part))


def find_unmatched(reachable: Bool[Array, "k targets"]) -> Bool[Array, " k"]:
    """Find the agents that are left over where as many as can be get a target of their own."""
    return np.asarray(maximum_bipartite_matching(csr_array(reachable), perm_type="column") < 0)


def are_at_rest(departure: Departure, targets: Float[Array, "targets n"]) -> bool:
    """Tell whether double integrators move from rest to rest, where closed forms decide."""
    d = departure.mission.axes
    moves = departure.state[:, d:].any() or targets[:, d:].any()
    return departure.mission.is_point_mass and not moves


def _make_transfer(departure: Departure, model: DiscreteModel, factor: float) -> TransferProblem:
    mission, agent = departure.mission, int(departure.agents[0])
    speed = _speed_limit(departure, factor)
    most = factor * mission.planned_control_limit(agent).bound
    return mission.make_transfer(model, agent, max_control=most, max_speed=speed.bound)


def _speed_limit(departure: Departure, factor: float) -> Limit:
    """Return the speed limit of the plans of agents, or their own where they start faster."""
    mission = departure.mission
    agent, velocity = int(departure.agents[0]), departure.state[:, mission.axes :]
    planned = mission.planned_speed_limit(agent, factor)
    is_faster = (planned.measure(velocity) > planned.most).any()
    return mission.speed_limit(agent) if is_faster else planned


def farthest(
    a: Float[Array, "*k"], steps: int, h: float, V: Float[Array, "*k"]
) -> Float[Array, "*k"]:
    """Compute the longest way on a line from rest to rest, a held for each step [m].

    The speed after k steps is at most min(k a h, (steps − k) a h, V).
    """
    ramp = np.minimum(np.floor(V / (a * h)), steps)  # steps until V
    with_coast = a * h * ramp * (ramp + 1) + V * (steps - 1 - 2 * ramp)
    return np.asarray(h * np.where(ramp >= steps // 2, a * h * (steps**2 // 4), with_coast))
