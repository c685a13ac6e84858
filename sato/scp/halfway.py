"""Meeting halfway: agents in conflict give way at once, and share what it costs.

By priority the first flies straight and the last goes around all, if it can. Where many pass
through one place, all give way instead. In rounds of messages, paths that come too close push each
other aside, those that meet head-on to their right. Then each agent looks for the trajectory of
least cost on its side of the planes halfway between its path and those of all others. All do so
at once: two that keep to their sides keep the distance. An agent that finds none takes the one that
enters the others' sides by least, and in the next round these make room for it.

An agent gives way alone to those of a higher class of priority, and to none of a lower one.
"""

from collections.abc import Callable, Mapping, Sequence
from math import ceil, inf
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from scipy.spatial.distance import cdist

from problems import convexify
from problems.avoidance import Relaxation
from sato.network.graph import CommunicationGraph
from sato.network.rounds import run_round
from sato.scp.planner import (
    VIOLATION_TOLERANCE,
    Planner,
    TrajectoryMessage,
    is_clear,
    solve_around,
)

MAX_BENDS = 40  # rounds in which paths push each other aside
MEETINGS = 6  # rounds in which trajectories are solved for
IMPROVEMENTS = 4  # programs of an agent, after which it acts only where it has to
IMPROVEMENTS_OF_PLAN = 1  # the same of one that begins with a plan
RELAXATIONS: tuple[Relaxation, ...] = ("none", "half-spaces")
ROOM = 1.1  # distance to which paths are pushed, over the one that is kept
GAIN = 1.7  # by which a push exceeds what is lacking, as others average it
SMOOTHING = 4.0  # duration of a push, over the time in which full control covers the distance
SLOW = 0.02  # of the distance, moved in a piece: two that are slower push straight apart
TOUCH = 1e-3  # of the distance: two that miss each other by less meet head-on


class PathMessage(NamedTuple):
    """Message of an agent while paths push each other aside."""

    rank: float  # class of priority
    path: Float[Array, "pieces d"]
    clearance: float  # that two of the sender's kind would keep [m]


def meet_halfway(
    planners: Mapping[int, Planner], graph: CommunicationGraph
) -> tuple[dict[int, Planner], int]:
    """Let all agents bend their paths and solve for trajectories, in rounds.

    The batched equivalent of `halfway_stages`: agents that have nothing to change are left out.

    Args:
        planners: Planner of each agent, by its number; of horizons with equal steps.
        graph: Communication graph.

    Returns:
        The planners, and the number of rounds.
    """
    now, bends = _repeat(MAX_BENDS, _bend_all, dict(planners), graph)
    now, meetings = _repeat(MEETINGS, _solve_all, now, graph)
    return {i: come_after(agent) for i, agent in now.items()}, bends + meetings


def _repeat(
    most: int,
    update: Callable[[dict[int, Planner], CommunicationGraph], dict[int, Planner]],
    now: dict[int, Planner],
    graph: CommunicationGraph,
) -> tuple[dict[int, Planner], int]:
    """Repeat a round of messages until it changes nothing; return the number of rounds."""
    for rounds in range(most):
        updated = update(now, graph)
        if all(updated[i] is now[i] for i in updated):
            return now, rounds + 1
        now = now | updated
    return now, most


def _bend_all(now: dict[int, Planner], graph: CommunicationGraph) -> dict[int, Planner]:
    ids, paths, own = _stack_paths(now)
    path = paths[:, :, 0]
    middle, extent = convexify.enclosing_balls(path)
    most = extent[:, None] + extent + (own[:, None] + own) / 2
    near = graph.adjacency[np.ix_(ids, ids)] & (cdist(middle, middle) < most)
    i, j = np.nonzero(np.triu(near))
    apart, R = np.linalg.norm(path[i] - path[j], axis=2), (own[i] + own[j]) / 2
    last = np.array([_pieces_left(agent) - 1 for agent in now.values()])
    met = _are_too_near(apart, R, last[i]) | _are_too_near(apart, R, last[j])
    adjacency, ids_met = np.zeros_like(graph.adjacency), np.array(ids)[np.stack([i, j])[:, met]]
    adjacency[ids_met[0], ids_met[1]] = adjacency[ids_met[1], ids_met[0]] = True
    acting = {k: now[k] for k in np.unique(ids_met).tolist()}
    messages = {k: path_message(now[k]) for k in acting}
    return run_round(CommunicationGraph(adjacency, graph.alive), acting, bend, messages)


