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
from problems import convexify
from problems.conic import Unsolved
from problems.convexify import AvoidanceHorizon
from problems.joint_stops import JointStopProblem, StoppingVehicle
from problems.obstacle_paths import ObstaclePaths, is_path_clear, violation
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.offers import Offers, steps_to_next
from sato.reconfiguration.state import DecisionContext
from sato.reconfiguration.stop_search import search_stops
from sato.reconfiguration.stopping import stays_within_reach, stopping_horizon
from sato.scp.planner import Priority

ROUNDING = 1e-12  # relative, of distances that are computed twice
SHARES_OF_ESCAPE = 1.0, 0.5, 0.25  # of the time to get out of the way, that is looked ahead at rest
AT_REST = 1e-9  # of the clearance: paths that stay so near to their ends are at rest
UNCHANGED = 1e-6  # of the control limit: who changes by less changes nothing
MAX_TRIED = 20  # stops of a search that are flown
MAX_CHANGES = 12  # that one program after another finds
PROGRESS, PATIENCE = 0.95, 2  # factor of the slack from program to program; programs without it
SMALL = 1e-3  # of the distance: slack that may be left to the next program
CROWDED = 2.0  # of the distance: others that are nearer are in a crowd
MAX_CROWD = 60  # agents that change together

Look = tuple[int, ObstaclePaths | None]  # steps for which to rest at the end, and what to avoid


@dataclass(frozen=True)
class EvasionReport:
    """Report of an agent, after its turn: what it has committed to, and what it has to avoid."""

    agent: int
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

    Others may move for long. What moves counts until the agent, at rest, could get out of its way,
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

    What is offered in place of what it had is clear of all.
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


def find_evasions(
    mission: Reconfiguration, horizon: AvoidanceHorizon, reports: Sequence[EvasionReport]
) -> dict[int, EvasionReport]:
    """Change what agents have committed to where something comes over them.

    Where nothing is found that is clear of all, the change is made that lacks least.

    Args:
        mission: Limits of the vehicles.
        horizon: Horizon in which all have come to rest.
        reports: Reports of all agents of a component.

    Returns:
        Reports of those that change, as they are then.
    """
    now = sorted(reports, key=lambda report: report.agent)
    met = [a for a, own in enumerate(now) if not is_path_clear(own.path, own.looks[-1][1])]
    if not met:
        return {}
    required = _required_distances(now)
    found, least = dict[int, EvasionReport](), _measure_lack(now, met)
    for n in range(max(len(now[a].looks) for a in met)):
        looks = [
            own.looks[n if a in met and n < len(own.looks) else -1] for a, own in enumerate(now)
        ]
        for after in islice(_evade(mission, horizon, now, met, looks, required), MAX_CHANGES):
            if not _is_allowed(mission, horizon, now, after, met, required):
                continue
            is_clear = all(is_path_clear(after[a].path, looks[a][1]) for a in met)
            lack = _measure_lack(after, met)
            if is_clear or lack < least:
                changed = (own for own, was in zip(after, now, strict=True) if own is not was)
                found, least = {own.agent: own for own in changed}, lack
            if is_clear:
                return found
    return found


def _evade(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    now: Sequence[EvasionReport],
    met: Sequence[int],
    looks: Sequence[Look],
    required: Float[Array, "agents agents"],
) -> Iterator[list[EvasionReport]]:
    """List changes, each closer than the one before to one that is clear of all.

    Args:
        mission: Limits of the vehicles.
        horizon: Horizon in which all have come to rest.
        now: Reports of all.
        met: Rows of those that something comes over.
        looks: How long each rests, and what it has to avoid.
        required: Distances of two [m].
    """
    before, least_change = np.stack([own.u for own in now]), UNCHANGED * mission.least_braking
    u = before.copy()
    for a in met:
        u[a] = _search_way(mission, horizon, now, a, looks[a], required[a])
    problem = _make_problem(mission, horizon, now, met, looks, required, u)
    least, stalled = np.inf, 0
    while stalled < PATIENCE:
        paths = problem.fly(u)[1]
        is_changed = (np.abs(u - before) > least_change).any(axis=(1, 2))
        each = zip(now, u, paths, is_changed.tolist(), strict=True)
        yield [replace(own, u=w, path=p) if differs else own for own, w, p, differs in each]
        try:
            u, slack = problem.improve(u)
        except Unsolved:
            return
        stalled = 0 if slack < max(PROGRESS * least, SMALL * required.max()) else stalled + 1
        least = min(least, slack)


