"""What one agent does in an exchange [Morgan2016, Method 2].

It hears the paths of its neighbours, keeps clear of those that go before it, and tells
its own.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from problems.avoidance import (
    AvoidanceProblem,
    AvoidanceResult,
    HalfSpaces,
    Relaxation,
    empty_half_spaces,
)
from problems.conic import Unsolved
from problems.convexify import (
    AvoidanceHorizon,
    PassingSide,
    are_balls_separated,
    are_hulls_separated,
    choose_normals,
    convexify,
)
from problems.transfer import Trajectory, TransferProblem

ACTIVE_TOLERANCE = 1e-3  # of R: a half-space with less room than this may bind
VIOLATION_TOLERANCE = (
    1e-7  # of R: a half-space that an answer breaks by more is put into the programme
)
NEARBY_FACTOR = 2.0  # times R: who comes closer has half-spaces from the first
CONVERGENCE_TOLERANCE = 1e-3  # ε_SCP over R: a path that moves less has converged
# Ways past the neighbours where nominals collide, by the axes of space: the cheapest is taken.
PASSING_SIDES: dict[int, tuple[PassingSide, ...]] = {
    2: ("same", "opposite"),
    3: ("same", "opposite", "above", "below"),
}
# Where there is none, what may give way, and about what to convexify: past the neighbours on
# the near side, on the far side, or about standing still. Tried in this order.
RELAXATION_ORDER: tuple[tuple[Relaxation, Literal["same", "opposite", "stop"]], ...] = (
    ("terminal", "same"),
    ("terminal", "opposite"),
    ("terminal", "stop"),
    ("separation", "same"),
)
FEASIBILITY_TOLERANCE = (
    1e-6  # of R: who breaks half-spaces by less keeps clear, who misses by less arrives
)
MAX_SOLVES = 20  # programmes, after which an agent stops improving (Proposition 4 keeps it safe)


class TrajectoryMessage(NamedTuple):
    """What an agent tells its neighbours."""

    priority: tuple[bool, float, int]  # who goes before whom; the smaller goes first
    control_points: Float[Array, "pieces 4 d"]
    is_final: bool


class Planner(NamedTuple):
    """One agent that plans: all that it knows.

    Before the first exchange `flight` is `free`, or the plan that it had, where that went
    another way to keep clear: so it stays on the side on which it passes.
    """

    priority: tuple[bool, float, int]  # (it can still move, −fuel spent, number) [Remark 5]
    target_state: Float[Array, " n"]
    transfer: TransferProblem
    horizon: AvoidanceHorizon
    solo: Trajectory  # its flight if it were alone: iterate 0
    nominal: Trajectory  # the nominal
    control_points: Float[Array, "pieces 4 d"]  # of the nominal, over the horizon
    relinearize: Callable[[Trajectory], TransferProblem] | None = (
        None  # linearises about a nominal; None: no need
    )
    is_final: bool = False
    has_converged: bool = True  # the nominal answered the last programme, or none was needed
    last_inbox: tuple[TrajectoryMessage, ...] = ()  # whom it answered then
    solve_count: int = 0
    terminal_error: float = 0.0  # distance from the goal at the end, where it could not be kept
    slack: float = 0.0  # break of a half-space, where even that could not be kept [m]
    has_failed: bool = False  # no programme had an answer

    @property
    def message(self) -> TrajectoryMessage:
        """What it tells."""
        return TrajectoryMessage(self.priority, self.control_points, self.is_final)

    @property
    def relinearized(self) -> "Planner":
        """The same about its nominal, where its model has to be."""
        if self.relinearize is None:
            return self
        return self._replace(transfer=self.relinearize(self.nominal))

    @property
    def without_tie_break(self) -> "Planner":
        """The same without the slope of its weights, which keeps to one of many equals."""
        return self._replace(transfer=replace(self.transfer, tie_break_rise=0.0))

    def with_nominal(self, flight: Trajectory) -> "Planner":
        """The same with a flight, whose path is what it tells."""
        return self._replace(
            nominal=flight, control_points=self.horizon.control_points(flight.x, flight.u)
        )

    def reaches_target(self, flight: Trajectory) -> bool:
        """Whether a flight ends at its goal."""
        return reaches_target(flight, self.target_state, self.horizon.collision_radius)


def reaches_target(flight: Trajectory, goal: Float[Array, " n"], radius: float) -> bool:
    """Whether a flight ends at a goal."""
    return bool(np.abs(flight.x[-1] - goal).max() <= FEASIBILITY_TOLERANCE * radius)


class AvoidedAgents(NamedTuple):
    """Those whom an agent keeps clear of."""

    control_points: Float[Array, "above pieces 4 d"]
    is_nearby: Bool[Array, " above"]  # who comes near its nominal; the rest need no half-spaces yet

    @classmethod
    def from_messages(cls, agent: Planner, above: tuple[TrajectoryMessage, ...]) -> "AvoidedAgents":
        """Sort out who is near."""
        paths = np.stack([plan.control_points for plan in above])
        far = are_balls_separated(
            agent.control_points - paths, NEARBY_FACTOR * agent.horizon.collision_radius
        )
        return cls(paths, np.asarray(~far.all(axis=1)))

    def find_conflicts(
        self, path: Float[Array, "pieces 4 d"], radius: float
    ) -> Bool[Array, " above"]:
        """Whose path another would meet."""
        return np.asarray(~are_hulls_separated(path - self.control_points, radius).all(axis=1))


def update_planner(agent: Planner, inbox: list[TrajectoryMessage]) -> Planner:
    """One exchange of one agent: hear, plan around those who go before, tell.

    An agent is settled when its path stands still, keeps clear, and all whom it must
    avoid are settled: from then on it cannot change, so agents settle in the order of
    their priorities [Morgan2016, Theorem 8], each by what it heard.
    """
    if agent.is_final:
        return agent
    above = tuple(plan for plan in inbox if plan.priority < agent.priority)
    if needs_solve(agent, above):
        agent = _solve_iteration(agent, above)
    return agent._replace(is_final=agent.has_converged and all(plan.is_final for plan in above))


def needs_solve(agent: Planner, above: tuple[TrajectoryMessage, ...]) -> bool:
    """Whether an agent has a programme to solve: something binds, and it is news."""
    if len(agent.nominal.u) == 0:
        return False
    if follows_solo(agent):
        return not is_clear(agent.control_points, above, agent.horizon.collision_radius)
    heard = len(above) == len(agent.last_inbox) and all(
        np.array_equal(a.control_points, b.control_points)
        for a, b in zip(above, agent.last_inbox, strict=True)
    )
    return not (heard and agent.has_converged)


def follows_solo(agent: Planner) -> bool:
    """Whether an agent flies as if it were alone and has never had reason to ask."""
    return agent.solve_count == 0 and agent.nominal is agent.solo and agent.has_converged


def is_clear(
    path: Float[Array, "pieces 4 d"], above: tuple[TrajectoryMessage, ...], radius: float
) -> bool:
    """Whether a path keeps clear of every other."""
    return not above or bool(
        are_hulls_separated(path - np.stack([p.control_points for p in above]), radius).all()
    )


def _solve_iteration(agent: Planner, above: tuple[TrajectoryMessage, ...]) -> Planner:
    """The next iterate, and whether it stands still."""
    free = agent.horizon.control_points(agent.solo.x, agent.solo.u)
    if is_clear(free, above, agent.horizon.collision_radius):
        after = agent._replace(
            nominal=agent.solo, control_points=free, terminal_error=0.0, slack=0.0, has_failed=False
        )
    else:
        after = _solve_avoidance(agent, above)
    moved = float(np.abs(after.nominal.x - agent.nominal.x).max())
    still = (
        moved <= CONVERGENCE_TOLERANCE * agent.horizon.collision_radius
        or after.solve_count >= MAX_SOLVES
    )
    return after._replace(has_converged=still, last_inbox=above)


def _solve_avoidance(agent: Planner, above: tuple[TrajectoryMessage, ...]) -> Planner:
    """Solve Problem 7 about the nominal; what gives way gives way last to separation."""
    agent = agent.relinearized
    others = AvoidedAgents.from_messages(agent, above)
    collides = not is_clear(agent.control_points, above, agent.horizon.collision_radius)
    ways = PASSING_SIDES[agent.control_points.shape[-1]] if collides else ("same",)
    tried = [solve_around(agent, others, agent.control_points, way) for way in ways]
    passages, solves = [p for p in tried if p is not None], agent.solve_count + len(ways)
    passage = min(passages, key=lambda p: p.trajectory.fuel, default=None)
    if passage is None:
        passage, count = _solve_relaxed(agent, others)
        solves += count
    if passage is None:  # what it tells is what it flies, whatever it began with
        return agent.with_nominal(agent.nominal)._replace(solve_count=solves, has_failed=True)
    return agent.with_nominal(passage.trajectory)._replace(
        solve_count=solves,
        terminal_error=passage.terminal_error,
        slack=passage.slack,
        has_failed=False,
    )


def _solve_relaxed(agent: Planner, others: AvoidedAgents) -> tuple[AvoidanceResult | None, int]:
    """The first that is found with something given up, and the programmes that took."""
    for count, (gives, way) in enumerate(RELAXATION_ORDER, 1):
        if way == "stop":
            nominal = _compute_stopping_path(agent)
            passage = (
                None if nominal is None else solve_around(agent, others, nominal, "same", gives)
            )
        else:
            passage = solve_around(agent, others, agent.control_points, way, gives)
        if passage is not None:
            return passage, count
    return None, len(RELAXATION_ORDER)


def solve_around(
    agent: Planner,
    others: AvoidedAgents,
    nominal: Float[Array, "pieces 4 d"],
    way: PassingSide,
    gives: Relaxation = "none",
) -> AvoidanceResult | None:
    """Problem 7 about a nominal, clear of all others; None where it has no answer."""
    near = others.is_nearby
    while True:
        paths = others.control_points[near]
        normal = choose_normals(nominal - paths, agent.horizon.required_separation, way)
        spaces = convexify(agent.horizon, len(agent.nominal.u), paths, normal)
        try:
            passage = _solve_active_set(agent, spaces, gives)
        except Unsolved:
            return None
        met = (
            others.find_conflicts(
                agent.horizon.control_points(*passage.trajectory[:2]),
                agent.horizon.collision_radius,
            )
            & ~near
        )
        if not met.any():
            return passage
        near = near | met


def _compute_stopping_path(agent: Planner) -> Float[Array, "pieces 4 d"] | None:
    """The path of an agent that comes to rest where it is, as nearly as it can."""
    start = agent.nominal.x[0]
    here = np.concatenate([start[: len(start) // 2], np.zeros(len(start) // 2)])
    try:
        rest = AvoidanceProblem(agent.transfer).solve(
            start, here, empty_half_spaces(agent.transfer), "terminal"
        )
    except Unsolved:
        return None
    return agent.horizon.control_points(rest.trajectory.x, rest.trajectory.u)


def _solve_active_set(agent: Planner, spaces: HalfSpaces, gives: Relaxation) -> AvoidanceResult:
    # Few half-spaces bind: those on which the nominal leans, and at each step the one that
    # the answer would break most, until it breaks none.
    programme, nominal, R = (
        AvoidanceProblem(agent.transfer),
        agent.nominal,
        agent.horizon.collision_radius,
    )
    chosen = np.abs(spaces.violation(nominal.x, nominal.u)) < ACTIVE_TOLERANCE * R
    over = spaces.violation(agent.solo.x, agent.solo.u)
    while True:
        chosen |= _select_worst_per_step(
            spaces.step_index, np.where(chosen, 0.0, over), VIOLATION_TOLERANCE * R
        )
        passage = programme.solve(nominal.x[0], agent.target_state, spaces.select(chosen), gives)
        over = spaces.violation(passage.trajectory.x, passage.trajectory.u) - passage.slack
        if not ((over > VIOLATION_TOLERANCE * R) & ~chosen).any():
            return passage


def _select_worst_per_step(
    step: Int[Array, " rows"], over: Float[Array, " rows"], tolerance: float
) -> Bool[Array, " rows"]:
    worst = np.full(int(step.max(initial=-1)) + 1, tolerance)
    np.maximum.at(worst, step, over)
    return np.asarray((over >= worst[step]) & (over > tolerance))
