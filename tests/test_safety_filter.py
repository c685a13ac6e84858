"""Safety filter: a statement in CVXPY as second opinion, and laws of trajectories that stop."""

from dataclasses import replace
from itertools import product
from math import inf

import cvxpy as cp
import numpy as np
import pytest

from dynamics import DoubleIntegrator, discretize_zoh
from problems.conic import TOLERANCE, Infeasible
from problems.half_spaces import HalfSpaces, empty_half_spaces
from problems.limit import LIMIT_TOLERANCE, Limit
from problems.safety_filter import FUEL_WEIGHT, SafetyFilterProblem
from problems.transfer import TransferProblem

NORMS = (1, 2, "inf")
CASES = list(product((2, 3), NORMS, (False, True)))  # axes, norm of the control, limits an axis
STEP = 0.5


def random_problem(rng, axes, norm, each_axis):
    """Draw a filter, and the controls of a trajectory that stops well within all its limits."""
    T = int(rng.integers(6, 10))
    U = rng.uniform(0.1, 0.4, axes) if each_axis else 0.3
    limit, model = Limit(U, norm, axes), discretize_zoh(DoubleIntegrator(axes), STEP, T)
    u = limit.cut(rng.normal(0, 0.2, (T, axes))) * 0.9
    u[-2:] = 0.0
    v = -STEP * u.sum(axis=0)  # so that it ends at rest
    start = np.concatenate([rng.normal(size=axes), v])
    x = model.simulate(start, u)
    speed_norm = NORMS[rng.integers(3)]
    V = inf
    if rng.random() < 0.7:
        shares = rng.uniform(1, 2, axes) if each_axis else 1.0
        V = shares * 1.1 * Limit(shares, speed_norm, axes).measure(x[1:, axes:]).max()
        V = V / np.max(shares)
        V = np.asarray(V) if each_axis else float(V)
    transfer = TransferProblem(model, U, V, control_norm=norm, speed_norm=speed_norm)
    k = int(rng.integers(1, T))
    wanted = x[k] + rng.normal(0, 1, 2 * axes) * np.repeat([1, 0.3], axes)
    walls = random_walls(rng, x, u)
    return SafetyFilterProblem(transfer, start, wanted, k, walls), u


def random_walls(rng, x, u, count=12):
    """Draw half-spaces with some room for a trajectory."""
    T, m = u.shape
    step, n = rng.integers(1, T, count), rng.normal(size=(count, m))
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    on_state, on_control = np.hstack([n, STEP / 3 * n]), STEP**2 / 6 * n
    value = (on_state * x[step]).sum(axis=1) + (on_control * u[step]).sum(axis=1)
    return HalfSpaces(step, on_state, on_control, value - rng.uniform(0.01, 0.1, count))


def norm_of(row, limit):
    """Norm of a vector in CVXPY, each axis over its share."""
    return cp.norm(cp.multiply(row, 1 / limit.shares), limit.norm)


def second_opinion(own):
    """State the program in CVXPY with all states; return its least cost."""
    transfer, model, walls = own.transfer, own.transfer.model, own.half_spaces
    T, n, m = model.B.shape
    x, u = cp.Variable((T + 1, n)), cp.Variable((T, m))
    k, dt = own.wanted_step, model.dt
    constraints = [x[0] == own.start, x[T, m:] == 0]
    for j in range(T):
        constraints.append(x[j + 1] == model.A[j] @ x[j] + model.B[j] @ u[j])
        constraints.append(norm_of(u[j], transfer.control_limit) <= transfer.control_limit.most)
    if transfer.speed_limit.most < inf:
        speed = transfer.speed_limit
        constraints += [norm_of(x[j, m:], speed) <= speed.most for j in range(1, T)]
    for step, on_state, on_control, rhs in zip(*walls, strict=True):
        constraints.append(on_state @ x[step] + on_control @ u[step] >= rhs)
    error = x[k] - own.wanted
    cost = cp.norm1(error[:m]) + dt * cp.norm1(error[m:])
    cost += FUEL_WEIGHT * k * dt * dt * cp.sum(cp.abs(u))
    return float(cp.Problem(cp.Minimize(cost), constraints).solve(cp.CLARABEL))


def cost_of(own, x, u):
    """Cost of a trajectory."""
    m, k, dt = u.shape[1], own.wanted_step, own.transfer.model.dt
    error = np.abs(x[k] - own.wanted)
    return error[:m].sum() + dt * error[m:].sum() + FUEL_WEIGHT * k * dt**2 * np.abs(u).sum()


