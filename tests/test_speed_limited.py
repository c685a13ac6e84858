"""Pairs that the speed limit binds: laws, and against Clarabel and the statement."""

from itertools import pairwise
from math import inf

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import problems.speed_limited as module
from dynamics import ClohessyWiltshire, DiscreteModel, DoubleIntegrator, discretize_zoh
from problems.conic import Infeasible
from problems.minimum_fuel import solve_minimum_fuel
from problems.sparse_transfer import SparseTransferSolver
from problems.speed_limited import SpeedLimitedSolver
from problems.transfer import TransferProblem

plane, space = (discretize_zoh(DoubleIntegrator(d), 1.0, 16) for d in (2, 3))
line = DiscreteModel(plane.A[:, ::2, ::2], plane.B[:, ::2, ::2], plane.z[:, ::2], 1.0)
orbit = discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 16)
models = {"plane": (plane, 0.1, 0.35), "space": (space, 0.1, 0.4), "orbit": (orbit, 0.01, 2.5)}
all_models = pytest.mark.parametrize(("steps", "U", "V"), models.values(), ids=models)
any_model = st.sampled_from(list(models)).map(models.get)
seeds = st.integers(0, 2**32 - 1)
programmes = pytest.mark.parametrize("programme", [SpeedLimitedSolver, SparseTransferSolver])


def ends(steps, rng, U, V, count):
    """Starts, and goals that some control reaches, whatever its speed on the way."""
    d, T = steps.axes, len(steps)
    start = np.hstack([rng.normal(0, V, (count, d)), rng.uniform(-V, V, (count, d)) / 2])
    u = rng.uniform(-U, U, (count, T, d))
    there = rng.uniform(-U, U, (count, 1, d)) * np.linspace(1, -1, T)[:, None]
    u[::2] = np.clip(there + rng.normal(0, U / 3, u.shape), -U, U)[::2]
    return start, steps.simulate(start, u)[:, -1]


def bound_pairs(steps, rng, U, V, count):
    """Of these, those whose cheapest flights break the limit; and the prices without it."""
    start, goal = ends(steps, rng, U, V, 50 * count)
    free = steps.simulate(start, np.zeros((len(start), len(steps), steps.axes)))[:, -1]
    burns = solve_minimum_fuel(steps, goal - free, U, np.ones(len(steps)))
    x = steps.simulate(start, burns.u)
    peak = np.linalg.norm(x[:, 1:-1, steps.axes :], axis=2).max(axis=1)
    some = np.flatnonzero((peak > 1.001 * V) & (peak < 1.1 * V))[:count]
    return start[some], goal[some], burns.fuel[some]


def changing(rng, T=12, d=2):
    """Dynamics that change in time and drift, with nothing that is zero."""
    n = 2 * d
    A = np.eye(n) + rng.normal(size=(T, n, n)) / 15
    return DiscreteModel(A, rng.normal(size=(T, n, d)) / 2, rng.normal(size=(T, n)) / 20, 0.5)


@all_models
def test_a_flight_arrives_within_both_limits_and_is_proven_the_cheapest(rng, steps, U, V):
    start, goal, lower = bound_pairs(steps, rng, U, V, 60)
    burns, d = SpeedLimitedSolver(TransferProblem(steps, U, V)).solve_many(start, goal), steps.axes
    found = np.isfinite(burns.fuel)
    assert 20 < found.sum()
    x = steps.simulate(start[found], burns.u[found])
    np.testing.assert_allclose(x[:, -1], goal[found], atol=1e-8 * np.abs(goal).max())
    assert np.abs(burns.u[found]).max() <= U
    assert np.linalg.norm(x[:, 1:-1, d:], axis=2).max() <= V * (1 + 2e-9)
    np.testing.assert_allclose(burns.fuel[found], steps.dt * np.abs(burns.u[found]).sum((1, 2)))
    np.testing.assert_allclose(burns.dual_bound[found], burns.fuel[found], rtol=1e-7)
    assert (burns.fuel >= lower * (1 - 1e-7)).all()
    assert np.isnan(burns.u[~found]).all()
    assert np.isposinf(burns.fuel[~found]).all() and np.isposinf(burns.dual_bound[~found]).all()


