"""Memory of one planning agent, and its update in an exchange [Morgan2016, Method 2]."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.units import MAY_BE_INFINITE
from problems import convexify
from problems.avoidance import RELAXES_HALF_SPACES, AvoidanceProblem, AvoidanceResult, Relaxation
from problems.conic import Unsolved
from problems.drifts import Drifts
from problems.half_spaces import HalfSpaces
from problems.obstacle_paths import (
    ControlPath,
    ObstaclePaths,
    are_pieces_clear,
    choose_half_spaces,
    is_path_clear,
    violation,
)
from problems.path_separation import are_balls_separated, are_hulls_separated, separation_violation
from problems.solvers.verified import solve_program
from problems.transfer import Solver, Trajectory, TransferProblem
from sato.scp.passive_safety import PassiveSafety

ACTIVE_TOLERANCE = 1e-3  # of R: a half-space with less room than this may be active
VIOLATION_TOLERANCE = 1e-7  # of R: a half-space violated by more joins the program
NEARBY_FACTOR = 2.0  # times R: agents that come closer have half-spaces from the first solve
CONVERGENCE_TOLERANCE = 1e-3  # ε_SCP over R: a trajectory that moves less has converged
# Sides on which to pass where nominals collide, by dimension: the cheapest is taken.
PASSING_SIDES: dict[int, tuple[convexify.PassingSide, ...]] = {
    2: ("same", "opposite"),
    3: ("same", "opposite", "above", "below"),
}
# Where all are infeasible: what is relaxed, the side on which to pass the neighbors, and whether
# to convexify about stopping at once. Tried in this order.
Attempt = tuple[Relaxation, convexify.PassingSide, bool]
RELAXATION_ORDER: tuple[Attempt, ...] = (
    ("terminal", "same", False),
    ("terminal", "opposite", False),
    ("terminal", "same", True),
    ("separation", "same", False),
)
FEASIBILITY_TOLERANCE = 1e-6  # of R: smaller violations and terminal errors count as none
RELAXATIONS_IN_TURN = (RELAXATION_ORDER[0], RELAXATION_ORDER[2])  # where all can wait
RELAXATIONS_FOR_DRIFTS: tuple[Attempt, ...] = (("half-spaces", "same", False),)
# The printed method has none; without one an agent would have nothing to fly.
RELAXATIONS_AS_PRINTED: tuple[Attempt, ...] = (("separation", "nominal", False),)
MAX_SOLVES_IN_TURN = 4
MAX_SOLVES = 20  # programs, after which an agent stops improving (Proposition 4 keeps it safe)


# Class, −cost spent, number [Remark 5]. Who cannot move any more is of the first class; others are
# of the negative priority that a mission gives them.
Priority = tuple[Annotated[float, MAY_BE_INFINITE], float, int]


class TrajectoryMessage(NamedTuple):
    """Message of an agent to its neighbors."""

    priority: Priority  # the smaller is the higher
    control_points: ControlPath
    is_final: bool
    clearance: float  # that two of the sender's kind would keep [m]
    drifts: Drifts | None = None  # where it is to be passively safe
    number_count: int = 0  # real numbers that tell its path


class Planner(NamedTuple):
    """Memory of one planning agent.

    Before the first exchange `nominal` is `solo`, or the rest of the previous plan where that
    differs: so the agent keeps to the side on which it passes.
    """

    priority: Priority
    target_state: Float[Array, " n"]
    transfer: TransferProblem
    horizon: convexify.AvoidanceHorizon
    solo: Trajectory  # optimal without the others: iterate 0
    nominal: Trajectory
    control_points: ControlPath  # of the nominal, over the horizon
    obstacles: ObstaclePaths | None = None  # that it knows, over the horizon
    passive: PassiveSafety | None = None
    route: ControlPath | None = None  # around these, where `solo` is not clear
    relinearize: Callable[[Trajectory], TransferProblem] | None = None  # None: model is linear
    solver: Solver = solve_program  # its own
    has_plan: bool = False  # True where it begins with a plan that it keeps if it can
    is_delayed: bool = False  # True where others have kept it from its target
    in_turn: bool = False  # True where it plans once those of higher priority have
    is_final: bool = False
    has_converged: bool = True  # True where the nominal solves its last program, or needed none
    last_inbox: tuple[TrajectoryMessage, ...] = ()  # of higher priority, in the last program
    solve_count: int = 0
    terminal_error: float = 0.0  # distance from the target at the end, where relaxed
    slack: float = 0.0  # largest violation of a half-space or a separation [m]
    has_failed: bool = False  # True where no program was feasible

    @property
    def message(self) -> TrajectoryMessage:
        """Message to the neighbors."""
        parts = self.priority, self.control_points, self.is_final
        drifts = self.passive and self.passive.own
        return TrajectoryMessage(*parts, self.horizon.clearance, drifts, self.number_count)

    @property
    def number_count(self) -> int:
        """Real numbers that tell its path: a state and controls; points of a way around obstacles.

        Once it is pushed aside, it follows from this and from what has moved.
        """
        pieces, _, d = self.control_points.shape
        steps = min(len(self.nominal.u), self.horizon.steps)
        return int(d * (2 + steps + (pieces if self.control_points is self.route else 0)))

    @property
    def is_clear(self) -> bool:
        """True where its final trajectory was found clear, of all with higher priority, to its end.

        Where that is so of all, they are clear of each other.
        """
        is_whole = len(self.nominal.u) <= self.horizon.steps
        # Half-spaces are that much farther away than the distance to keep.
        allowed = convexify.SEPARATION_TOLERANCE * self.horizon.clearance
        return self.is_final and self.slack <= allowed and not self.has_failed and is_whole

    @property
    def relinearized(self) -> "Planner":
        """This planner, linearized about its nominal where its model is nonlinear."""
        if self.relinearize is None:
            return self
        return self._replace(transfer=self.relinearize(self.nominal))

    @property
    def without_tie_break(self) -> "Planner":
        """This planner with equal weights of all steps."""
        return self._replace(transfer=replace(self.transfer, tie_break_rise=0.0))

    def with_nominal(self, trajectory: Trajectory) -> "Planner":
        """Replace the nominal, its control points and its drifts."""
        return self._replace(
            nominal=trajectory,
            control_points=self.horizon.control_points(trajectory.x, trajectory.u),
            passive=self.passive and self.passive.follow(trajectory),
        )

    def with_result(self, result: AvoidanceResult) -> "Planner":
        """Replace the nominal by the solution of a program."""
        return self.with_nominal(result.trajectory)._replace(
            terminal_error=result.terminal_error, slack=result.slack, has_failed=False
        )

    @property
    def restarted(self) -> "Planner":
        """This planner with its solo trajectory as the nominal, or the way around obstacles."""
        if self.route is None:
            return self.with_nominal(self.solo)
        return self._replace(nominal=self.solo, control_points=self.route, has_converged=False)

    def keeps_clear(self, messages: Sequence[TrajectoryMessage]) -> bool:
        """Return True where its nominal keeps clear of the senders and of obstacles."""
        path, clearance = self.control_points, self.horizon.clearance
        is_apart = is_path_clear(path, self.obstacles) and is_clear(path, messages, clearance)
        return is_apart and (self.passive is None or self.passive.is_safe(drifts_of(messages)))

    def reaches_target(self, trajectory: Trajectory) -> bool:
        """Return True where a trajectory ends at the target."""
        return reaches_target(trajectory, self.target_state, self.horizon.clearance)


Planners = Mapping[int, Planner]  # by the numbers of the agents


def reaches_target(trajectory: Trajectory, target: Float[Array, " n"], radius: float) -> bool:
    """Return True where a trajectory ends at a target state, within a part of the radius."""
    return bool(np.abs(trajectory.x[-1] - target).max() <= FEASIBILITY_TOLERANCE * radius)


def update_planner(agent: Planner, inbox: Sequence[TrajectoryMessage]) -> Planner:
    """Plan around the neighbors of higher priority.

    A trajectory is final when it has converged, keeps clear, and the trajectories of all agents
    that it must avoid are final: from then on it cannot change. So trajectories become final in
    the order of the priorities [Morgan2016, Theorem 8], each by its own inbox.
    """
    if agent.is_final:
        return agent
    above = tuple(message for message in inbox if message.priority < agent.priority)
    if agent.in_turn and not all(message.is_final for message in above):
        return agent
    if _needs_solve(agent, above):
        agent = _solve_iteration(agent, above)
    if not (agent.has_converged and all(message.is_final for message in above)):
        return agent
    # Half-spaces leave out what no control can change: the first control points, and those after
    # the last control. So what is flown is verified as it is.
    lacking = violation(agent.control_points, agent.obstacles)
    if above:
        radii = pair_clearances(above, agent.horizon.clearance)
        lacking = max(lacking, separation_violation(agent.control_points - paths_of(above), radii))
    if agent.passive is not None and not agent.passive.is_safe(drifts_of(above)):
        agent = agent._replace(has_failed=True)
    return agent._replace(is_final=True, slack=max(agent.slack, lacking))


def _needs_solve(agent: Planner, above: tuple[TrajectoryMessage, ...]) -> bool:
    if len(agent.nominal.u) == 0:
        return False
    if agent.in_turn:  # those above are final: a trajectory that is clear of them can stay
        return not (agent.has_converged and agent.keeps_clear(above))
    if follows_solo(agent):
        return not agent.keeps_clear(above)
    is_unchanged = len(above) == len(agent.last_inbox) and all(
        np.array_equal(a.control_points, b.control_points)
        for a, b in zip(above, agent.last_inbox, strict=True)
    )
    return not (is_unchanged and agent.has_converged)


def follows_solo(agent: Planner) -> bool:
    """Return True where an agent has never had to deviate from its solo trajectory."""
    return agent.solve_count == 0 and agent.nominal is agent.solo and agent.has_converged


def may_have_to_solve(agent: Planner) -> bool:
    """Return True where an agent may have something to solve that paths alone do not show."""
    return not follows_solo(agent) or agent.passive is not None


def paths_of(messages: Sequence[TrajectoryMessage]) -> Float[Array, "others pieces 4 d"]:
    """Stack the control points of messages; at least one."""
    return np.stack([message.control_points for message in messages])


def drifts_of(messages: Sequence[TrajectoryMessage]) -> dict[int, Drifts]:
    """Return the drifts of the senders that are to be passively safe, by their numbers."""
    return {m.priority[2]: m.drifts for m in messages if m.drifts is not None}


def pair_clearances(messages: Sequence[Any], clearance: float) -> Float[Array, " others"]:
    """Compute the clearance from each sender, the mean of both: (R_i + R_j)/2 and the margins."""
    return (np.array([message.clearance for message in messages], dtype=float) + clearance) / 2


def required_separations(clearance: Float[Array, " others"]) -> Float[Array, " others"]:
    """Compute the distances that planned trajectories keep, from the clearances of pairs."""
    return clearance * (1 + convexify.SEPARATION_TOLERANCE)


def is_clear(path: ControlPath, others: Sequence[TrajectoryMessage], clearance: float) -> bool:
    """Return True where the path of an agent with a clearance keeps clear of all others."""
    if not others:
        return True
    radii = pair_clearances(others, clearance)
    return bool(are_hulls_separated(path - paths_of(others), radii).all())


def _solve_iteration(agent: Planner, above: tuple[TrajectoryMessage, ...]) -> Planner:
    R = agent.horizon.clearance
    after = None
    if agent.passive is None or agent.solve_count == 0:  # those above do not move any more
        after = agent.with_result(AvoidanceResult(agent.solo, 0.0, 0.0))
    if after is None or not after.keeps_clear(above):
        after = _solve_avoidance(agent.relinearized, above)
    moved = float(np.abs(after.nominal.x - agent.nominal.x).max())
    most = MAX_SOLVES_IN_TURN if agent.in_turn and agent.passive is None else MAX_SOLVES
    has_converged = moved <= CONVERGENCE_TOLERANCE * R or after.solve_count >= most
    return after._replace(has_converged=has_converged, last_inbox=above)


def _solve_avoidance(agent: Planner, above: tuple[TrajectoryMessage, ...]) -> Planner:
    nominal, collides = agent.control_points, not agent.keeps_clear(above)
    begins = agent.passive is None or agent.solve_count == 0
    if collides and agent.in_turn and begins:  # a path that was pushed aside, and is no way around
        agent = agent.restarted
        nominal = agent.control_points
    sides = PASSING_SIDES[nominal.shape[-1]] if collides and begins else ("same",)
    if agent.horizon.samples_only:
        sides = ("nominal",)
    tried = [solve_around(agent, above, nominal, side) for side in sides]
    feasible = [result for result in tried if result is not None]
    agent = agent._replace(solve_count=agent.solve_count + len(sides))
    if feasible:
        cost = agent.transfer.cost
        return agent.with_result(min(feasible, key=lambda result: cost(result.trajectory)))
    relaxations = RELAXATIONS_IN_TURN if agent.in_turn else RELAXATION_ORDER
    if agent.passive is not None:  # the next iteration begins nearer to what is asked
        relaxations = RELAXATIONS_FOR_DRIFTS
    if agent.horizon.samples_only:
        relaxations = RELAXATIONS_AS_PRINTED
    for relaxation, side, stops in relaxations:
        agent = agent._replace(solve_count=agent.solve_count + 1)
        if stops:  # come to rest where it is, as nearly as it can
            start, d = agent.nominal.x[0], nominal.shape[-1]
            rest = np.concatenate([start[:d], np.zeros(d)])
            stopping = minimize_terminal_error(agent.transfer, start, rest, agent.solver)
            about = agent.horizon.control_points(stopping.x, stopping.u)
        else:
            about = nominal
        result = solve_around(agent, above, about, side, relaxation)
        if result is not None:
            return agent.with_result(result)
    # The message must be of what is flown, whatever the agent began with.
    return agent.with_nominal(agent.nominal)._replace(has_failed=True, slack=0.0)


def minimize_terminal_error(
    transfer: TransferProblem, start: Float[Array, " n"], target: Float[Array, " n"], solver: Solver
) -> Trajectory:
    """Return the trajectory that ends nearest the target; free motion if none is found."""
    try:
        return AvoidanceProblem.alone(transfer, start, target, solver).solve("terminal").trajectory
    except Unsolved:
        return transfer.simulate(start, np.zeros(transfer.model.B.shape[::2]))


def solve_around(
    agent: Planner,
    messages: Sequence[TrajectoryMessage],
    nominal: ControlPath,
    side: convexify.PassingSide,
    relaxation: Relaxation = "none",
) -> AvoidanceResult | None:
    """Solve Problem 7 about a nominal path, clear of all others; None where it is infeasible.

    Agents that do not come near the agent's own path need no half-spaces at first.
    """
    horizon, T, bodies = agent.horizon, len(agent.nominal.u), agent.obstacles
    others = np.array([message.control_points for message in messages])
    others = others.reshape(-1, *nominal.shape)
    clear = pair_clearances(messages, horizon.clearance)
    near, required = NEARBY_FACTOR * clear, required_separations(clear)
    constrained = ~are_balls_separated(agent.control_points - others, near).all(axis=1)
    beside = np.zeros(0, dtype=bool)
    if bodies is not None:
        beside = _find_met(agent.control_points, bodies, NEARBY_FACTOR)
    in_drifts = agent.passive and agent.passive.find_conflicts(drifts_of(messages))
    while True:
        paths, kept = others[constrained], required[constrained]
        known = None if bodies is None else bodies.select(beside)
        between = choose_half_spaces(nominal, paths, kept, known, side)
        half_spaces = convexify.convexify(horizon, T, *between)
        if in_drifts is not None:
            half_spaces = half_spaces.join(in_drifts.constrain(side))
        try:
            result = _solve_active_set(agent, half_spaces, relaxation)
        except Unsolved:
            return None
        path = horizon.control_points(result.trajectory.x, result.trajectory.u)
        is_met = ~are_hulls_separated(path - others, clear).all(axis=1)
        is_new = bool((is_met & ~constrained).any())
        constrained = constrained | is_met
        if bodies is not None:
            met = _find_met(path, bodies)
            is_new |= bool((met & ~beside).any())
            beside = beside | met
        if in_drifts is not None:
            before, in_drifts = in_drifts.size, in_drifts.with_solution(result.trajectory)
            is_new |= in_drifts.size > before
        if not is_new:
            return result


def _find_met(
    path: ControlPath, obstacles: ObstaclePaths, factor: float = 1.0
) -> Bool[Array, " obstacles"]:
    """Find the obstacles that a path comes nearer to than the clearance, times a factor."""
    wide = obstacles._replace(clearance=factor * obstacles.clearance)
    return np.asarray(~are_pieces_clear(path, wide).all(axis=1))


def _solve_active_set(
    agent: Planner, half_spaces: HalfSpaces, relaxation: Relaxation
) -> AvoidanceResult:
    transfer, nominal, target = agent.transfer, agent.nominal, agent.target_state
    R = agent.horizon.clearance
    tolerance = VIOLATION_TOLERANCE * R
    problem = AvoidanceProblem(transfer, nominal.x[0], target, half_spaces, agent.solver, tolerance)
    found = problem.generate(relaxation)
    if found is not None:
        return found
    # Few half-spaces are active: begin with those active at the nominal, and add at each step
    # the one that is violated most, until none is.
    active = np.abs(half_spaces.violation(nominal.x, nominal.u)) < ACTIVE_TOLERANCE * R
    violation = half_spaces.violation(agent.solo.x, agent.solo.u)
    while True:
        active |= half_spaces.worst_per_step(np.where(active, 0.0, violation), tolerance)
        result = problem.select(active).solve_conic(relaxation)
        trajectory = result.trajectory
        violation = half_spaces.violation(trajectory.x, trajectory.u)
        violation -= result.slack if relaxation in RELAXES_HALF_SPACES else 0.0
        if not ((violation > tolerance) & ~active).any():
            return result
