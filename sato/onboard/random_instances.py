"""Random questions for the code on board: flights among neighbours that pass by closely."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.avoidance import HalfSpaces
from problems.convexify import are_hulls_separated, choose_normals, convexify
from sato.onboard.problem import OnboardProblem


class OnboardInstance(NamedTuple):
    """Where to fly, and what to keep clear of."""

    start: Float[Array, " n"]
    target: Float[Array, " n"]
    half_spaces: HalfSpaces


def random_instances(asked: OnboardProblem, rng: np.random.Generator) -> Iterator[OnboardInstance]:
    """Questions that have an answer, one after another without end.

    A flight under random controls leads from the start to the goal, and half-spaces are those
    about it and its neighbours, all of which it keeps. It is far from the best, so that the
    best one leans on them.
    """
    T = len(asked.program.transfer.model)
    while True:
        x, u = _random_transfer(asked, rng)
        nominal = asked.horizon.control_points(x, u)
        paths = np.stack(
            [_neighbor_control_points(asked, nominal, rng) for _ in range(asked.neighbors)]
        )
        normal = choose_normals(nominal - paths, asked.horizon.required_separation)
        yield OnboardInstance(x[0], x[-1], convexify(asked.horizon, T, paths, normal))


def _random_transfer(asked: OnboardProblem, rng: np.random.Generator) -> tuple[Array, Array]:
    transfer = asked.program.transfer
    steps, limit = transfer.model, transfer.max_speed
    T, d, R = len(steps), steps.axes, asked.horizon.collision_radius
    u = transfer.max_control * rng.uniform(-1, 1, (T, d))
    speed = min(limit, transfer.max_control * T * steps.dt) / 4
    start = np.concatenate([rng.normal(0, 5 * R, d), rng.normal(0, speed, d)])
    x = steps.simulate(start, u)
    # Without drift the motion is linear: a smaller start and thrust are as much slower.
    slower = min(1.0, float(limit / np.linalg.norm(x[:, d:], axis=1).max()))
    return steps.simulate(slower * start, slower * u), slower * u


def _neighbor_control_points(
    asked: OnboardProblem, nominal: Float[Array, "pieces 4 d"], rng: np.random.Generator
) -> Float[Array, "pieces 4 d"]:
    x, u = _random_transfer(asked, rng)
    theirs, R = asked.horizon.control_points(x, u), asked.horizon.collision_radius
    meet = int(rng.integers(len(theirs)))
    aside = rng.standard_normal((theirs.shape[-1],))
    aside = aside / np.linalg.norm(aside)
    distance = float(R * rng.uniform(1, 1.5))
    while True:
        path = theirs - theirs[meet, 0] + nominal[meet, 0] + distance * aside
        if are_hulls_separated(nominal - path, asked.horizon.required_separation).all():
            return np.asarray(path)
        distance *= 1.2
