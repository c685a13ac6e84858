"""Prices of all pairs: laws, and pair by pair against the statement."""

from math import inf

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from problems.assignment import solve_assignment
from problems.auction_cost import (
    compute_displacements,
    compute_distances,
    compute_energies,
    compute_exact_costs,
    compute_transfer_costs,
    solve_transfer,
    unreachable_cost,
)
from problems.conic import Infeasible
from problems.transfer import TransferProblem

plane = discretize_zoh(DoubleIntegrator(2), 1.0, 20)
orbit = discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 16)
models = {"plane": (plane, 0.3, 0.05), "orbit": (orbit, 300.0, 0.01)}
both = pytest.mark.parametrize(("steps", "size", "U"), models.values(), ids=models)


def swarm(rng, steps, size, agents=5, targets=7):
    d, T = steps.axes, len(steps) * steps.dt
    start = np.hstack([rng.normal(0, size, (agents, d)), rng.normal(0, size / T, (agents, d))])
    goals = np.hstack([rng.normal(0, size, (targets, d)), rng.normal(0, size / T, (targets, d))])
    return start, goals


@both
def test_where_coasting_leads_is_free(rng, steps, size, U):
    start, _ = swarm(rng, steps, size)
    goals = steps.simulate(start, np.zeros((5, len(steps), steps.axes)))[:, -1]
    prices = compute_transfer_costs(steps, start, goals, U)
    assert np.abs(np.diag(prices.fuel)).max() < 1e-10
    assert (prices.fuel >= 0).all()
    assert prices.is_reachable.all() and prices.is_exact.all()


@both
def test_each_price_is_that_of_the_statement(rng, steps, size, U):
    start, goals = swarm(rng, steps, size, 4, 4)
    prices, transfer = compute_transfer_costs(steps, start, goals, U), TransferProblem(steps, U)
    assert prices.duality_gap < 1e-6
    for i, j in np.ndindex(4, 4):
        assert prices.fuel[i, j] == pytest.approx(transfer.solve(start[i], goals[j]).fuel, rel=1e-6)


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 2**32 - 1), st.sampled_from(list(models)))
def test_a_price_is_of_its_pair_alone(seed, which):
    steps, size, U = models[which]
    rng = np.random.default_rng(seed)
    start, goals = swarm(rng, steps, size)
    whole = compute_transfer_costs(steps, start, goals, U, 2 * size)
    agents, targets = rng.permutation(5)[:3], rng.permutation(7)[:4]
    part = compute_transfer_costs(steps, start[agents], goals[targets], U, 2 * size)
    np.testing.assert_allclose(part.fuel, whole.fuel[np.ix_(agents, targets)], rtol=1e-9)
    np.testing.assert_array_equal(part.is_reachable, whole.is_reachable[np.ix_(agents, targets)])


@pytest.mark.parametrize("ask", [compute_transfer_costs, compute_exact_costs])
@both
def test_what_an_agent_pays_does_not_know_where_another_is_to_the_last_bit(
    rng, steps, size, U, ask
):
    start, goals = swarm(rng, steps, size, 9, 30)
    V = 2.5 * size / (len(steps) * steps.dt)
    before = ask(steps, start, goals, U, V)
    assert 20 < (~compute_transfer_costs(steps, start, goals, U, V).is_exact).sum() < 200
    start[4] += size
    after = ask(steps, start, goals, U, V)
    others = np.arange(9) != 4
    np.testing.assert_array_equal(before.fuel[others], after.fuel[others])
    assert (before.fuel[4] != after.fuel[4]).any()


def test_out_of_reach_costs_more_than_any_flight(rng):
    start, goals = swarm(rng, plane, 40.0, 12, 12)
    prices = compute_transfer_costs(plane, start, goals, 0.2)
    assert 0 < prices.is_reachable.sum() < 144
    assert (prices.fuel[~prices.is_reachable] == unreachable_cost(plane, 0.2)).all()
    assert prices.fuel[prices.is_reachable].max() <= unreachable_cost(plane, 0.2) / 2
    assert prices.is_exact.all()
    transfer = TransferProblem(plane, 0.2)
    for i, j in np.argwhere(~prices.is_reachable)[:5]:
        with pytest.raises(Infeasible):
            transfer.solve(start[i], goals[j])


