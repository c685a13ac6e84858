"""Search for stops of a vehicle among bodies in motion, over many sides to pass them at once.

A program is convex, and passes each body on the side of its nominal. A search is not: it keeps
some hundreds of states that a vehicle can be in after each step, spread over all that it can reach,
and lists how it can stop from these.
"""

from collections.abc import Iterator
from itertools import product
from math import ceil

import numpy as np
from jaxtyping import Bool, Float
from numpy import ndarray as Array

from problems.convexify import AvoidanceHorizon
from problems.limit import Limit
from problems.obstacle_paths import ObstaclePaths, are_points_clear
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.stopping import count_stop_steps, longest_way

MAX_STATES = 500  # that are kept after a step
CELL = 0.04  # of R: states that are nearer to each other count as one


def search_stops(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    agent: int,
    start: Float[Array, " n"],
    rest_steps: int,
    bodies: ObstaclePaths,
) -> Iterator[Float[Array, "T m"]]:
    """List stops of a vehicle, those that rest earliest first.

    They keep its limits, and are clear of all bodies at the beginnings of pieces; whether in
    between, too, is for the caller to check. It rests for so many steps at the end of the
    horizon.
    """
    limit, speed = mission.planned_control_limit(agent), mission.stop_speed_limit(agent)
    d, h, S = mission.axes, mission.step, horizon.pieces_per_step
    signs = np.array(list(product((0.0, -1.0, 1.0), repeat=d)))
    choices = limit.cut(limit.most * limit.shares * signs)
    # Controls are held until they make a difference, at short steps and low thrust too.
    size = CELL * mission.least_separation
    held = max(1, ceil((2 * size / limit.least_length) ** 0.5 / h))
    time = np.arange(1, held * S + 1)[:, None] / S * h
    cell, latest = size / np.repeat([1.0, held * h], d), horizon.steps - 1 - rest_steps
    x, u = start[None], np.zeros((1, 0, d))
    for k in range(0, max(latest, 1), held):
        yield from _list_stops(horizon, limit, x, u, bodies, latest)
        before = np.repeat(x, len(choices), axis=0)
        control = np.tile(choices, (len(x), 1))
        p, v = before[:, None, :d], before[:, None, d:]
        points = p + time * v + time**2 / 2 * control[:, None]
        after = np.hstack([points[:, -1], before[:, d:] + held * h * control])
        keep = ~speed.is_exceeded(after[:, d:])
        keep &= np.linalg.norm(after[:, :d] - start[:d], axis=1) <= longest_way(mission)
        keep[keep] = _are_clear(horizon.scale_points(points[keep]), bodies, k * S + 1)
        kept = _thin_out(after[keep], cell)
        x, rows = after[keep][kept], np.flatnonzero(keep)[kept]
        flown = np.repeat(control[rows, None], held, axis=1)
        u = np.concatenate([u[rows // len(choices)], flown], axis=1)
        if not len(x):
            return


def _list_stops(
    horizon: AvoidanceHorizon,
    limit: Limit,
    x: Float[Array, "states n"],
    u: Float[Array, "states k m"],
    bodies: ObstaclePaths,
    latest: int,
) -> Iterator[Float[Array, "T m"]]:
    """List the stops at once from states that are clear, those of least control first."""
    d, h, S, k = u.shape[2], horizon.discrete_model.dt, horizon.pieces_per_step, u.shape[1]
    velocity = x[:, d:]
    count = count_stop_steps(limit, velocity, h)
    rows = np.flatnonzero(k + count <= latest)
    if not len(rows):
        return
    time = (np.arange((horizon.steps - k) * S) / S * h)[:, None]
    last = (count[rows] * h)[:, None, None]
    moving = np.minimum(time, last)
    p, v = x[rows, None, :d], velocity[rows, None]
    points = p + moving * v - moving**2 / 2 * v / np.maximum(last, h)
    rows = rows[_are_clear(horizon.scale_points(points), bodies, k * S)]
    controls = np.zeros((len(rows), horizon.steps, d))
    controls[:, :k] = u[rows]
    for own, a in zip(controls, rows, strict=True):
        own[k : k + count[a]] = -velocity[a] / (max(count[a], 1) * h)
    yield from controls[np.argsort(np.abs(controls).sum(axis=(1, 2)), kind="stable")]


def _are_clear(
    points: Float[Array, "ways pieces d"], bodies: ObstaclePaths, first: int
) -> Bool[Array, " ways"]:
    """Tell which ways are clear at the beginnings of pieces, from one on."""
    clear = np.ones(len(points), dtype=bool)
    pieces = np.minimum(np.arange(first, first + points.shape[1]), bodies.paths.shape[1] - 1)
    now = bodies._replace(paths=bodies.paths[:, pieces])
    for one in range(len(bodies.paths)):
        clear[clear] = are_points_clear(points[clear], now, one).all(axis=1)
    return clear


def _thin_out(x: Float[Array, "states n"], cell: Float[Array, " n"]) -> Array:
    """Choose states that lie apart, evenly in the order of their cells."""
    _, rows = np.unique(np.round(x / cell).astype(np.int64), axis=0, return_index=True)
    if len(rows) <= MAX_STATES:
        return np.asarray(rows)
    return np.asarray(rows[np.linspace(0, len(rows) - 1, MAX_STATES).astype(int)])
