"""Joint stops: a statement in CVXPY as second opinion, and a crowd that makes room."""

from dataclasses import replace
from itertools import pairwise

import cvxpy as cp
import numpy as np
import pytest
from reconfiguration_runs import make_mission

import sato
from dynamics.trajectory_geometry import hull_distance
from problems import joint_stops
from problems.convexify import SEPARATION_TOLERANCE, choose_normals
from problems.joint_stops import (
    CHANGE_WEIGHT,
    SLACK_WEIGHT,
    JointStopProblem,
    StoppingVehicle,
)
from problems.limit import Limit
from problems.obstacle_paths import ObstaclePaths, is_path_clear, support_obstacles
from sato.reconfiguration.stopping import stopping_horizon

R, U, STEPS = 0.5, 0.2, 13
ENDS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 10, 12)  # of the blocks of 12 steps


def make_problem(rng, axes, norms, count, steps, is_free=None, **changes):
    """Vehicles in a row, at rest, and a body that comes along the row."""
    start = np.zeros((count, 2 * axes))
    start[:, 0] = 1.05 * R * np.arange(count)
    start[:, 1] = rng.normal(0.0, 0.01, count)
    leg = sato.Leg(start[:, :axes], 5)
    model = sato.DoubleIntegrator(axes)
    mission = make_mission(start, leg, model=model, comm_radius=20.0, collision_radius=R, **changes)
    horizon = stopping_horizon(mission, steps + 1)
    time = (np.arange(len(horizon.fine_model))[:, None] + np.arange(4) / 3) * horizon.fine_model.dt
    velocity = np.zeros((1, axes))
    velocity[0, 0] = 0.25
    paths = time[..., None] * velocity[:, None, None] + np.append([-1.5 * R], np.zeros(axes - 1))
    body = ObstaclePaths(paths, np.zeros((1, 1, axes)), np.array([R]), velocity)
    limits = Limit(U, norms[0], axes), Limit(0.6, norms[1], axes)
    still = np.zeros((steps + 1, axes))
    vehicles = tuple(StoppingVehicle(x, still, *limits, steps, body) for x in start)
    free = np.ones(count, dtype=bool) if is_free is None else np.array(is_free)
    return JointStopProblem(horizon, vehicles, np.full((count, count), R), free)


@pytest.mark.parametrize("norms", [(1, "inf"), (2, 2), ("inf", 1)])
@pytest.mark.parametrize("axes", [2, 3])
def test_joint_stops_cost_as_the_same_program_in_cvxpy(axes, norms, monkeypatch):
    monkeypatch.setattr(joint_stops, "MAX_PROGRAMS", 99)  # until all half-spaces are kept
    monkeypatch.setattr(joint_stops, "FAST", 0.0)
    rng, wide = np.random.default_rng(axes), (1.0, 0.8, 1.3)[:axes]
    problem = make_problem(rng, axes, norms, 3, STEPS - 1, separation_axes=wide)
    wanted, nominal = rng.normal(0.0, 0.02, (2, 3, STEPS, axes))
    nominal[:, -1] = 0.0
    required = R * (1 + 0.1 * np.array([[0, 1, -1], [1, 0, 2], [-1, 2, 0]]))
    vehicles = (v._replace(u=u) for v, u in zip(problem.vehicles, wanted, strict=True))
    problem = replace(problem, vehicles=tuple(vehicles), required=required)
    found, slack = problem.improve(nominal)
    horizon, (x0, paths) = problem.horizon, problem.fly(nominal)
    P, Q, r = horizon.control_point_maps
    S, d = horizon.pieces_per_step, axes
    x = [cp.Variable((STEPS + 1, 2 * d)) for _ in range(3)]
    u = [cp.Variable((STEPS, d)) for _ in range(3)]
    model, rules, cost = horizon.discrete_model, [], 0.0

    def points(i, piece):
        k, s = divmod(piece, S)
        return [P[k, s, c] @ x[i][k] + Q[k, s, c] @ u[i][k] + r[k, s, c] for c in range(4)]

    def separate(i, others, normals, size):
        s = cp.Variable(nonneg=True)
        for piece, n in enumerate(normals):
            own, other = points(i, piece), others(piece)
            movable = range(2, 4) if piece == 0 else range(4)
            rules.extend(n @ (own[c] - other[c]) >= size * (1 - s) for c in movable)
        return SLACK_WEIGHT * s

    for i, vehicle in enumerate(problem.vehicles):
        rules += [x[i][0] == x0[i, 0], x[i][STEPS, d:] == 0, u[i][STEPS - 1] == 0]
        for k in range(STEPS):
            rules.append(x[i][k + 1] == model.A[k] @ x[i][k] + model.B[k] @ u[i][k])
        rules += [vehicle.control_limit.to_cvxpy(u[i]), vehicle.speed_limit.to_cvxpy(x[i][1:, d:])]
        for begin, end in pairwise(ENDS):
            same = u[i][begin:end] - nominal[i, begin:end]
            rules += [same[k] == same[0] for k in range(1, end - begin)]
        cost += CHANGE_WEIGHT / 2 / U**2 * cp.sum_squares(u[i][:-1] - vehicle.u[:-1])
        support, normal = support_obstacles(paths[i], vehicle.obstacles)
        own = R * (1 + SEPARATION_TOLERANCE)
        cost += separate(i, lambda piece, at=support[0]: at[piece], normal[0], own)
        for j in range(i):
            own = required[i, j] * (1 + SEPARATION_TOLERANCE)
            normal = choose_normals((paths[j] - paths[i])[None], np.array([own]))[0]
            cost += separate(j, lambda piece, i=i: points(i, piece), normal, own)
    best = cp.Problem(cp.Minimize(cost), rules).solve(solver="CLARABEL")
    change = found[:, :-1] - wanted[:, :-1]
    ours = CHANGE_WEIGHT / 2 / U**2 * (change**2).sum() + SLACK_WEIGHT * slack
    assert ours == pytest.approx(best, rel=1e-4)


@pytest.mark.parametrize("axes", [2, 3])
def test_crowd_makes_room_and_those_that_are_not_free_stay(axes):
    rng, steps = np.random.default_rng(0), 20
    problem = make_problem(rng, axes, ("inf", 2), 4, steps, (True, True, True, False))
    u = np.zeros((4, steps + 1, axes))
    for _ in range(8):
        u, slack = problem.improve(u)
    x, paths = problem.fly(u)
    assert slack < 1e-6 and not u[3].any() and u[:3].any(axis=(1, 2)).all()
    np.testing.assert_allclose(x[:, -1, axes:], 0.0, atol=1e-12)
    for i, vehicle in enumerate(problem.vehicles[:3]):
        assert is_path_clear(paths[i], vehicle.obstacles)
        assert not vehicle.control_limit.is_exceeded(u[i]).any()
        for j in range(i + 1, 4):
            assert hull_distance(paths[i] - paths[j])[0].min() >= R
