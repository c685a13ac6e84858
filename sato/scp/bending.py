"""Bending of paths: those that come too close push each other aside, head-on to the right."""

from collections.abc import Sequence
from math import ceil, inf
from typing import Annotated, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.units import MAY_BE_INFINITE
from problems.obstacle_paths import nearest_points, select_near
from problems.path_separation import enclosing_balls, near_pieces
from sato.network.graph import CommunicationGraph
from sato.network.rounds import run_round
from sato.scp.planner import Planner, pair_clearances

ROOM = 1.1  # distance to which paths are pushed, over the one that is kept
GAIN = 1.7  # by which a push exceeds what is lacking, as others average it
SMOOTHING = 4.0  # duration of a push, over the time in which full control covers the distance
SLOW = 0.02  # of the distance, moved in a piece: two that are slower push straight apart
TOUCH = 1e-3  # of the distance: two that miss each other by less meet head-on
TINY = 1e-300  # in place of zero, to divide by


class PathMessage(NamedTuple):
    """Message of an agent while paths push each other aside."""

    rank: Annotated[float, MAY_BE_INFINITE]  # class of priority
    path: Float[Array, "pieces d"]
    clearance: float  # that two of the sender's kind would keep [m]
    target: Float[Array, " d"]  # position [m]
    is_delayed: bool
    number_count: int = 0  # real numbers that tell the path of a planner that has just begun


def bend_all(now: dict[int, Planner], graph: CommunicationGraph) -> dict[int, Planner]:
    """Bend the paths of all agents in one round, those alone that are too near to others."""
    ids, paths, own = stack_paths(now)
    path = paths[:, :, 0]
    middle, extent = enclosing_balls(path)
    i, j = graph.pairs_among(np.array(ids, dtype=int))
    most = extent[i] + extent[j] + (own[i] + own[j]) / 2
    near = np.linalg.norm(middle[i] - middle[j], axis=1) < most
    i, j = i[near], j[near]
    some = np.unique(near_pieces(path[:, :, None], i, j, (own[i] + own[j]) / 2)[0])
    i, j = i[some], j[some]
    apart, R = np.linalg.norm(path[i] - path[j], axis=2), (own[i] + own[j]) / 2
    last = np.array([count_pieces_left(agent) - 1 for agent in now.values()])
    met = _are_too_near(apart, R, last[i]) | _are_too_near(apart, R, last[j])
    adjacency, ids_met = np.zeros_like(graph.adjacency), np.array(ids)[np.stack([i, j])[:, met]]
    adjacency[ids_met[0], ids_met[1]] = adjacency[ids_met[1], ids_met[0]] = True
    beside = [k for k, agent in now.items() if agent.obstacles is not None]
    acting = {k: now[k] for k in sorted({*ids_met.flatten().tolist(), *beside})}
    messages = {k: path_message(now[k]) for k in acting}
    return run_round(CommunicationGraph(adjacency, graph.alive), acting, bend, messages)


def stack_paths(now: dict[int, Planner]) -> tuple[list[int], Array, Float[Array, " agents"]]:
    """Return the agents' numbers, their control points and their clearances [m]."""
    paths = np.stack([agent.control_points for agent in now.values()])
    return list(now), paths, np.array([agent.horizon.clearance for agent in now.values()])


def path_message(agent: Planner) -> PathMessage:
    """Return the message of an agent whose path is pushed aside."""
    path, d = agent.control_points[:, 0], agent.control_points.shape[-1]
    target = agent.horizon.scale_points(agent.target_state[:d])
    own = agent.horizon.clearance, target, agent.is_delayed, agent.number_count
    return PathMessage(agent.priority[0], path, *own)


def bend(agent: Planner, inbox: Sequence[PathMessage]) -> Planner:
    """Push the path of an agent away from those, and from obstacles, that it is too near to."""
    inbox = [*inbox, *obstacle_messages(agent)]
    if not can_move(agent) or not inbox:
        return agent
    path, last = agent.control_points[:, 0], count_pieces_left(agent) - 1
    rank = np.array([other.rank for other in inbox])
    share = np.where(rank == agent.priority[0], 0.5, rank < agent.priority[0])
    R = pair_clearances(inbox, agent.horizon.clearance)
    relative = path - np.stack([other.path for other in inbox])
    apart = np.linalg.norm(relative, axis=2)
    near = _are_too_near(apart, R, last) & (share > 0)
    if not near.any():
        return agent
    wanted = np.minimum(ROOM * R, np.minimum(apart[:, 0], apart[:, last]))[near]
    push = share[near, None, None] * push_apart(relative[near], wanted)
    count = np.maximum(push.any(axis=2).sum(axis=0), 1)
    shift = _smooth(agent, push.sum(axis=0) / count[:, None], float(R[near].max()))
    pushed = agent.control_points + interpolate_shift(shift)
    return agent._replace(control_points=pushed, has_converged=False)