@programmes
@pytest.mark.parametrize(("steps", "U", "V"), [(plane, 0.1, 0.35), (orbit, 0.01, 2.5)])
def test_every_programme_is_the_statement(rng, programme, steps, U, V):
    transfer = TransferProblem(steps, U, V)
    asked, found = programme(transfer), 0
    for start, goal, lower in zip(*bound_pairs(steps, rng, U, V, 12), strict=True):
        try:
            stated = transfer.solve(start, goal)
        except Infeasible:
            with pytest.raises(Infeasible):
                asked.solve(start, goal)
            continue
        found += 1
        x, u, fuel = asked.solve(start, goal)
        assert fuel == pytest.approx(stated.fuel, rel=1e-5)  # in SI units Clarabel does no better
        assert fuel >= lower * (1 - 1e-7)
        np.testing.assert_allclose(steps.simulate(start, u), x)
        np.testing.assert_allclose(x[-1], goal, atol=1e-7 * np.abs(goal).max())
    assert found >= 3


@all_models
def test_clarabel_finds_the_same_prices_and_the_same_out_of_reach(rng, steps, U, V):
    start, goal, _ = bound_pairs(steps, rng, U, 0.8 * V, 60)
    transfer = TransferProblem(steps, U, 0.8 * V)
    same_as_clarabel(transfer, start, goal)


@pytest.mark.parametrize("d", [2, 3])
def test_dynamics_that_change_and_drift_are_no_different(rng, d):
    for _ in range(4):
        steps = changing(rng, d=d)
        start = rng.normal(size=(20, 2 * d)) / 5
        u = rng.uniform(-0.3, 0.3, (20, len(steps), d)) * rng.random((20, 1, 1))
        goal = steps.simulate(start, u)[:, -1]
        same_as_clarabel(TransferProblem(steps, 0.3, 0.6, tie_break_rise=0.2), start, goal)


def same_as_clarabel(transfer, start, goal):
    burns, judge, out = (
        SpeedLimitedSolver(transfer).solve_many(start, goal),
        SparseTransferSolver(transfer),
        0,
    )
    for fuel, u, x, g in zip(burns.fuel, burns.u, start, goal, strict=True):
        if np.isinf(fuel):
            out += 1
            with pytest.raises(Infeasible):
                judge.solve(x, g)
            continue
        theirs = transfer.weights @ np.abs(judge.solve(x, g).u).sum(axis=1)
        assert transfer.weights @ np.abs(u).sum(axis=1) == pytest.approx(theirs, rel=1e-6)
    assert 3 < len(start) - out


def test_along_a_line_the_limit_is_linear_and_highs_says_the_same(rng):
    from scipy.optimize import linprog

    U, V, T = 0.1, 0.4, len(line)
    start, goal, _ = bound_pairs(line, rng, U, V, 30)
    burns = SpeedLimitedSolver(TransferProblem(line, U, V)).solve_many(start, goal)
    R, free = (
        TransferProblem(line, U).response_matrices[0],
        line.simulate(start, np.zeros((len(start), T, 1))),
    )
    rows = np.vstack([R[1:T, 1], -R[1:T, 1]])
    for fuel, x, g in zip(burns.fuel, free, goal, strict=True):
        room = np.concatenate([V - x[1:T, 1], V + x[1:T, 1]])
        said = linprog(
            np.ones(2 * T),
            A_ub=np.hstack([rows, -rows]),
            b_ub=room,
            A_eq=np.hstack([R[T], -R[T]]),
            b_eq=g - x[T],
            bounds=(0, U),
        )
        assert fuel == pytest.approx(said.fun, rel=1e-7) if said.status == 0 else fuel == inf
    assert 8 < np.isfinite(burns.fuel).sum() < len(start)