def _solve_all(now: dict[int, Planner], graph: CommunicationGraph) -> dict[int, Planner]:
    ids, paths, own = _stack_paths(now)
    rank = np.array([now[i].priority[0] for i in ids])
    heard = graph.adjacency[np.ix_(ids, ids)]
    i, j = np.nonzero(np.triu(heard))
    meets = ~convexify.are_paths_separated(paths, i, j, (own[i] + own[j]) / 2)
    i, j = i[meets], j[meets]
    acts = np.array([_improves(now[k]) for k in ids])
    acts[i[rank[j] <= rank[i]]] = acts[j[rank[i] <= rank[j]]] = True
    messages = {k: agent.message for k, agent in now.items()}
    acting = {k: now[k] for k, is_acting in zip(ids, acts, strict=True) if is_acting}
    return run_round(graph, acting, solve_halfway, messages)


def _stack_paths(now: dict[int, Planner]) -> tuple[list[int], Array, Float[Array, " agents"]]:
    """Return the agents' numbers, their control points and their clearances [m]."""
    paths = np.stack([agent.control_points for agent in now.values()])
    return list(now), paths, np.array([agent.horizon.clearance for agent in now.values()])


def path_message(agent: Planner) -> PathMessage:
    """Return the message of an agent whose path is pushed aside."""
    path, R = agent.control_points[:, 0], agent.horizon.clearance
    return PathMessage(agent.priority[0], path, R)


def bend(agent: Planner, inbox: Sequence[PathMessage]) -> Planner:
    """Push the path of an agent away from those that it is too near to."""
    if not _can_move(agent) or not inbox:
        return agent
    path, last = agent.control_points[:, 0], _pieces_left(agent) - 1
    rank = np.array([other.rank for other in inbox])
    share = np.where(rank == agent.priority[0], 0.5, rank < agent.priority[0])
    R = (np.array([other.clearance for other in inbox]) + agent.horizon.clearance) / 2
    relative = path - np.stack([other.path for other in inbox])
    apart = np.linalg.norm(relative, axis=2)
    near = _are_too_near(apart, R, last) & (share > 0)
    if not near.any():
        return agent
    wanted = np.minimum(ROOM * R, np.minimum(apart[:, 0], apart[:, last]))[near]
    push = share[near, None, None] * push_apart(relative[near], wanted)
    count = np.maximum(push.any(axis=2).sum(axis=0), 1)
    shift = _smooth(agent, push.sum(axis=0) / count[:, None], float(R[near].max()))
    return agent._replace(control_points=agent.control_points + _spread(shift), has_converged=False)


def _are_too_near(
    apart: Float[Array, "others pieces"],
    wanted: Float[Array, " others"],
    last: int | Int[Array, " others"],
) -> Bool[Array, " others"]:
    """Find paths that come nearer than wanted, and than where they begin and end in a last piece."""
    ends = np.minimum(apart[:, 0], apart[np.arange(len(apart)), last])
    return np.asarray(apart.min(axis=1) < np.minimum(wanted, ends))