def obstacle_messages(agent: Planner) -> list[PathMessage]:
    """Return what obstacles would say, if each were its point that is nearest to the agent."""
    if agent.obstacles is None:
        return []
    obstacles = select_near(agent.control_points, agent.obstacles, ROOM)
    own = agent.horizon.clearance
    nearest, target = nearest_points(agent.control_points, obstacles), agent.target_state
    each = zip(nearest, (2 * obstacles.clearance - own).tolist(), strict=True)
    return [PathMessage(-inf, path, R, target, False) for path, R in each]


def _are_too_near(
    apart: Float[Array, "others pieces"],
    wanted: Float[Array, " others"],
    last: int | Int[Array, " others"],
) -> Bool[Array, " others"]:
    """Find paths that come nearer than wanted, and than at their starts and in a last piece."""
    ends = np.minimum(apart[:, 0], apart[np.arange(len(apart)), last])
    return np.asarray(apart.min(axis=1) < np.minimum(wanted, ends))


def push_apart(
    relative: Float[Array, "others pieces d"], wanted: Float[Array, " others"]
) -> Float[Array, "others pieces d"]:
    """Return what keeps a path at wanted distances [m] of others, across the relative motion [m].

    Two that meet head-on go each to its right.
    """
    pieces, R = relative.shape[1], wanted[:, None]
    k = np.arange(pieces)
    before, after = np.maximum(k - 1, 0), np.minimum(k + 1, pieces - 1)
    span = np.maximum(after - before, 1)[:, None]
    motion = (relative[:, after] - relative[:, before]) / span
    apart, speed = np.linalg.norm(relative, axis=2), np.linalg.norm(motion, axis=2)
    along = motion / np.maximum(speed, TINY)[..., None]
    ahead = (relative * along).sum(axis=2)
    way = relative - ahead[..., None] * along
    miss = np.linalg.norm(way, axis=2)
    lacking = np.sqrt(np.maximum(R**2 - ahead**2, 0.0)) - miss
    is_slow = speed < SLOW * R
    lacking = np.where(is_slow, R - apart, lacking)
    way = np.where(is_slow[..., None], relative, way)
    right = np.zeros_like(way)
    right[..., 0] = np.where((along[..., :2] == 0).all(axis=2), 1.0, along[..., 1])
    right[..., 1] = -along[..., 0]
    way = np.where(((miss < TOUCH * R) & ~is_slow)[..., None], right, way)
    size = np.where(apart < R, np.maximum(lacking, 0.0), 0.0)
    length = np.maximum(np.linalg.norm(way, axis=2), TINY)
    return np.asarray(size[..., None] * way / length[..., None])


def _smooth(agent: Planner, push: Float[Array, "pieces d"], R: float) -> Float[Array, "k d"]:
    """Smooth a push over the time that it takes to follow it; none at the ends."""
    pieces, h = len(push), agent.horizon.fine_model.dt
    wide = max(2, ceil(SMOOTHING * (R / agent.transfer.control_limit.least_length) ** 0.5 / h))
    window = np.hanning(2 * wide + 1)
    smooth = np.stack([np.convolve(one, window)[wide : wide + pieces] for one in push.T], axis=1)
    largest, now = (np.linalg.norm(part, axis=1).max() for part in (push, smooth))
    k, end = np.arange(pieces + 1), count_pieces_left(agent)
    ramp = np.minimum(1.0, np.minimum(k, np.maximum(end - k, 0)) / wide) ** 2
    shift = np.vstack([smooth, smooth[-1]]) * ramp[:, None]
    return np.asarray(GAIN * largest / max(now, TINY) * shift)


def interpolate_shift(shift: Float[Array, "k d"]) -> Float[Array, "pieces 4 d"]:
    """Interpolate shifts at the beginning of each piece to its four control points."""
    third = np.linspace(0.0, 1.0, 4)[:, None]
    return np.asarray(shift[:-1, None] * (1 - third) + shift[1:, None] * third)


def count_pieces_left(agent: Planner) -> int:
    """Count the pieces of an agent's path to the end of its last step, within the horizon."""
    return min(len(agent.nominal.u), agent.horizon.steps) * agent.horizon.pieces_per_step


def can_move(agent: Planner) -> bool:
    """Return True for an agent that has steps left and gives way to others."""
    return len(agent.nominal.u) > 0 and agent.priority[0] > -inf