@pytest.mark.parametrize("count", [1, 2, 3])
def test_with_few_steps_left_little_is_in_reach(rng, count):
    steps = plane[:count]
    start = rng.normal(size=(4, 4))
    goals = steps.simulate(start, rng.uniform(-0.3, 0.3, (4, count, 2)))[:, -1]
    for ask in (compute_transfer_costs, compute_exact_costs):
        prices = ask(steps, start, goals, 0.3, 10.0)
        np.testing.assert_array_equal(prices.is_reachable, np.eye(4, dtype=bool))


@pytest.mark.parametrize(
    ("steps", "U", "V", "few"), [(plane, 0.05, 0.32, 1), (orbit, 0.01, 2.0, 4)]
)
def test_a_speed_limit_is_priced_exactly_pair_by_pair(rng, steps, U, V, few):
    start, goals = swarm(rng, steps, V, 10, 10)
    span = np.repeat([len(steps) * steps.dt * 0.35, 1.0], steps.axes)
    start, goals = start * span, goals * span
    start[:, steps.axes :], goals[:, steps.axes :] = (
        0.4 * V * rng.uniform(-1, 1, (2, 10, steps.axes))
    )
    lower, prices = (
        compute_transfer_costs(steps, start, goals, U, V),
        compute_exact_costs(steps, start, goals, U, V),
    )
    free, transfer = compute_transfer_costs(steps, start, goals, U), TransferProblem(steps, U, V)
    np.testing.assert_array_equal(lower.fuel, free.fuel)
    binds = ~lower.is_exact
    assert 0.03 < binds.mean() < 0.7
    assert prices.is_exact.all()
    assert prices.duality_gap < 2e-7  # that of the slope which breaks ties, and that of the proof
    np.testing.assert_array_equal(prices.fuel[~binds], lower.fuel[~binds])
    dearer = 0
    for i, j in [*np.argwhere(binds)[:25], *np.argwhere(~binds & lower.is_reachable)[:5]]:
        try:
            fuel = transfer.solve(start[i], goals[j]).fuel
        except Infeasible:
            assert not prices.is_reachable[i, j]
            assert prices.fuel[i, j] == unreachable_cost(steps, U)
            continue
        assert prices.is_reachable[i, j]
        assert prices.fuel[i, j] == pytest.approx(fuel, rel=1e-6)
        assert lower.fuel[i, j] <= prices.fuel[i, j] * (1 + 1e-7)
        dearer += prices.fuel[i, j] > lower.fuel[i, j] * (1 + 1e-5)
    assert dearer >= few


def test_settling_one_pair_is_for_all_norms(rng):
    start, goal = np.array([0, 0, 0.1, 0.0]), np.array([3.0, 1.0, 0, 0.1])
    for q, r, V in ((1, "inf", inf), (1, "inf", 0.5), (2, 2, 0.5), ("inf", 1, inf)):
        transfer = TransferProblem(plane, 0.05, V, q, r)
        flight = solve_transfer(transfer, start, goal)
        assert flight.fuel == pytest.approx(transfer.solve(start, goal).fuel, rel=1e-6)
        assert solve_transfer(transfer, start, goal + 100.0) is None


def test_at_the_edge_of_reach_a_pair_is_in_reach_or_not(rng):
    transfer = TransferProblem(plane, 0.3, 0.3)
    for _ in range(4):
        start = np.concatenate([rng.normal(0, 5, 2), rng.normal(0, 0.1, 2)])
        middle = plane.simulate(start, np.zeros((20, 2)))[-1] * [1, 1, 0, 0]
        way = np.concatenate([rng.normal(0, 20, 2), np.zeros(2)])
        inside, outside = 0.0, 1.0
        assert solve_transfer(transfer, start, middle + way) is None
        while outside - inside > 1e-7:
            part = (inside + outside) / 2
            flight = solve_transfer(transfer, start, middle + part * way)
            if flight is None:
                outside = part
            else:
                inside = part
                np.testing.assert_allclose(flight.x[-1], middle + part * way, atol=1e-5)
        assert 0 < inside


