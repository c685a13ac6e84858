"""Evasion: agents that something comes over stop elsewhere, and others make room for them.

A search finds on which sides to pass what comes, for each agent alone. From these ways on, one
program changes the controls of all in the crowd about them, until all are clear of each other.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import hull_distance
from problems.conic import Unsolved
from problems.convexify import AvoidanceHorizon
from problems.joint_stops import JointStopProblem, StoppingVehicle
from problems.limit import Limit
from problems.obstacle_paths import ObstaclePaths, is_path_clear, measure_gaps, violation
from problems.path_separation import are_paths_separated
from sato.network.encoding import EVASION_REPORT, INDEX, REAL
from sato.reconfiguration.agent_inputs import AgentNumber
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.offers import Offers, steps_to_next
from sato.reconfiguration.state import DecisionContext
from sato.reconfiguration.stop_search import search_stops
from sato.reconfiguration.stopping import stays_within_reach, stopping_horizon
from sato.scp.planner import Priority

ROUNDING = 1e-12  # relative, of distances that are computed twice
SHARES_OF_ESCAPE = 1.0, 0.5, 0.25  # of the time to get out of the way, that is looked ahead at rest
AT_REST = 1e-9  # of the clearance: paths that stay so near to their ends are at rest
UNCHANGED = 1e-6  # of the control limit: a smaller change of the controls is none
MAX_TRIED = 20  # stops of a search that are flown
MAX_CHANGES = 10  # that one program after another finds
PROGRESS, PATIENCE = 0.95, 2  # factor by which slack and lack get less; programs without that
SMALL = 1e-3  # of the distance: slack that may be left to the next program
CROWDED = 2.0  # of the distance: others that are nearer are in a crowd
MAX_CROWD = 60  # agents that change together

Look = tuple[int, ObstaclePaths | None]  # steps for which to rest at the end, and what to avoid


@dataclass(frozen=True)
class EvasionReport:
    """Report of an agent, after its turn: what it has committed to, and what it has to avoid."""

    agent: AgentNumber
    priority: Priority = field(compare=False)
    state: Float[Array, " n"] = field(compare=False)
    u: Float[Array, "T m"] = field(compare=False)
    path: Float[Array, "pieces 4 d"] = field(compare=False)
    clearance: float = field(compare=False)  # that two of its kind would keep [m]
    looks: tuple[Look, ...] = field(compare=False)
    round: int = 0


def list_looks(
    context: DecisionContext,
    agent: int,
    horizon: AvoidanceHorizon,
    path: Float[Array, "pieces 4 d"],
) -> Iterator[Look]:
    """List how long an agent rests at the end, and obstacles as they count, the best first.

    Others may move for long. Each counts until the agent, at rest, could get out of its way,
    or, where that is too far to go at once, for a part of that time; not if it comes later. The
    last is the first of which the committed path is clear.
    """
    obstacles, shares = context.known_obstacles(agent, horizon), _count_ahead(context, agent)
    if obstacles is None or not any(shares):
        yield 0, obstacles
        return
    away, S = np.abs(path - path[-1, -1]).max(axis=(1, 2)), horizon.pieces_per_step
    is_moving = away > AT_REST * horizon.clearance
    moving = int(np.flatnonzero(is_moving).max(initial=-1)) // S + 1
    for ahead in shares:
        last = max(moving, steps_to_next(context) + ahead)
        known = obstacles.held_after(min((last + 1 + ahead) * S, len(path)))
        yield max(ahead, horizon.steps - 1 - last), known
        if is_path_clear(path, known):
            return


def _count_ahead(context: DecisionContext, agent: int) -> list[int]:
    """Count the steps at rest that an agent looks ahead, the best first; 0 where nothing moves."""
    around = context.surroundings
    escape = around.escape_steps(context.mission, agent) if around else 0
    return [max(1, int(share * escape)) if escape else 0 for share in SHARES_OF_ESCAPE]


def is_met(context: DecisionContext, offers: Offers, row: int, choice: int) -> bool:
    """Tell whether something that an agent knows comes over what it has chosen.

    An offer in place of what it had is clear of all.
    """
    if choice < offers.last or context.surroundings is None:
        return False
    horizon = stopping_horizon(context.mission, int(offers.steps[row]))
    chosen = offers.paths[row, choice, : len(horizon.fine_model)]
    return not is_path_clear(chosen, context.known_obstacles(int(offers.agents[row]), horizon))


def make_report(
    context: DecisionContext,
    agent: int,
    priority: Priority,
    horizon: AvoidanceHorizon,
    u: Float[Array, "T m"],
    path: Float[Array, "pieces 4 d"],
    clearance: float,
) -> EvasionReport:
    """Return the report of an agent on what it has committed to."""
    looks = tuple(list_looks(context, agent, horizon, path))
    rest_steps, obstacles = looks[-1]
    if not is_path_clear(path, obstacles):  # it may move for longer than it would have
        rest_steps = _count_ahead(context, agent)[-1]
        looks = (*looks, (rest_steps, context.known_obstacles(agent, horizon)))
    return EvasionReport(agent, priority, context.state[agent], u, path, clearance, looks)


def measure_report(report: EvasionReport) -> int:
    """Return the bytes of a report."""
    size = EVASION_REPORT + REAL * (report.state.size + report.u.size)
    for _, obstacles in report.looks:
        size += INDEX
        if obstacles is not None:
            of_each = 2 * obstacles.velocity.shape[1] + 1 + obstacles.corners[0].size
            size += len(obstacles.velocity) * (INDEX + REAL * of_each)
    return size


def find_evasions(
    mission: Reconfiguration, horizon: AvoidanceHorizon, reports: Sequence[EvasionReport]
) -> dict[int, EvasionReport]:
    """Change what agents have committed to where something comes over them.

    The reports are those of all agents of a component, and the horizon one in which all have come
    to rest. Returned are the reports of those that change, as they are then.
    """
    before = sorted(reports, key=lambda report: report.agent)
    now = [*before]
    left = {a for a, own in enumerate(now) if not is_path_clear(own.path, own.looks[0][1])}
    while left:
        first = min(left, key=lambda a: now[a].priority)
        crowd = _find_crowd(now, first)
        now = _evade(mission, horizon, now, crowd)
        left -= {first, *np.flatnonzero(crowd).tolist()}
    return {own.agent: own for own, was in zip(now, before, strict=True) if own is not was}


def _find_crowd(now: Sequence[EvasionReport], first: int) -> Bool[Array, " agents"]:
    """Find those near an agent, those near these, and so on: the nearest, up to a number."""
    paths, clearance = (np.array([getattr(own, k) for own in now]) for k in ("path", "clearance"))
    crowd, apart = np.zeros(len(now), dtype=bool), np.full(len(now), np.inf)
    apart[first] = 0.0
    while crowd.sum() < min(len(now), MAX_CROWD):
        a = int(np.where(crowd, np.inf, apart).argmin())
        if apart[a] > CROWDED:
            break
        crowd[a] = True
        away = np.linalg.norm(paths - paths[a], axis=-1).min(axis=(1, 2))
        apart = np.minimum(apart, 2 * away / (clearance + clearance[a]))
    return crowd


def _evade(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    now: list[EvasionReport],
    crowd: Bool[Array, " agents"],
) -> list[EvasionReport]:
    """Change what a crowd has committed to; where nothing is clear of all, so that it lacks least.

    How long agents look ahead is tried in turn, the longest first.
    """
    required, rows, found = _required_distances(now), np.flatnonzero(crowd).tolist(), now
    for n in range(max(len(now[a].looks) for a in rows)):
        looks = [own.looks[min(n, len(own.looks) - 1)] for own in now]
        met = [a for a in rows if not is_path_clear(now[a].path, looks[a][1])]
        if not met:
            break
        found, least = now, sum(violation(now[a].path, looks[a][1]) for a in rows)
        evasion = _CrowdEvasion(mission, horizon, now, crowd, met, looks, required)
        for after in islice(evasion.list_changes(), MAX_CHANGES):
            if not evasion.is_allowed(after):
                continue
            lack = sum(violation(after[a].path, looks[a][1]) for a in rows)
            if lack == 0.0:
                return after
            if lack < PROGRESS * least:
                found, least = after, lack
    return found


def _required_distances(now: Sequence[EvasionReport]) -> Float[Array, "agents agents"]:
    """Return the distances that two have to keep: those of their kinds, or what they keep now."""
    clearance, paths = (np.array([getattr(own, k) for own in now]) for k in ("clearance", "path"))
    required = np.asarray((clearance[:, None] + clearance) / 2)
    i, j = np.triu_indices(len(now), 1)
    is_clear = are_paths_separated(paths, i, j, required[i, j])
    for a, b in zip(i[~is_clear], j[~is_clear], strict=True):
        kept = float(hull_distance(paths[a] - paths[b])[0].min()) * (1 - ROUNDING)
        required[a, b] = required[b, a] = min(required[a, b], kept)
    return required


@dataclass(frozen=True, eq=False)
class _CrowdEvasion:
    """Evasion of a crowd, while all look ahead for as long as they do."""

    mission: Reconfiguration  # limits of the vehicles
    horizon: AvoidanceHorizon  # in which all have come to rest
    now: Sequence[EvasionReport]  # of all
    crowd: Bool[Array, " agents"]  # True for those that change
    met: Sequence[int]  # rows of those that something comes over
    looks: Sequence[Look]  # how long each rests, and what it has to avoid
    required: Float[Array, "agents agents"]  # distances of two [m]

    def list_changes(self) -> Iterator[list[EvasionReport]]:
        """List changes: that of a search, and those of programs about one after another."""
        before = np.stack([own.u for own in self.now])
        u, least_change = before.copy(), UNCHANGED * self.mission.least_braking
        for a in self.met:
            u[a] = self._search_way(a)
        problem = self._make_problem()
        least, stalled = np.inf, 0
        while stalled < PATIENCE:
            is_changed = (np.abs(u - before) > least_change).any(axis=(1, 2))
            each = zip(self.now, u, problem.fly(u)[1], is_changed.tolist(), strict=True)
            yield [replace(own, u=w, path=p) if differs else own for own, w, p, differs in each]
            if not problem.is_free.any():
                return
            try:
                following, slack = problem.improve(u)
            except Unsolved:
                return
            is_same = np.abs(following - u).max() < least_change
            stalled = stalled + 1 if is_same or slack > max(PROGRESS * least, SMALL) else 0
            u, least = following, min(least, slack)

    def _search_way(self, row: int) -> Float[Array, "T m"]:
        """Search a way out of an agent, clear of all or of obstacles; what it had without one."""
        own, (rest_steps, obstacles) = self.now[row], self.looks[row]
        assert obstacles is not None
        within, d = (self.mission, self.horizon), self.mission.axes
        here = np.broadcast_to(own.path[:1, :1], (1, 4, d)) - obstacles.paths[:, :1, :1]
        gap = measure_gaps(here, obstacles)[0][:, 0] * (1 - ROUNDING)
        obstacles = obstacles._replace(clearance=np.minimum(obstacles.clearance, gap))
        others = [a for a in range(len(self.now)) if a != row]
        paths = np.stack([own.path for own in self.now])[others]
        for bodies in (obstacles.join_points(paths, self.required[row, others]), obstacles):
            found = search_stops(*within, own.agent, own.state, rest_steps, bodies)
            for u in islice(found, MAX_TRIED):
                x = self.horizon.discrete_model.simulate(own.state, u)
                path = self.horizon.control_points(x, u)
                if is_path_clear(path, bodies) and stays_within_reach(*within, x, path):
                    return u
        return own.u

    def _make_problem(self) -> JointStopProblem:
        """Make the program, without those that keep no limits, as noise may have it."""
        vehicles, is_free = [], self.crowd.copy()
        for a, (own, (rest_steps, obstacles)) in enumerate(zip(self.now, self.looks, strict=True)):
            steps, limits = max(self.horizon.steps - 1 - rest_steps, 1), self._limits(own)
            vehicles.append(StoppingVehicle(own.state, own.u, *limits, steps, obstacles))
            is_free[a] &= self._keeps_limits(own)
        return JointStopProblem(self.horizon, tuple(vehicles), self.required, is_free)

    def _limits(self, own: EvasionReport) -> tuple[Limit, Limit]:
        """Return the limits of an agent's control and speed."""
        mission, i = self.mission, own.agent
        return mission.planned_control_limit(i), mission.stop_speed_limit(i)

    def _keeps_limits(self, own: EvasionReport) -> bool:
        v = self.horizon.discrete_model.simulate(own.state, own.u)[1:, self.mission.axes :]
        control, speed = self._limits(own)
        return not (control.is_exceeded(own.u).any() or speed.is_exceeded(v).any())

    def is_allowed(self, after: Sequence[EvasionReport]) -> bool:
        """Verify limits and reach of what changed, and that it is clear of all, or no nearer."""
        changed = [a for a, own in enumerate(after) if own is not self.now[a]]
        for a in changed:
            own, obstacles = after[a], self.looks[a][1]
            x = self.horizon.discrete_model.simulate(own.state, own.u)
            is_within = stays_within_reach(self.mission, self.horizon, x, own.path)
            if not (is_within and self._keeps_limits(own)):
                return False
            if obstacles is not None and not is_path_clear(own.path, obstacles):
                gap, before = (
                    measure_gaps(path - obstacles.paths, obstacles)[0].min(axis=1)
                    for path in (own.path, self.now[a].path)
                )
                if (gap < np.minimum(obstacles.clearance, before) * (1 - ROUNDING)).any():
                    return False
        i, j = np.nonzero(np.triu(np.ones_like(self.required), 1))
        some = np.isin(i, changed) | np.isin(j, changed)
        i, j = i[some], j[some]
        paths = np.stack([own.path for own in after])
        return bool(are_paths_separated(paths, i, j, self.required[i, j]).all())