def push_apart(
    relative: Float[Array, "others pieces d"], wanted: Float[Array, " others"]
) -> Float[Array, "others pieces d"]:
    """Return what keeps a path at wanted distances of others, across the relative motion [m].

    Two that meet head-on go each to its right.
    """
    R = wanted[:, None]
    motion = np.gradient(relative, axis=1)
    speed = np.linalg.norm(motion, axis=2, keepdims=True)
    along = motion / np.maximum(speed, 1e-300)
    before = (relative * along).sum(axis=2)
    side = relative - before[..., None] * along
    miss, apart = (np.linalg.norm(part, axis=2) for part in (side, relative))
    right = np.zeros_like(along)
    right[..., 0], right[..., 1] = along[..., 1], -along[..., 0]
    right[~right.any(axis=2), 0] = 1.0  # straight up or down
    is_slow, head_on = speed[..., 0] < SLOW * R, miss < TOUCH * R
    way = np.where(is_slow[..., None], relative, np.where(head_on[..., None], right, side))
    way /= np.maximum(np.linalg.norm(way, axis=2, keepdims=True), 1e-300)
    across = np.sqrt(np.maximum(R**2 - before**2, 0.0)) - miss
    lacking = np.where(apart < R, np.where(is_slow, R - apart, across), 0.0)
    return np.asarray(np.maximum(lacking, 0.0)[..., None] * way)


def _smooth(agent: Planner, push: Float[Array, "pieces d"], R: float) -> Float[Array, "k d"]:
    """Spread a push over the time that it takes to follow it; none at the ends."""
    pieces, h = len(push), agent.horizon.fine_model.dt
    wide = max(2, ceil(SMOOTHING * (R / agent.transfer.control_limit.least_length) ** 0.5 / h))
    window = np.hanning(2 * wide + 1)
    spread = [np.convolve(one, window)[wide : wide + pieces] for one in push.T]
    smooth = np.stack(spread, axis=1)
    largest, now = (np.linalg.norm(part, axis=1).max() for part in (push, smooth))
    k, end = np.arange(pieces + 1), _pieces_left(agent)
    ramp = np.minimum(1.0, np.minimum(k, np.maximum(end - k, 0)) / wide) ** 2
    shift = np.vstack([smooth, smooth[-1]]) * ramp[:, None]
    return np.asarray(GAIN * largest / max(now, 1e-300) * shift)


def _spread(shift: Float[Array, "k d"]) -> Float[Array, "pieces 4 d"]:
    """Interpolate shifts at the beginning of each piece to its four control points."""
    third = np.linspace(0.0, 1.0, 4)[:, None]
    return np.asarray(shift[:-1, None] * (1 - third) + shift[1:, None] * third)


def _pieces_left(agent: Planner) -> int:
    return min(len(agent.nominal.u), agent.horizon.steps) * agent.horizon.pieces_per_step


def _can_move(agent: Planner) -> bool:
    return len(agent.nominal.u) > 0 and agent.priority[0] > -inf


def solve_halfway(agent: Planner, inbox: Sequence[TrajectoryMessage]) -> Planner:
    """Solve for the trajectory on the agent's side of the planes halfway to all others.

    Where there is none, it solves for the one that passes them by least, and the others make room
    in the next round.
    """
    nominal, R = agent.control_points, agent.horizon.clearance
    inbox = [other for other in inbox if other.priority[0] <= agent.priority[0]]
    if not _can_move(agent) or not inbox:
        return agent
    if not _improves(agent) and is_clear(nominal, inbox, R):
        return agent
    middles = [
        other._replace(
            control_points=(other.control_points + nominal) / 2, clearance=(other.clearance - R) / 2
        )
        if other.priority[0] == agent.priority[0]
        else other
        for other in inbox
    ]
    # One that found none in the last round is likely to find none.
    least = VIOLATION_TOLERANCE * R
    relaxations = RELAXATIONS[1:] if agent.slack > least else RELAXATIONS
    for relaxation in relaxations:
        agent = agent._replace(solve_count=agent.solve_count + 1)
        result = solve_around(agent, middles, nominal, "same", relaxation)
        if result is not None:
            return agent.with_result(result)._replace(has_converged=result.slack <= least)
    return agent


def _improves(agent: Planner) -> bool:
    # Its path was pushed aside, or what it has found may still become better.
    most = IMPROVEMENTS_OF_PLAN if agent.has_plan else IMPROVEMENTS
    return not agent.has_converged or 0 < agent.solve_count < most


def come_after(agent: Planner) -> Planner:
    """Return an agent that has found no trajectory with a lower priority than those that have."""
    if agent.has_converged or not _can_move(agent):
        return agent
    rank, spent, number = agent.priority
    return agent._replace(priority=(rank + 1.0, spent, number))