def test_displacements_are_goals_less_coasting(rng):
    start, goals = swarm(rng, orbit, 300.0)
    b = compute_displacements(orbit, start, goals)
    free = orbit.simulate(start[2], np.zeros((16, 3)))[-1]
    np.testing.assert_allclose(b[2, 3], goals[3] - free, atol=1e-9)


def test_distance_is_straight_and_knows_no_speed(rng):
    start, goals = swarm(rng, plane, 1.0)
    d = compute_distances(plane, start, goals)
    assert d[1, 2] == pytest.approx(np.hypot(*(start[1, :2] - goals[2, :2])))
    start[:, 2:] += 1.0
    np.testing.assert_array_equal(compute_distances(plane, start, goals), d)


def test_squared_distances_are_assigned_without_crossing(rng):
    start, goals = (np.hstack([rng.uniform(0, 10, (30, 2)), np.zeros((30, 2))]) for _ in range(2))
    target = solve_assignment(compute_distances(plane, start, goals) ** 2)
    relative = (start[:, None] - start[None])[..., :2]
    ends = (goals[target][:, None] - goals[target][None])[..., :2]
    assert ((relative * ends).sum(axis=2) >= -1e-9).all()  # optimal transport is monotone


@both
def test_energy_is_the_least_there_is(rng, steps, size, U):
    start, goals = swarm(rng, steps, size, 2, 2)
    E = compute_energies(steps, start, goals)
    C = steps.simulate(
        np.zeros((steps.axes * len(steps), 2 * steps.axes)),
        np.eye(steps.axes * len(steps)).reshape(-1, len(steps), steps.axes),
    )[:, -1]
    b = compute_displacements(steps, start, goals)
    for i, j in np.ndindex(2, 2):
        u = np.linalg.lstsq(C.T, b[i, j])[0]
        np.testing.assert_allclose(C.T @ u, b[i, j], rtol=1e-6)
        assert E[i, j] == pytest.approx(steps.dt * u @ u, rel=1e-8)


def test_energy_from_rest_to_rest_is_known(rng):
    fine = discretize_zoh(DoubleIntegrator(2), 0.05, 400)  # 20 s in small steps
    start, goals = np.zeros((1, 4)), np.array([[3.0, -2.0, 0, 0]])
    assert compute_energies(fine, start, goals)[0, 0] == pytest.approx(12 * 13 / 20**3, rel=1e-4)


def test_energy_with_too_few_steps_is_that_of_coming_nearest(rng):
    one = plane[:1]
    start, u = rng.normal(size=(2, 4)), rng.normal(size=(2, 1, 2))
    goals = one.simulate(start, u)[:, -1]
    np.testing.assert_allclose(
        np.diag(compute_energies(one, start, goals)), (u**2).sum(axis=(1, 2))
    )
    away = compute_energies(one, start, goals)[0, 1]
    free = one.simulate(start[0], np.zeros((1, 2)))[-1]
    miss = lambda v: ((goals[1] - free - one.B[0] @ v) ** 2).sum()  # noqa: E731
    best = minimize(miss, np.zeros(2), tol=1e-12).x
    assert away == pytest.approx(best @ best, rel=1e-5)


@pytest.mark.parametrize("ask", [compute_transfer_costs, compute_exact_costs])
@pytest.mark.parametrize(
    ("U", "V", "what"),
    [(0.0, 1.0, "max_control"), (0.1, np.nan, "max_speed"), (0.1, 0.0, "max_speed")],
)
def test_limits_that_make_no_sense_are_refused(ask, U, V, what):
    with pytest.raises(ValueError, match=f"{what} must be positive"):
        ask(plane, np.zeros((1, 4)), np.ones((1, 4)), U, V)


def test_an_agent_that_is_nowhere_is_refused():
    with pytest.raises(ValueError, match="not finite"):
        compute_transfer_costs(plane, np.full((1, 4), np.nan), np.ones((1, 4)), 0.1)