@settings(max_examples=15)
@given(seeds, any_model)
def test_a_limit_costs_and_a_looser_one_costs_less(seed, model):
    steps, U, V = model
    start, goal = ends(steps, np.random.default_rng(seed), U, V, 12)
    prices = [
        SpeedLimitedSolver(TransferProblem(steps, U, v)).solve_many(start, goal).fuel
        for v in (V, 1.3 * V, 1e3)
    ]
    tiny = 1e-9 * U * steps.dt
    for dearer, cheaper in pairwise(prices):
        assert (cheaper <= dearer * (1 + 1e-7) + tiny).all()
    free = goal - steps.simulate(start, np.zeros((12, len(steps), steps.axes)))[:, -1]
    unlimited = solve_minimum_fuel(steps, free, U, np.ones(len(steps))).fuel
    np.testing.assert_allclose(prices[-1], unlimited, rtol=1e-7, atol=tiny)


@settings(max_examples=15)
@given(seeds, any_model, st.floats(-6, 6))
def test_scale_is_scale_and_along_the_orbit_every_place_is_alike(seed, model, power):
    steps, U, V = model
    start, goal = ends(steps, np.random.default_rng(seed), U, V, 8)
    here = SpeedLimitedSolver(TransferProblem(steps, U, V)).solve_many(start, goal).fuel
    s, tiny = 10.0**power, 1e-9 * U * steps.dt
    there = (
        SpeedLimitedSolver(TransferProblem(steps, s * U, s * V))
        .solve_many(s * start, s * goal)
        .fuel
    )
    np.testing.assert_allclose(there / s, here, rtol=1e-7, atol=tiny)
    away = np.eye(2 * steps.axes)[1] * 7 * V
    there = (
        SpeedLimitedSolver(TransferProblem(steps, U, V)).solve_many(start + away, goal + away).fuel
    )
    np.testing.assert_allclose(there, here, rtol=1e-7, atol=tiny)


@settings(max_examples=15)
@given(seeds, any_model)
def test_fuel_is_convex_in_both_ends(seed, model):
    steps, U, V = model
    start, goal = ends(steps, np.random.default_rng(seed), U, V, 16)
    programme = SpeedLimitedSolver(TransferProblem(steps, U, V))
    both = programme.solve_many(start, goal).fuel.reshape(2, 8)
    middle = [end.reshape(2, 8, -1).mean(axis=0) for end in (start, goal)]
    most = both.mean(axis=0) * (1 + 1e-7) + 1e-9 * U * steps.dt
    assert (programme.solve_many(*middle).fuel <= most).all()


def test_another_lot_does_not_change_a_bit(rng):
    programme = SpeedLimitedSolver(TransferProblem(orbit, 0.01, 2.5))
    start, goal, _ = bound_pairs(orbit, rng, 0.01, 2.5, 30)
    first = np.array([0, 10, 10, 30])
    whole = programme.solve_many(start, goal, first)
    changed = programme.solve_many(
        *(np.vstack([e[29:19:-1], e[10:]]) for e in (start, goal)), first
    )
    np.testing.assert_array_equal(whole.u[10:], changed.u[10:])
    np.testing.assert_array_equal(whole.dual_bound[10:], changed.dual_bound[10:])
    together = programme.solve_many(start, goal)
    np.testing.assert_allclose(together.fuel, whole.fuel, rtol=1e-7)


def test_no_pair_of_many_is_left_to_clarabel(rng, monkeypatch):
    monkeypatch.setattr(module, "SparseTransferSolver", None)
    for steps, U, V in models.values():
        start, goal, _ = bound_pairs(steps, rng, U, V, 200)
        burns = SpeedLimitedSolver(TransferProblem(steps, U, V)).solve_many(start, goal)
        assert len(start) == 200 and not np.isnan(burns.fuel).any()


def test_what_the_cuts_do_not_answer_is_asked_of_clarabel(rng, monkeypatch):
    transfer = TransferProblem(plane, 0.1, 0.35)
    start, goal, _ = bound_pairs(plane, rng, 0.1, 0.35, 12)
    cuts = SpeedLimitedSolver(transfer).solve_many(start, goal)
    monkeypatch.setattr(module, "MAX_PIVOTS", 0)
    cones = SpeedLimitedSolver(transfer).solve_many(start, goal)
    assert np.isinf(cuts.fuel).any() and np.isfinite(cuts.fuel).any()
    np.testing.assert_allclose(cones.fuel, cuts.fuel, rtol=1e-6)
    np.testing.assert_allclose(cones.dual_bound, cuts.dual_bound, rtol=1e-6)


