"""Auction costs: laws, and every pair against the CVXPY statement."""

from math import inf

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import minimize

from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from problems import auction_cost
from problems.assignment import solve_assignment
from problems.auction_cost import (
    compute_displacements,
    compute_distances,
    compute_energies,
    compute_transfer_costs,
    solve_transfer,
    unreachable_cost,
)
from problems.conic import Infeasible
from problems.transfer import TransferProblem

plane = discretize_zoh(DoubleIntegrator(2), 1.0, 20)
orbit = discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 16)
models = {"plane": (plane, 0.3, 0.05), "orbit": (orbit, 300.0, 0.01)}
all_models = pytest.mark.parametrize(("steps", "size", "U"), models.values(), ids=models)


def random_states(rng, steps, size, agents=5, targets=7):
    d, T = steps.axes, len(steps) * steps.dt
    return (
        np.hstack([rng.normal(0, size, (count, d)), rng.normal(0, size / T, (count, d))])
        for count in (agents, targets)
    )


@all_models
def test_costs_are_those_of_the_cvxpy_statement(rng, steps, size, U):
    start, targets = random_states(rng, steps, size, 4, 4)
    transfer = TransferProblem(steps, U)
    costs = compute_transfer_costs(transfer, start, targets)
    for i, j in np.ndindex(4, 4):
        fuel = transfer.solve(start[i], targets[j]).fuel
        assert costs.cost[i, j] == pytest.approx(fuel, rel=1e-6)


def test_costs_in_other_norms_are_those_of_the_statement(rng):
    start, targets = random_states(rng, plane, 0.3, 2, 2)
    targets[1] += 100.0
    transfer = TransferProblem(plane, 0.05, 0.5, 2, 2)
    costs = compute_transfer_costs(transfer, start, targets)
    assert costs.is_exact.all() and costs.is_reachable.tolist() == [[True, False]] * 2
    stated = transfer.solve(start[1], targets[0]).fuel  # in CVXPY, with the states
    assert costs.cost[1, 0] == pytest.approx(stated, rel=1e-7)
    assert (costs.cost[:, 1] == unreachable_cost(plane, 0.05)).all()


@pytest.mark.parametrize("r", [1, 2])
def test_costs_with_other_limits_of_the_control_are_lower_bounds(rng, r):
    start, targets = random_states(rng, plane, 0.3, 4, 5)
    transfer = TransferProblem(plane, 0.03, 0.5, 1, r)
    costs, exact = compute_transfer_costs(transfer, start, targets), 0
    for i, j in np.argwhere(costs.is_reachable):
        found = solve_transfer(transfer, start[i], targets[j])
        if costs.is_exact[i, j]:
            assert costs.cost[i, j] == pytest.approx(found.fuel, rel=1e-6)
            exact += 1
        elif found is not None:
            assert costs.cost[i, j] <= found.fuel * (1 + 1e-7)
    assert 0 < exact < costs.is_exact.size


@all_models
def test_other_agents_do_not_change_the_last_bit_of_a_cost(rng, steps, size, U):
    start, targets = random_states(rng, steps, size, 9, 30)
    transfer = TransferProblem(steps, U, 2.5 * size / (len(steps) * steps.dt))
    before = compute_transfer_costs(transfer, start, targets)
    start[4] += size
    after = compute_transfer_costs(transfer, start, targets)
    others = np.arange(9) != 4
    assert_array_equal(before.cost[others], after.cost[others])
    assert (before.cost[4] != after.cost[4]).any()


def test_unreachable_targets_cost_more_than_any_trajectory(rng):
    start, targets = random_states(rng, plane, 40.0, 12, 12)
    transfer = TransferProblem(plane, 0.2)
    costs = compute_transfer_costs(transfer, start, targets)
    assert 0 < costs.is_reachable.sum() < 144
    assert (costs.cost[~costs.is_reachable] == unreachable_cost(plane, 0.2)).all()
    assert costs.cost[costs.is_reachable].max() <= unreachable_cost(plane, 0.2) / 2
    assert costs.is_exact.all()
    for i, j in np.argwhere(~costs.is_reachable)[:5]:
        with pytest.raises(Infeasible):
            transfer.solve(start[i], targets[j])


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_remaining_steps_reach_few_targets(rng, count):
    steps = plane[:count]
    start = rng.normal(size=(4, 4))
    targets = steps.simulate(start, rng.uniform(-0.3, 0.3, (4, count, 2)))[:, -1]
    costs = compute_transfer_costs(TransferProblem(steps, 0.3, 10.0), start, targets)
    assert_array_equal(costs.is_reachable, np.eye(4, dtype=bool))


