"""Sampled stops: ways out of what moves, where no program about a nominal finds one.

A program is convex: about each obstacle it chooses a side. Between several that move, such as a
group of lost vehicles, the ways out are others for each place and each duration. Here many are
drawn up at once: controls of least energy to rest at places around, after several times.
"""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.convexify import AvoidanceHorizon
from problems.obstacle_paths import ObstaclePaths
from sato.obstacles import spread_directions
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.stopping import longest_way

DIRECTIONS = {2: 24, 3: 40}  # of places around, by the number of axes
DISTANCES, DURATIONS = 8, 8  # of places around, and until rest
NEAREST = 0.25  # of R: distance of the nearest places


def sample_stops(
    mission: Reconfiguration,
    horizon: AvoidanceHorizon,
    agent: int,
    start: Float[Array, " n"],
    others: Float[Array, "others pieces 4 d"],
    clearance: Float[Array, " others"],
    obstacles: ObstaclePaths,
    rest_steps: int,
) -> Iterator[Float[Array, "T m"]]:
    """List stops that keep clear at the beginnings of all pieces, those of least control first.

    Whether they do so in between is for the caller to check.

    Args:
        mission: Limits.
        horizon: Horizon in which all have come to rest.
        agent: Number of the agent.
        start: State of the agent.
        others: Control points of the others.
        clearance: Distance to keep from each [m].
        obstacles: Obstacles over the horizon.
        rest_steps: Steps at the end of the horizon for which the agent rests already.
    """
    d, latest = mission.axes, max(horizon.steps - 1 - rest_steps, 2)
    durations = np.unique(np.geomspace(2, latest, DURATIONS).round().astype(int))
    places = _list_places(mission)
    each = [_move_and_rest(mission, start, places, n, horizon.steps) for n in durations.tolist()]
    u = np.concatenate(each)
    limits = mission.planned_control_limit(agent), mission.speed_limit(agent)
    u = u[~limits[0].is_exceeded(u).any(axis=1)]
    x = horizon.discrete_model.simulate(np.broadcast_to(start, (len(u), 2 * d)), u)
    is_slow = ~limits[1].is_exceeded(x[:, 1:, d:]).any(axis=1)
    u, points = u[is_slow], horizon.control_points(x[is_slow], u[is_slow])[:, :, 0]
    is_point = obstacles.size == 0.0
    paths = np.concatenate([others, obstacles.paths[is_point]])
    kept = np.append(clearance, obstacles.clearance[is_point])
    for path, distance in zip(paths, kept, strict=True):
        is_clear = (np.linalg.norm(points - path[:, 0], axis=2) >= distance).all(axis=1)
        u, points = u[is_clear], points[is_clear]
    yield from u[np.argsort(np.abs(u).sum(axis=(1, 2)), kind="stable")]


def _list_places(mission: Reconfiguration) -> Float[Array, "places d"]:
    """List places around an agent within its reach, from where it is; the first is there."""
    R, d = mission.largest_separation, mission.axes
    reach = min(longest_way(mission), mission.comm_radius)
    sizes = np.geomspace(NEAREST * R, max(reach, R), DISTANCES)
    around = sizes[:, None, None] * spread_directions(d, DIRECTIONS[d])
    return np.concatenate([np.zeros((1, d)), around.reshape(-1, d)])


def _move_and_rest(
    mission: Reconfiguration,
    start: Float[Array, " n"],
    places: Float[Array, "places d"],
    duration: int,
    steps: int,
) -> Float[Array, "places T m"]:
    """Return the controls of least energy that bring an agent to rest at places after some steps.

    They are linear in time: u[k] = a + b k, with Δt Σ u[k] = −v, and Δt² Σ (n − k − ½) u[k] the
    way that is left. After them it rests.
    """
    d, h, k = mission.axes, mission.step, np.arange(duration)
    velocity, share = start[d:], duration - k - 0.5
    sums = np.array([[duration, k.sum()], [share.sum(), (share * k).sum()]])
    left = (places - duration * h * velocity) / h**2
    asked = np.stack([np.broadcast_to(-velocity / h, left.shape), left])
    a, b = np.linalg.solve(sums, asked.reshape(2, -1)).reshape(2, *left.shape)
    u = np.zeros((len(places), steps, d))
    u[:, :duration] = a[:, None] + k[:, None] * b[:, None]
    return u