@programmes
@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_steps_are_enough_where_they_are(rng, programme, count):
    steps = plane[:count]
    start, u = np.array([0, 0, 0.1, 0.1]), rng.uniform(-0.1, 0.1, (count, 2))
    goal = steps.simulate(start, u)[-1]
    asked = programme(TransferProblem(steps, 0.1, 0.5))
    np.testing.assert_allclose(asked.solve(start, goal).x[-1], goal, atol=1e-8)
    with pytest.raises(Infeasible):
        asked.solve(start, goal + 1.0)


@all_models
def test_staying_and_coasting_are_free_at_the_very_limit(steps, U, V):
    programme, d = SpeedLimitedSolver(TransferProblem(steps, U, V)), steps.axes
    nothing = np.zeros(2 * d)
    assert programme.solve(nothing, nothing).fuel < 1e-10
    coast = np.zeros(2 * d)
    coast[d + 1] = 1.0
    x = steps.simulate(coast, np.zeros((len(steps), d)))
    coast *= V / np.linalg.norm(x[1:-1, d:], axis=1).max()
    end = steps.simulate(coast, np.zeros((len(steps), d)))[-1]
    assert programme.solve(coast, end).fuel < 1e-8 * U * steps.dt


def test_who_comes_too_fast_brakes_in_the_first_step_or_not_at_all():
    """Speed 0.4 where 0.35 is allowed, and 0.1 is what one step takes off; 0.5 is too much."""
    programme = SpeedLimitedSolver(TransferProblem(plane, 0.1, 0.35))
    start = np.array([0, 0, 0.4, 0.0])
    flight = programme.solve(start, plane.simulate(start, np.full((16, 2), -1e-2))[-1])
    assert np.linalg.norm(flight.x[1, 2:]) <= 0.35 * (1 + 2e-9)
    start[2] = 0.5
    with pytest.raises(Infeasible, match="unreachable"):
        programme.solve(start, np.zeros(4))


def test_a_speed_that_nothing_changes_is_within_the_limit_or_not():
    A, B = np.tile(np.eye(4), (5, 1, 1)), np.zeros((5, 4, 2))
    A[:, 0, 2] = A[:, 1, 3] = B[:, 2, 0] = 1.0  # the second axis has lost its thruster
    programme = SpeedLimitedSolver(
        TransferProblem(DiscreteModel(A, B, np.zeros((5, 4)), 1.0), 0.1, 0.5)
    )
    start = np.array([0, 0, 0, 0.3])
    assert programme.solve(start, np.array([0.5, 1.5, 0.1, 0.3])).fuel > 0
    with pytest.raises(Infeasible):
        programme.solve(start, np.array([0.5, 1.4, 0.1, 0.3]))
    start[3] = 0.6
    with pytest.raises(Infeasible):
        programme.solve(start, np.array([0.5, 3.0, 0.1, 0.6]))


@programmes
@pytest.mark.parametrize("changes", [(inf, 1, "inf"), (0.5, 2, "inf"), (0.5, 1, 2)])
def test_what_needs_another_programme_is_refused(programme, changes):
    with pytest.raises(ValueError, match=r"use TransferProblem\.solve"):
        programme(TransferProblem(plane, 0.1, *changes))


@programmes
def test_no_steps_are_refused(programme):
    with pytest.raises(ValueError, match="at least one step"):
        programme(TransferProblem(plane[:0], 0.1, 0.5))


def test_no_pairs_have_no_answers():
    burns = SpeedLimitedSolver(TransferProblem(plane, 0.1, 0.5)).solve_many(
        np.zeros((0, 4)), np.zeros((0, 4))
    )
    assert burns.u.shape == (0, 16, 2) and burns.fuel.shape == burns.dual_bound.shape == (0,)