@pytest.mark.parametrize(("axes", "norm", "each_axis"), CASES)
def test_cost_is_that_of_the_same_program_in_cvxpy(rng, axes, norm, each_axis):
    for _ in range(4):
        own, _ = random_problem(rng, axes, norm, each_axis)
        found = own.solve()
        assert cost_of(own, found.x, found.u) == pytest.approx(second_opinion(own), abs=2e-5)


@pytest.mark.parametrize(("axes", "norm", "each_axis"), CASES)
def test_trajectory_keeps_all_limits_and_ends_at_rest(rng, axes, norm, each_axis):
    for _ in range(4):
        own, known = random_problem(rng, axes, norm, each_axis)
        found, transfer = own.solve(), own.transfer
        limit = transfer.control_limit
        np.testing.assert_allclose(transfer.model.simulate(own.start, found.u), found.x, atol=1e-12)
        assert limit.measure(found.u).max() <= limit.most * (1 + LIMIT_TOLERANCE)
        assert not transfer.is_too_fast(found.x).any()
        assert np.abs(found.x[-1, axes:]).max() <= 10 * TOLERANCE * limit.most * STEP
        assert own.half_spaces.violation(found.x, found.u).max() <= 10 * TOLERANCE
        coasted = transfer.model.simulate(own.start, known)
        assert cost_of(own, found.x, found.u) <= cost_of(own, coasted, known) + 1e-5


@pytest.mark.parametrize(("axes", "norm", "each_axis"), CASES)
def test_rest_of_a_stopping_trajectory_remains_an_answer(rng, axes, norm, each_axis):
    own, u = random_problem(rng, axes, norm, each_axis)
    x, model, walls = own.transfer.model.simulate(own.start, u), own.transfer.model, own.half_spaces
    for j in range(1, len(u) - 1):
        left = walls.select(walls.step_index > j)
        later = replace(
            own,
            transfer=replace(own.transfer, model=model[j:]),
            start=x[j],
            wanted_step=max(own.wanted_step - j, 1),
            half_spaces=left._replace(step_index=left.step_index - j),
        )
        found = later.solve()
        assert cost_of(later, found.x, found.u) <= cost_of(later, x[j:], u[j:]) + 1e-5
        assert later.half_spaces.violation(found.x, found.u).max(initial=0) <= 10 * TOLERANCE


@pytest.mark.parametrize(("steps", "stops"), [(4, False), (5, True)])
def test_filter_is_infeasible_where_no_vehicle_can_stop(steps, stops):
    # 0.9 m/s and 0.4 m/s² in steps of 0.5 s: it takes 4.5 steps to stop.
    model = discretize_zoh(DoubleIntegrator(2), STEP, steps)
    transfer = TransferProblem(model, 0.4)
    start, wanted = np.array([0.0, 0.0, 0.9, 0.0]), np.array([1.0, 0.0, 0.0, 0.0])
    own = SafetyFilterProblem(transfer, start, wanted, 2, empty_half_spaces(transfer))
    if stops:
        assert abs(own.solve().x[-1, 2]) <= 1e-6
    else:
        with pytest.raises(Infeasible):
            own.solve()


@pytest.mark.parametrize(("room", "stops"), [(-1e-3, False), (1e-3, True)])
def test_filter_is_infeasible_where_a_wall_is_too_near_to_stop(room, stops):
    # 1 m/s and 0.5 m/s² in steps of 0.5 s: it stops after 1 m, in four steps.
    model = discretize_zoh(DoubleIntegrator(2), STEP, 6)
    transfer, T = TransferProblem(model, 0.5), 6
    toward = np.array([-1.0, 0.0, 0.0, 0.0])
    rhs = np.full(T - 1, -1 - room)
    walls = HalfSpaces(np.arange(1, T), np.tile(toward, (T - 1, 1)), np.zeros((T - 1, 2)), rhs)
    start = np.array([0.0, 0.0, 1.0, 0.0])
    own = SafetyFilterProblem(transfer, start, np.array([3.0, 0.0, 1.0, 0.0]), 3, walls)
    if stops:
        assert own.solve().x[-1, 0] <= 1 + room + 1e-6
    else:
        with pytest.raises(Infeasible):
            own.solve()


def test_wanted_state_within_reach_is_met():
    model = discretize_zoh(DoubleIntegrator(3), STEP, 8)
    transfer = TransferProblem(model, 0.5)
    u = np.array([[0.3, 0, -0.2], [0, 0.4, 0], [0, 0, 0.1], [0.1, -0.2, 0]])
    wanted = model[:4].simulate(np.zeros(6), u)[-1]
    own = SafetyFilterProblem(transfer, np.zeros(6), wanted, 4, empty_half_spaces(transfer))
    np.testing.assert_allclose(own.solve().x[4], wanted, atol=1e-5)
