"""Evasion: an agent that something comes over stops elsewhere, and takes along those in its way.

Two trajectories that are changed by the same displacement at all times keep their distance. So
where a way out leads an agent into others, these change theirs as it does, and those whom they
meet then, too, until none is met; one that cannot, at its limits, stops in another way.

The ways out are sampled. A program is convex, and chooses a side of each obstacle; among several
that move, such as a group of lost vehicles, ways out differ for each place and each duration.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import islice

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from dynamics.trajectory_geometry import hull_distance
from problems import convexify
from problems.convexify import AvoidanceHorizon
from problems.obstacle_paths import ObstaclePaths, are_points_clear, is_path_clear
from sato.obstacles import spread_directions
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.offers import Offers, steps_to_next
from sato.reconfiguration.state import DecisionContext
from sato.reconfiguration.stopping import longest_way, stays_within_reach, stopping_horizon
from sato.scp.planner import Priority

ROUNDING = 1e-12  # relative, of distances that are computed twice
SHARES_OF_ESCAPE = 1.0, 0.5, 0.25  # of the time to get out of the way, that is looked ahead at rest
DIRECTIONS = {2: 24, 3: 40}  # of places around, by the number of axes
DISTANCES, DURATIONS = 8, 16  # of places around, and until rest
AT_REST = 1e-9  # of the clearance: paths that stay so near to their ends are at rest
NEAREST = 0.25  # of R: distance of the nearest places
MAX_TRIED = 100  # ways out of an agent that are tried, those of least change first
MAX_APART = 20  # other stops, of one in its way

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

    Args:
        mission: Limits of the vehicles.
        horizon: Horizon in which all have come to rest.
        reports: Reports of all agents of a component.

    Returns:
        Reports of those that change, as they are then.
    """
    now = sorted(reports, key=lambda report: report.agent)
    changed: dict[int, EvasionReport] = {}
    for a in sorted(range(len(now)), key=lambda row: now[row].priority):
        for row, report in _evade(mission, horizon, now, a).items():
            now[row] = changed[report.agent] = report
    return changed


def _evade(
    mission: Reconfiguration, horizon: AvoidanceHorizon, now: list[EvasionReport], row: int
) -> dict[int, EvasionReport]:
    """Find a way out for an agent, and the changes of all in its way; none where none is found."""
    own = now[row]
    for look in own.looks:
        if is_path_clear(own.path, look[1]):
            return {}
        each = [*now]
        each[row] = replace(own, looks=(look,))
        for u in islice(list_stops(mission, horizon, each[row]), MAX_TRIED):
            changed = _change_together(mission, horizon, each, row, u - own.u)
            if changed is not None:
                return changed | {row: replace(changed[row], looks=own.looks)}
    return {}


def _change_together(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    now: list[EvasionReport],
    row: int,
    change: Float[Array, "T m"],
) -> dict[int, EvasionReport] | None:
    """Change the controls of an agent, and of all that are met then; None where one cannot.

    One that cannot fly the same change stops in another way, which those that it meets fly then.
    """
    before, clearance = (np.array([getattr(r, k) for r in now]) for k in ("path", "clearance"))
    after, changed, left = before.copy(), dict[int, EvasionReport](), {row: change}
    while left:
        a, wanted = left.popitem()
        apart = (clearance + clearance[a]) / 2
        report = _change(mission, horizon, now[a], wanted)
        after[a] = before[a] if report is None else report.path
        keeps = _keep_clear(after, before, a, apart)
        if a != row and (report is None or not keeps[[*changed]].all()):
            report = _stop_apart(mission, horizon, now, a, after, apart, [*changed])
            after[a] = before[a] if report is None else report.path
            keeps = _keep_clear(after, before, a, apart)
        if report is None:
            return None
        changed[a] = report
        keeps[[*changed, *left]] = True
        left |= dict.fromkeys(np.flatnonzero(~keeps).tolist(), report.u - now[a].u)
    kept = (_keep_clear(after, before, a, (clearance + clearance[a]) / 2) for a in changed)
    return changed if all(own.all() for own in kept) else None


def _are_apart(
    path: Float[Array, "pieces 4 d"],
    paths: Float[Array, "agents pieces 4 d"],
    clearance: Float[Array, " agents"],
    rows: list[int],
) -> bool:
    """Tell whether a path is clear of those of some agents."""
    return bool(convexify.are_hulls_separated(path - paths[rows], clearance[rows]).all())


def _change(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    own: EvasionReport,
    change: Float[Array, "T m"],
) -> EvasionReport | None:
    """Change the controls of an agent; None where it may not or cannot fly so."""
    u, d = own.u + change, mission.axes
    x = horizon.discrete_model.simulate(own.state, u)
    if not _keep_limits(mission, own.agent, u[None], x[None])[0]:
        return None
    path = horizon.control_points(x, u)
    is_clear = any(is_path_clear(path, obstacles) for _, obstacles in own.looks)
    if is_clear and stays_within_reach(mission, horizon, x[:, :d], path):
        return replace(own, u=u, path=path)
    return None