def _search_way(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    now: Sequence[EvasionReport],
    row: int,
    look: Look,
    required: Float[Array, " agents"],
) -> Float[Array, "T m"]:
    """Search a way out of an agent, clear of all or else of obstacles; what it had without one."""
    own, (rest_steps, obstacles) = now[row], look
    if obstacles is None or is_path_clear(own.path, obstacles):
        return own.u
    others = [a for a in range(len(now)) if a != row]
    paths = np.stack([own.path for own in now])[others]
    for bodies in (obstacles.join_points(paths, required[others]), obstacles):
        found = search_stops(mission, horizon, own.agent, own.state, rest_steps, bodies)
        for u in islice(found, MAX_TRIED):
            path = horizon.control_points(horizon.discrete_model.simulate(own.state, u), u)
            if is_path_clear(path, bodies):
                return u
    return own.u


def _make_problem(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    now: Sequence[EvasionReport],
    met: Sequence[int],
    looks: Sequence[Look],
    required: Float[Array, "agents agents"],
    u: Float[Array, "agents T m"],
) -> JointStopProblem:
    """Make the program of the crowd about those that something comes over."""
    vehicles = tuple(
        StoppingVehicle(
            own.state,
            own.u,
            mission.planned_control_limit(own.agent),
            mission.speed_limit(own.agent),
            max(horizon.steps - 1 - rest_steps, 1),
            obstacles,
        )
        for own, (rest_steps, obstacles) in zip(now, looks, strict=True)
    )
    every = np.ones(len(now), dtype=bool)
    paths = JointStopProblem(horizon, vehicles, required, every).fly(u)[1]
    return JointStopProblem(horizon, vehicles, required, _find_crowd(paths, met, required))


def _find_crowd(
    paths: Float[Array, "agents pieces 4 d"],
    met: Sequence[int],
    required: Float[Array, "agents agents"],
) -> Bool[Array, " agents"]:
    """Find those near some agents, those near these, and so on, the nearest up to a number."""
    crowd, apart = np.zeros(len(paths), dtype=bool), np.full(len(paths), np.inf)
    apart[list(met)] = 0.0
    while True:
        a = int(np.where(crowd, np.inf, apart).argmin())
        if crowd[a] or apart[a] > CROWDED or crowd.sum() >= MAX_CROWD:
            return crowd
        crowd[a] = True
        away = np.linalg.norm(paths - paths[a], axis=-1).min(axis=(1, 2))
        apart = np.minimum(apart, away / np.maximum(required[a], 1e-300))


def _required_distances(now: Sequence[EvasionReport]) -> Float[Array, "agents agents"]:
    """Return the distances that two have to keep: those of their kinds, or what they keep now."""
    clearance, paths = (np.array([getattr(own, k) for own in now]) for k in ("clearance", "path"))
    required = np.asarray((clearance[:, None] + clearance) / 2)
    i, j = np.triu_indices(len(now), 1)
    is_clear = convexify.are_paths_separated(paths, i, j, required[i, j])
    for a, b in zip(i[~is_clear], j[~is_clear], strict=True):
        kept = float(hull_distance(paths[a] - paths[b])[0].min()) * (1 - ROUNDING)
        required[a, b] = required[b, a] = min(required[a, b], kept)
    return required


def _measure_lack(reports: Sequence[EvasionReport], rows: Sequence[int]) -> float:
    """Add up by how much agents lack the distance from obstacles at most [m]."""
    return sum(violation(reports[a].path, reports[a].looks[-1][1]) for a in rows)


def _is_allowed(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    now: Sequence[EvasionReport],
    after: Sequence[EvasionReport],
    met: Sequence[int],
    required: Float[Array, "agents agents"],
) -> bool:
    """Tell whether changed agents keep their limits, their reach, and clear of all they were."""
    changed = [a for a, own in enumerate(after) if own is not now[a]]
    for a in changed:
        own, d = after[a], mission.axes
        x = horizon.discrete_model.simulate(own.state, own.u)
        control, speed = mission.planned_control_limit(own.agent), mission.speed_limit(own.agent)
        is_beyond = control.is_exceeded(own.u).any() or speed.is_exceeded(x[1:, d:]).any()
        if is_beyond or not stays_within_reach(mission, horizon, x[:, :d], own.path):
            return False
        if a not in met and not is_path_clear(own.path, own.looks[-1][1]):
            return False
    i, j = np.nonzero(np.triu(np.ones_like(required), 1))
    some = np.isin(i, changed) | np.isin(j, changed)
    i, j = i[some], j[some]
    paths = np.stack([own.path for own in after])
    return bool(convexify.are_paths_separated(paths, i, j, required[i, j]).all())
