"""Random instances for onboard code: transfers among neighbors that pass closely."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from problems.avoidance import HalfSpaces
from problems.convexify import are_hulls_separated, choose_normals, convexify
from sato.onboard.problem import OnboardProblem


class OnboardInstance(NamedTuple):
    """Start, target and half-spaces of a transfer."""

    start: Float[Array, " n"]
    target: Float[Array, " n"]
    half_spaces: HalfSpaces


def random_instances(
    problem: OnboardProblem, rng: np.random.Generator
) -> Iterator[OnboardInstance]:
    """Generate feasible instances without end.

    A trajectory under random controls defines start and target, and the half-spaces are those
    between it and its neighbors, so that it is feasible. It is far from optimal, so that some of
    the half-spaces bind at the optimum.
    """
    T = len(problem.program.transfer.model)
    while True:
        x, u = _random_transfer(problem, rng)
        nominal = problem.horizon.control_points(x, u)
        others = np.stack(
            [_neighbor_control_points(problem, nominal, rng) for _ in range(problem.neighbors)]
        )
        normal = choose_normals(nominal - others, problem.horizon.required_separation)
        yield OnboardInstance(x[0], x[-1], convexify(problem.horizon, T, others, normal))


def _random_transfer(problem: OnboardProblem, rng: np.random.Generator) -> tuple[Array, Array]:
    transfer = problem.program.transfer
    model, limit = transfer.model, transfer.max_speed
    T, d, R = len(model), model.axes, problem.horizon.clearance
    u = transfer.max_control * rng.uniform(-1, 1, (T, d))
    speed = min(limit, transfer.max_control * T * model.dt) / 4
    start = np.concatenate([rng.normal(0, 5 * R, d), rng.normal(0, speed, d)])
    x = model.simulate(start, u)
    # Without drift the motion is linear: speeds scale with the start and the control.
    scale = min(1.0, float(limit / np.linalg.norm(x[:, d:], axis=1).max()))
    return model.simulate(scale * start, scale * u), scale * u


def _neighbor_control_points(
    problem: OnboardProblem, nominal: Float[Array, "pieces 4 d"], rng: np.random.Generator
) -> Float[Array, "pieces 4 d"]:
    x, u = _random_transfer(problem, rng)
    other, R = problem.horizon.control_points(x, u), problem.horizon.clearance
    meet = int(rng.integers(len(other)))
    direction = rng.standard_normal((other.shape[-1],))
    direction = direction / np.linalg.norm(direction)
    distance = float(R * rng.uniform(1, 1.5))
    while True:
        shifted = other - other[meet, 0] + nominal[meet, 0] + distance * direction
        if are_hulls_separated(nominal - shifted, problem.horizon.required_separation).all():
            return np.asarray(shifted)
        distance *= 1.2
