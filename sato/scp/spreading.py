"""Spreading of paths to dense groups of targets, between which nobody can pass.

Where targets of a group in the plane are less than 2 R apart, those that have arrived close the
ways to the others. Once one is delayed, the paths of those that hear it lead to their targets as if
the group were so much larger that each can pass between any two, and from there gather at the same
pace. Each knows of the group what it hears: where that is not all, it spreads about another center.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array
from scipy.spatial.distance import cdist

from sato.network.graph import CommunicationGraph, label_components
from sato.network.rounds import run_round
from sato.scp.bending import (
    PathMessage,
    can_move,
    count_pieces_left,
    interpolate_shift,
    path_message,
)
from sato.scp.planner import Planner

PASSAGE = 2.0  # of R, between two that one more can pass
NEIGHBORS = 2.5  # least mean number within a passage in a dense group; on a ring there are two
MIN_GROWTH = 0.05  # of a group that is worth the way
MIN_PIECES = 8  # of a path that has the time for it
SPREAD, GATHER = 0.5, 0.6  # of the way, after which the group is spread, and begins to gather


def spread_all(now: dict[int, Planner], graph: CommunicationGraph) -> dict[int, Planner]:
    """Spread the paths of all agents in one round, where they hear of one that is delayed."""
    delayed = np.zeros(len(graph.alive), dtype=bool)
    delayed[[i for i, agent in now.items() if agent.is_delayed]] = True
    hears = delayed | (graph.adjacency & delayed).any(axis=1)
    acting = {i: agent for i, agent in now.items() if hears[i]}
    messages = {i: path_message(agent) for i, agent in now.items()} if acting else {}
    return now | run_round(graph, acting, spread_out, messages)


def spread_out(agent: Planner, inbox: Sequence[PathMessage]) -> Planner:
    """Spread the path that an agent would take alone, where any that it hears is delayed.

    Its target is in a dense group. One to which all that it hears give way flies straight.
    """
    rank, pieces = agent.priority[0], count_pieces_left(agent)
    is_asked = agent.is_delayed or any(message.is_delayed for message in inbox)
    gives_way = can_move(agent) and any(message.rank <= rank for message in inbox)
    if not (is_asked and gives_way and pieces >= MIN_PIECES):
        return agent
    heard = [path_message(agent), *inbox]
    clearance = max(message.clearance for message in heard)
    shift = find_shift(np.stack([message.target for message in heard]), clearance)
    if shift is None:
        return agent
    alone = agent.horizon.control_points(agent.solo.x, agent.solo.u)
    along = np.arange(len(alone) + 1) / pieces
    share = np.where(along < GATHER, _rise(along / SPREAD), _rise((1 - along) / (1 - GATHER)))
    path = alone + interpolate_shift(share[:, None] * shift)
    return agent._replace(control_points=path, has_converged=False)


def find_shift(targets: Float[Array, "heard d"], clearance: float) -> Float[Array, " d"] | None:
    """Find by how much the first target moves in a group that grows until all can pass [m].

    None where it is in no dense group in the plane, or where that is large enough. The clearance
    is R, that two keep [m].
    """
    if targets.shape[1] != 2:
        return None
    apart = cdist(targets, targets)
    near = (apart < PASSAGE * clearance) & ~np.eye(len(targets), dtype=bool)
    label = label_components(near, np.ones(len(targets), dtype=bool))
    group = np.flatnonzero(label == label[0])
    if near[group].sum() < NEIGHBORS * len(group):
        return None
    gap = float(apart[near & (label == label[0])[:, None]].min())
    growth = PASSAGE * clearance / max(gap, clearance) - 1
    return growth * (targets[0] - targets[group].mean(axis=0)) if growth > MIN_GROWTH else None


def _rise(x: Float[Array, " k"]) -> Float[Array, " k"]:
    """Rise smoothly from 0 to 1 as x does."""
    x = np.clip(x, 0.0, 1.0)
    return np.asarray(x * x * (3 - 2 * x))