@pytest.mark.parametrize(
    ("steps", "U", "V", "few"), [(plane, 0.05, 0.32, 1), (orbit, 0.01, 2.0, 4)]
)
def test_costs_with_a_speed_limit_are_exact_or_lower_bounds(rng, steps, U, V, few):
    d, span = steps.axes, len(steps) * steps.dt * 0.35
    start, targets = rng.normal(0, V * span, (2, 10, 2 * d))
    start[:, d:], targets[:, d:] = 0.4 * V * rng.uniform(-1, 1, (2, 10, d))
    transfer = TransferProblem(steps, U, V)
    costs = compute_transfer_costs(transfer, start, targets)
    free = compute_transfer_costs(TransferProblem(steps, U), start, targets)
    assert_array_equal(costs.cost, free.cost)
    binds = ~costs.is_exact
    assert 0.03 < binds.mean() < 0.7
    dearer = 0
    for i, j in [*np.argwhere(binds)[:25], *np.argwhere(~binds & costs.is_reachable)[:5]]:
        found = solve_transfer(transfer, start[i], targets[j])
        if found is None:
            assert binds[i, j]
            with pytest.raises(Infeasible):
                transfer.solve(start[i], targets[j])
            continue
        fuel = transfer.solve(start[i], targets[j]).fuel
        assert found.fuel == pytest.approx(fuel, rel=1e-6)
        assert costs.cost[i, j] <= fuel * (1 + 1e-6)
        assert binds[i, j] or costs.cost[i, j] == pytest.approx(fuel, rel=1e-6)
        dearer += fuel > costs.cost[i, j] * (1 + 1e-5)
    assert dearer >= few


def test_single_transfers_are_solved_in_all_norms():
    start, target = np.array([0, 0, 0.1, 0.0]), np.array([3.0, 1.0, 0, 0.1])
    for q, r, V in ((1, "inf", inf), (1, "inf", 0.5), (2, 2, 0.5), ("inf", 1, inf)):
        transfer = TransferProblem(plane, 0.05, V, q, r)
        found = solve_transfer(transfer, start, target)
        assert found.fuel == pytest.approx(transfer.solve(start, target).fuel, rel=1e-6)
        assert solve_transfer(transfer, start, target + 100.0) is None


@settings(deadline=None, max_examples=20)
@given(st.integers(0, 2**32 - 1))
def test_fuel_falls_with_a_looser_speed_limit(seed):
    rng = np.random.default_rng(seed)
    start = np.concatenate([rng.normal(size=2), rng.uniform(-0.15, 0.15, 2)])
    target = plane.simulate(start, np.clip(rng.normal(0, 0.05, (20, 2)), -0.05, 0.05))[-1]
    found = [solve_transfer(TransferProblem(plane, 0.05, V), start, target) for V in (0.3, 0.4, 9)]
    fuel = [inf if each is None else each.fuel for each in found]
    assert fuel[0] >= fuel[1] * (1 - 1e-6) - 1e-9 and fuel[1] >= fuel[2] * (1 - 1e-6) - 1e-9


def test_speeds_that_no_control_keeps_within_the_limit_are_infeasible():
    """One step removes 0.1: enough from 0.4 to the limit of 0.35, not from 0.5."""
    transfer, start = TransferProblem(plane, 0.1, 0.35), np.array([0, 0, 0.4, 0.0])
    flight = solve_transfer(transfer, start, plane.simulate(start, np.full((20, 2), -1e-2))[-1])
    assert np.linalg.norm(flight.x[1, 2:]) <= 0.35 * (1 + 2e-9)
    start[2] = 0.5
    assert solve_transfer(transfer, start, np.zeros(4)) is None


def test_bisection_to_the_edge_of_reach_raises_nothing(rng):
    transfer = TransferProblem(plane, 0.3, 0.3)
    for _ in range(4):
        start = np.concatenate([rng.normal(0, 5, 2), rng.normal(0, 0.1, 2)])
        middle = plane.simulate(start, np.zeros((20, 2)))[-1] * [1, 1, 0, 0]
        direction = np.concatenate([rng.normal(0, 20, 2), np.zeros(2)])
        inside, outside = 0.0, 1.0
        assert solve_transfer(transfer, start, middle + direction) is None
        while outside - inside > 1e-7:
            part = (inside + outside) / 2
            found = solve_transfer(transfer, start, middle + part * direction)
            if found is None:
                outside = part
            else:
                inside = part
                assert_allclose(found.x[-1], middle + part * direction, atol=1e-5)
        assert 0 < inside