def _stop_apart(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    now: list[EvasionReport],
    row: int,
    paths: Float[Array, "agents pieces 4 d"],
    clearance: Float[Array, " agents"],
    rows: list[int],
) -> EvasionReport | None:
    """Find a stop of an agent that is clear of some others, if possible of all; None without."""
    own, found = now[row], None
    everyone = [a for a in range(len(now)) if a != row]
    for u in islice(list_stops(mission, horizon, own, paths[rows], clearance[rows]), MAX_APART):
        report = _change(mission, horizon, own, u - own.u)
        if report and _are_apart(report.path, paths, clearance, rows):
            if _are_apart(report.path, paths, clearance, everyone):
                return report
            found = found or report
    return found


def _keep_clear(
    after: Float[Array, "agents pieces 4 d"],
    before: Float[Array, "agents pieces 4 d"],
    row: int,
    clearance: Float[Array, " agents"],
) -> Bool[Array, " agents"]:
    """Tell which agents one is clear of after a change, or no nearer to than it was before."""
    is_clear = np.array(convexify.are_hulls_separated(after[row] - after, clearance).all(axis=1))
    is_clear[row] = True
    for a in np.flatnonzero(~is_clear):
        now, kept = (float(hull_distance(own[row] - own[a])[0].min()) for own in (after, before))
        is_clear[a] = now >= min(float(clearance[a]), kept * (1 - ROUNDING))
    return is_clear


def _keep_limits(
    mission: Reconfiguration,
    agent: int,
    u: Float[Array, "ways T m"],
    x: Float[Array, "ways instants n"],
) -> Bool[Array, " ways"]:
    """Tell which controls and states keep the limits of an agent."""
    control, speed = mission.planned_control_limit(agent), mission.speed_limit(agent)
    is_beyond = control.is_exceeded(u).any(axis=1)
    return np.asarray(~(is_beyond | speed.is_exceeded(x[:, 1:, mission.axes :]).any(axis=1)))


def list_stops(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    own: EvasionReport,
    others: Float[Array, "others pieces 4 d"] | None = None,
    clearance: Sequence[float] | Float[Array, " others"] = (),
) -> Iterator[Float[Array, "T m"]]:
    """List stops of an agent, those of least change first.

    They are clear of others and of obstacles at the beginnings of all pieces; whether in between,
    too, is for the caller to check.

    Args:
        mission: Limits.
        horizon: Horizon in which all have come to rest.
        own: The agent, of whose looks the last counts.
        others: Control points of others.
        clearance: Distance to keep from each [m].
    """
    rest_steps, obstacles = own.looks[-1]
    latest = max(horizon.steps - 1 - rest_steps, 2)
    durations = np.unique(np.geomspace(2, latest, DURATIONS).round().astype(int))
    places = _list_places(mission)
    each = [move_and_rest(mission.step, own.state, places, n) for n in durations.tolist()]
    u = np.concatenate([np.pad(w, ((0, 0), (0, len(own.u) - w.shape[1]), (0, 0))) for w in each])
    x = horizon.discrete_model.simulate(np.broadcast_to(own.state, (len(u), len(own.state))), u)
    is_kept = _keep_limits(mission, own.agent, u, x)
    u, x = u[is_kept], x[is_kept]
    if not len(u):
        return
    points = horizon.control_points(x, u)[:, :, 0]
    for path, distance in zip(() if others is None else others, clearance, strict=True):
        is_clear = (np.linalg.norm(points - path[:, 0], axis=2) >= distance).all(axis=1)
        u, points = u[is_clear], points[is_clear]
    for one in range(0 if obstacles is None else len(obstacles.paths)):
        assert obstacles is not None
        is_clear = are_points_clear(points, obstacles, one).all(axis=1)
        u, points = u[is_clear], points[is_clear]
    yield from u[np.argsort(np.abs(u - own.u).sum(axis=(1, 2)), kind="stable")]


def _list_places(mission: Reconfiguration) -> Float[Array, "places d"]:
    """List places around an agent within its reach, from where it is; the first is there."""
    R, d = mission.largest_separation, mission.axes
    reach = min(longest_way(mission), mission.comm_radius)
    sizes = np.geomspace(NEAREST * R, max(reach, R), DISTANCES)
    around = sizes[:, None, None] * spread_directions(d, DIRECTIONS[d])
    return np.concatenate([np.zeros((1, d)), around.reshape(-1, d)])


def move_and_rest(
    h: float, start: Float[Array, " n"], places: Float[Array, "places d"], steps: int
) -> Float[Array, "places T m"]:
    """Return the controls of least energy that bring a double integrator to rest at places.

    They are linear in time: u[k] = a + b k, with h Σ u[k] = −v, and h² Σ (T − k − ½) u[k] the way
    that is left.

    Args:
        h: Step [s].
        start: State.
        places: Places, from where it is [m].
        steps: Steps T until it rests, 2 or more.
    """
    k = np.arange(steps)
    velocity, weight = start[len(start) // 2 :], steps - k - 0.5
    sums = np.array([[steps, k.sum()], [weight.sum(), (weight * k).sum()]])
    way = (places - steps * h * velocity) / h**2
    asked = np.stack([np.broadcast_to(-velocity / h, way.shape), way])
    a, b = np.linalg.solve(sums, asked.reshape(2, -1)).reshape(2, *way.shape)
    return np.asarray(a[:, None] + k[:, None] * b[:, None])
