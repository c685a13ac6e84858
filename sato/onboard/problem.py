"""Transfer problem of fixed size for one agent of a scenario, and random instances of it."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

from dynamics.discretize import discretize_zoh
from problems.convexify import AvoidanceHorizon, choose_normals, convexify
from problems.fixed_size_avoidance import FixedSizeAvoidanceProblem
from problems.half_spaces import HalfSpaces
from problems.path_separation import are_hulls_separated
from sato.reconfiguration.mission import Reconfiguration
from sato.reconfiguration.planning import make_horizon
from sato.reconfiguration.solo_trajectories import TIE_BREAK_RISE
from sato.scenario.file import read


class OnboardProblem(NamedTuple):
    """Transfer problem of an agent, with its origin."""

    scenario: str
    neighbors: int  # for which the program has room
    horizon: AvoidanceHorizon  # pieces of trajectory, with a half-space per control point
    program: FixedSizeAvoidanceProblem


def build_problem(scenario: str, neighbors: int, steps: int | None = None) -> OnboardProblem:
    """Build the transfer problem of one agent of a scenario, with arguments as of `export_c`."""
    file = read(scenario)
    # Only the model and the limits matter here, so any random start will do.
    mission = file.draw(np.random.default_rng(0))
    if not isinstance(mission, Reconfiguration):
        raise ValueError(
            f"{file.name}: agents of the system {file.system} solve no transfer; a scenario of "
            "the system reconfiguration would do"
        )
    if mission.nonlinear_model is not None or not mission.linear_model.is_time_invariant:
        raise ValueError(
            f"{file.name}: its model changes with time or with the trajectory, and exported code "
            "has constant matrices; of models in orbit, clohessy_wiltshire and "
            "schweighart_sedwick would do"
        )
    mission.require_equal_vehicles("exported code")
    T = mission.legs[0].steps if steps is None else steps
    model = discretize_zoh(mission.linear_model, mission.step, T)
    transfer = mission.make_transfer(model, 0, tie_break_rise=TIE_BREAK_RISE)
    horizon = make_horizon(mission, 0.0, T)
    # One half-space for each neighbor and control point of a step.
    _, pieces, points, *_ = horizon.control_point_maps[0].shape
    rows = neighbors * pieces * points
    program = FixedSizeAvoidanceProblem(transfer, min(T, horizon.steps), rows)
    return OnboardProblem(file.name, neighbors, horizon, program)


def random_instances(
    problem: OnboardProblem, rng: np.random.Generator
) -> Iterator[tuple[Array, Array, HalfSpaces]]:
    """Generate start, target and half-spaces of feasible instances, without end.

    A trajectory under random controls defines start and target, and the half-spaces are those
    between it and its neighbors, so that it is feasible. It is far from optimal, so that some of
    the half-spaces bind at the optimum.
    """
    horizon, T = problem.horizon, len(problem.program.transfer.model)
    while True:
        x, u = _random_transfer(problem, rng)
        nominal = horizon.control_points(x, u)
        others = [_pass_closely(problem, nominal, rng) for _ in range(problem.neighbors)]
        normal = choose_normals(nominal - np.stack(others), horizon.required_separation)
        yield x[0], x[-1], convexify(horizon, T, np.stack(others), normal)


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


def _pass_closely(
    problem: OnboardProblem, nominal: Float[Array, "pieces 4 d"], rng: np.random.Generator
) -> Float[Array, "pieces 4 d"]:
    """Draw the control points of a neighbor that comes near a trajectory."""
    other = problem.horizon.control_points(*_random_transfer(problem, rng))
    meet = int(rng.integers(len(other)))
    direction = rng.standard_normal(other.shape[-1:])
    direction /= np.linalg.norm(direction)
    distance = float(problem.horizon.clearance * rng.uniform(1, 1.5))
    while True:
        shifted = other - other[meet, 0] + nominal[meet, 0] + distance * direction
        if are_hulls_separated(nominal - shifted, problem.horizon.required_separation).all():
            return np.asarray(shifted)
        distance *= 1.2