def test_assigned_squared_distances_do_not_cross(rng):
    start, targets = (np.hstack([rng.uniform(0, 10, (30, 2)), np.zeros((30, 2))]) for _ in range(2))
    target = solve_assignment(compute_distances(plane, start, targets) ** 2)
    relative = (start[:, None] - start[None])[..., :2]
    ends = (targets[target][:, None] - targets[target][None])[..., :2]
    assert ((relative * ends).sum(axis=2) >= -1e-9).all()  # optimal transport is monotone


@all_models
def test_targets_of_least_cost_keep_it_while_plans_are_flown(rng, steps, size, U):
    # The cost of no target falls by more than its agent spends, that of its own by as much.
    start, targets = random_states(rng, steps, size / 3, 6, 6)
    costs = compute_transfer_costs(TransferProblem(steps, U), start, targets)
    assert costs.is_reachable.all()
    held = solve_assignment(costs.cost)
    plans = [
        TransferProblem(steps, U).solve(x, targets[j]) for x, j in zip(start, held, strict=True)
    ]
    for flown in (1, 5, 11):
        later = np.array([plan.x[flown] for plan in plans])
        left = compute_transfer_costs(TransferProblem(steps[flown:], U), later, targets)
        spent = [steps.dt * np.abs(plan.u[:flown]).sum() for plan in plans]
        assert (left.cost >= costs.cost - np.array(spent)[:, None] - 1e-6 * costs.cost).all()
        best = left.cost[range(6), solve_assignment(left.cost)].sum()
        assert left.cost[range(6), held].sum() == pytest.approx(best, rel=1e-6)


@all_models
def test_energy_is_that_of_the_least_squares_control(rng, steps, size, U):
    start, targets = random_states(rng, steps, size, 2, 2)
    E = compute_energies(steps, start, targets)
    C = steps.simulate(
        np.zeros((steps.axes * len(steps), 2 * steps.axes)),
        np.eye(steps.axes * len(steps)).reshape(-1, len(steps), steps.axes),
    )[:, -1]
    b = compute_displacements(steps, start, targets)
    for i, j in np.ndindex(2, 2):
        u = np.linalg.lstsq(C.T, b[i, j])[0]
        assert_allclose(C.T @ u, b[i, j], rtol=1e-6)
        assert E[i, j] == pytest.approx(steps.dt * u @ u, rel=1e-8)


def test_energy_from_rest_to_rest_is_the_closed_form(rng):
    fine = discretize_zoh(DoubleIntegrator(2), 0.05, 400)  # 20 s in small steps
    start, targets = np.zeros((1, 4)), np.array([[3.0, -2.0, 0, 0]])
    assert compute_energies(fine, start, targets)[0, 0] == pytest.approx(12 * 13 / 20**3, rel=1e-4)


def test_energy_with_too_few_steps_is_that_of_coming_nearest(rng):
    one = plane[:1]
    start, u = rng.normal(size=(2, 4)), rng.normal(size=(2, 1, 2))
    targets = one.simulate(start, u)[:, -1]
    assert_allclose(np.diag(compute_energies(one, start, targets)), (u**2).sum(axis=(1, 2)))
    away = compute_energies(one, start, targets)[0, 1]
    free = one.simulate(start[0], np.zeros((1, 2)))[-1]
    miss = lambda v: ((targets[1] - free - one.B[0] @ v) ** 2).sum()  # noqa: E731
    best = minimize(miss, np.zeros(2), tol=1e-12).x
    assert away == pytest.approx(best @ best, rel=1e-5)


def test_costs_do_not_depend_on_how_many_are_simulated_at_once(rng, monkeypatch):
    transfer = TransferProblem(plane, 0.05, 0.03)
    start, targets = random_states(rng, plane, 0.3)
    whole = compute_transfer_costs(transfer, start, targets)
    assert 0 < whole.is_exact.sum() < whole.is_exact.size
    monkeypatch.setattr(auction_cost, "MAX_COORDINATES", 1)
    for part, same in zip(compute_transfer_costs(transfer, start, targets), whole, strict=True):
        assert_array_equal(part, same)


@pytest.mark.parametrize(("agents", "targets"), [(0, 3), (2, 0), (0, 0)])
def test_costs_of_no_agents_or_targets_are_an_empty_table(agents, targets):
    transfer = TransferProblem(plane, 0.05, 0.1)
    found = compute_transfer_costs(transfer, np.zeros((agents, 4)), np.ones((targets, 4)))
    assert all(part.shape == (agents, targets) for part in found)
