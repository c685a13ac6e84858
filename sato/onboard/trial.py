"""Random questions for the code on board: flights among neighbours that pass by closely."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.avoidance import HalfSpaces
from problems.convexify import apart, half_spaces, normals
from sato.onboard.asked import Asked


class Question(NamedTuple):
    """Where to fly, and what to keep clear of."""

    start: Float[Array, " n"]
    goal: Float[Array, " n"]
    spaces: HalfSpaces


def questions(asked: Asked, rng: np.random.Generator) -> Iterator[Question]:
    """Questions that have an answer, one after another without end.

    A flight under random controls leads from the start to the goal, and half-spaces are those
    about it and its neighbours, all of which it keeps. It is far from the best, so that the
    best one leans on them.
    """
    T = len(asked.programme.transfer.steps)
    while True:
        x, u = _flight(asked, rng)
        nominal = asked.horizon.path(x, u)
        paths = np.stack([_neighbour(asked, nominal, rng) for _ in range(asked.neighbours)])
        normal = normals(nominal - paths, asked.horizon.keep)
        yield Question(x[0], x[-1], half_spaces(asked.horizon, T, paths, normal))


def _flight(asked: Asked, rng: np.random.Generator) -> tuple[Array, Array]:
    transfer = asked.programme.transfer
    steps, limit = transfer.steps, transfer.max_speed
    T, d, R = len(steps), steps.axes, asked.horizon.radius
    u = transfer.max_control * rng.uniform(-1, 1, (T, d))
    speed = min(limit, transfer.max_control * T * steps.dt) / 4
    start = np.concatenate([rng.normal(0, 5 * R, d), rng.normal(0, speed, d)])
    x = steps.roll(start, u)
    # Without drift the motion is linear: a smaller start and thrust are as much slower.
    slower = min(1.0, float(limit / np.linalg.norm(x[:, d:], axis=1).max()))
    return steps.roll(slower * start, slower * u), slower * u


def _neighbour(
    asked: Asked, nominal: Float[Array, "pieces 4 d"], rng: np.random.Generator
) -> Float[Array, "pieces 4 d"]:
    x, u = _flight(asked, rng)
    theirs, R = asked.horizon.path(x, u), asked.horizon.radius
    meet = int(rng.integers(len(theirs)))
    aside = rng.standard_normal((theirs.shape[-1],))
    aside = aside / np.linalg.norm(aside)
    distance = float(R * rng.uniform(1, 1.5))
    while True:
        path = theirs - theirs[meet, 0] + nominal[meet, 0] + distance * aside
        if apart(nominal - path, asked.horizon.keep).all():
            return np.asarray(path)
        distance *= 1.2
