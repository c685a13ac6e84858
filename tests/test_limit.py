"""Limits as norms and one an axis: laws of the set, and CVXPY as a second opinion."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from problems.auction_cost import compute_transfer_costs
from problems.avoidance import AvoidanceProblem
from problems.conic import Infeasible
from problems.half_spaces import HalfSpaces
from problems.limit import Limit
from problems.pair_avoidance import PairProblem, RelativeHalfSpaces
from problems.transfer import TransferProblem

plane = discretize_zoh(DoubleIntegrator(2), 1.0, 10)
space = discretize_zoh(DoubleIntegrator(3), 1.0, 8)
orbit = discretize_zoh(ClohessyWiltshire(1.1e-3), 30.0, 10)
NORMS = (1, 2, "inf")
COUNT = 5  # of random programs


def random_avoidance(rng, speed_norm, steps=None):
    """Draw limits of each axis and half-spaces, with a trajectory in the middle of them all."""
    steps = steps or (plane, space, orbit)[rng.integers(3)]
    T, d = len(steps), steps.axes
    U = rng.uniform(0.02, 0.2, d) * (1 if steps is not orbit else 0.01)
    x0 = np.concatenate([rng.normal(0, 1, d), rng.normal(0, 0.3, d) * U * T * steps.dt])
    u = rng.uniform(-0.6, 0.6, (4, d))[np.arange(T) * 4 // T] * U
    x = steps.simulate(x0, u)
    free = AvoidanceProblem(
        TransferProblem(steps, U, tie_break_rise=1e-2), x0, x[-1], random_wall(rng, steps, x)
    )
    shares = rng.uniform(1, 3, d) if rng.random() < 0.7 else 3.0
    speeds = Limit(shares, speed_norm, d)
    cheapest, known = (
        speeds.measure(way[1:-1, d:]).max() for way in (free.solve_cvxpy().trajectory.x, x)
    )
    # Between the two a trajectory exists, for the program is convex, but the cheapest is too fast.
    V = shares * (min(cheapest, known) + known) / 2 / speeds.most
    transfer = replace(free.transfer, max_speed=V, speed_norm=speed_norm)
    return replace(free, transfer=transfer), x, cheapest > 1.01 * known


def random_wall(rng, steps, x):
    """Draw half-spaces that a trajectory just keeps, so that the program is feasible."""
    T, m = len(steps), steps.axes
    normal = rng.normal(size=(T, m))
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    on_state = np.hstack([normal, np.zeros_like(normal)])
    rhs = (on_state * x[:T]).sum(axis=1) - 0.02 * np.abs(x[:, :m]).max()
    return HalfSpaces(np.arange(1, T), on_state[1:], np.zeros((T - 1, m)), rhs[1:])


@pytest.mark.parametrize("norm", NORMS)
def test_faces_and_lengths_are_those_of_the_set(rng, norm):
    for bound in (0.7, np.array([0.3, 0.7, 0.5])):
        limit = Limit(bound, norm, 3)
        v = np.vstack([rng.normal(size=(4000, 3)), np.eye(3)])
        v *= (limit.most / limit.measure(v))[:, None]  # on the boundary
        assert np.linalg.norm(v, axis=1).max() <= limit.largest_length * (1 + 1e-9)
        assert np.linalg.norm(v, axis=1).max() > 0.97 * limit.largest_length
        if norm == "inf":
            assert_allclose((np.abs(v) / bound).max(axis=1), 1.0)
        if limit.faces is not None:
            assert_allclose((v @ limit.faces.T).max(axis=1), limit.most)


@pytest.mark.parametrize("speed_norm", NORMS)
def test_least_energy_agrees_with_cvxpy_for_any_limits(rng, speed_norm):
    for _ in range(COUNT):
        avoid, _, _ = random_avoidance(rng, speed_norm)
        avoid = replace(avoid, transfer=replace(avoid.transfer, objective="energy"))
        costs = [avoid.transfer.cost(f.trajectory) for f in (avoid.solve(), avoid.solve_cvxpy())]
        assert costs[0] == pytest.approx(costs[1], rel=1e-6)


@pytest.mark.parametrize("speed_norm", NORMS)
def test_condensed_programs_agree_with_cvxpy_for_any_limits(rng, speed_norm):
    binding = 0
    for _ in range(COUNT):
        avoid, _, is_bound = random_avoidance(rng, speed_norm)
        transfer, found = avoid.transfer, avoid.solve().trajectory
        other = avoid.solve_cvxpy().trajectory
        cost, expected = (transfer.weights @ np.abs(p.u).sum(axis=1) for p in (found, other))
        assert cost == pytest.approx(expected, rel=1e-6)
        assert avoid.half_spaces.violation(found.x, found.u).max() < 1e-6
        assert (np.abs(found.u) <= transfer.max_control * (1 + 1e-12)).all()
        speed = transfer.speed_limit.measure(found.x[1:-1, transfer.model.axes :]).max()
        assert (1 - 1e-4 if is_bound else 0) < speed / transfer.speed_limit.most <= 1 + 1e-6
        binding += is_bound
    assert binding > 0


def test_prices_of_all_pairs_keep_the_limit_of_each_axis(rng):
    for steps in (plane, space, orbit):
        avoid, x, _ = random_avoidance(rng, "inf", steps)
        problem = TransferProblem(steps, avoid.transfer.max_control)
        coasted = problem.coast(x[0])[-1]
        targets = coasted + (x[-1] - coasted) * np.linspace(0, 6, 40)[:, None]
        found = compute_transfer_costs(problem, x[:1], targets)
        assert 3 < found.is_reachable.sum() < 40 and found.is_exact.all()
        for q in range(0, 40, 8):
            try:
                expected = problem.solve(x[0], targets[q]).fuel
            except Infeasible:
                assert not found.is_reachable[0, q]
            else:
                assert found.cost[0, q] == pytest.approx(expected, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("speed_norm", NORMS)
def test_two_of_unequal_limits_agree_with_cvxpy(rng, speed_norm):
    (first, x, _), (second, y, _) = (random_avoidance(rng, speed_norm, plane) for _ in range(2))
    own = random_wall(rng, plane, x)
    gap = (own.state_coeffs * (x - y)[own.step_index]).sum(axis=1) - 0.01
    other = own._replace(state_coeffs=-own.state_coeffs, rhs=0.0 * gap)
    pair = PairProblem(first, second, RelativeHalfSpaces(own._replace(rhs=gap), other))
    both, stated = pair.solve(), pair.solve_cvxpy()
    each = [member.transfer.weights for member in (first, second)]
    costs = [
        sum(w @ np.abs(flight.u).sum(axis=1) for w, flight in zip(each, flights, strict=True))
        for flights in (both, stated)
    ]
    assert costs[0] == pytest.approx(costs[1], rel=1e-6)
    assert pair.violation(both).max() < 1e-6
