"""Transfers with an active speed limit: laws, Clarabel, HiGHS and CVXPY."""

from itertools import pairwise
from math import inf

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from dynamics import ClohessyWiltshire, DiscreteModel, DoubleIntegrator, discretize_zoh
from problems import speed_limited
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
both_solvers = pytest.mark.parametrize("solver", [SpeedLimitedSolver, SparseTransferSolver])


def reachable_pairs(steps, rng, U, V, count):
    """Draw starts, and targets that some control reaches, whatever its speed."""
    d, T = steps.axes, len(steps)
    start = np.hstack([rng.normal(0, V, (count, d)), rng.uniform(-V, V, (count, d)) / 2])
    u = rng.uniform(-U, U, (count, T, d))
    there = rng.uniform(-U, U, (count, 1, d)) * np.linspace(1, -1, T)[:, None]
    u[::2] = np.clip(there + rng.normal(0, U / 3, u.shape), -U, U)[::2]
    return start, steps.simulate(start, u)[:, -1]


def bound_pairs(steps, rng, U, V, count):
    """Draw pairs whose cheapest trajectory breaks the limit; and their fuel without it."""
    start, target = reachable_pairs(steps, rng, U, V, 50 * count)
    free = steps.simulate(start, np.zeros((len(start), len(steps), steps.axes)))[:, -1]
    result = solve_minimum_fuel(steps, target - free, U, np.ones(len(steps)))
    x = steps.simulate(start, result.u)
    peak = np.linalg.norm(x[:, 1:-1, steps.axes :], axis=2).max(axis=1)
    some = np.flatnonzero((peak > 1.001 * V) & (peak < 1.1 * V))[:count]
    return start[some], target[some], result.fuel[some]


def changing(rng, T=12, d=2):
    """Draw dynamics that change in time and drift, without any zero."""
    n = 2 * d
    A = np.eye(n) + rng.normal(size=(T, n, n)) / 15
    return DiscreteModel(A, rng.normal(size=(T, n, d)) / 2, rng.normal(size=(T, n)) / 20, 0.5)


@all_models
def test_solutions_arrive_within_both_limits_at_their_dual_bound(rng, steps, U, V):
    start, target, lower = bound_pairs(steps, rng, U, V, 60)
    result = SpeedLimitedSolver(TransferProblem(steps, U, V)).solve_many(start, target)
    d = steps.axes
    found = np.isfinite(result.fuel)
    assert 20 < found.sum()
    x = steps.simulate(start[found], result.u[found])
    assert_allclose(x[:, -1], target[found], atol=1e-8 * np.abs(target).max())
    assert np.abs(result.u[found]).max() <= U
    assert np.linalg.norm(x[:, 1:-1, d:], axis=2).max() <= V * (1 + 2e-9)
    assert_allclose(result.fuel[found], steps.dt * np.abs(result.u[found]).sum((1, 2)))
    assert_allclose(result.dual_bound[found], result.fuel[found], rtol=1e-7)
    assert (result.fuel >= lower * (1 - 1e-7)).all()
    assert np.isnan(result.u[~found]).all()
    assert np.isposinf(result.fuel[~found]).all() and np.isposinf(result.dual_bound[~found]).all()


@both_solvers
@pytest.mark.parametrize(("steps", "U", "V"), [(plane, 0.1, 0.35), (orbit, 0.01, 2.5)])
def test_both_solvers_agree_with_the_cvxpy_statement(rng, solver, steps, U, V):
    transfer = TransferProblem(steps, U, V)
    fast, found = solver(transfer), 0
    for start, target, lower in zip(*bound_pairs(steps, rng, U, V, 12), strict=True):
        try:
            expected = transfer.solve(start, target)
        except Infeasible:
            with pytest.raises(Infeasible):
                fast.solve(start, target)
            continue
        found += 1
        x, u, fuel = fast.solve(start, target)
        assert fuel == pytest.approx(expected.fuel, rel=1e-5)  # in SI units Clarabel does no better
        assert fuel >= lower * (1 - 1e-7)
        assert_allclose(steps.simulate(start, u), x)
        assert_allclose(x[-1], target, atol=1e-7 * np.abs(target).max())
    assert found >= 3


@pytest.mark.parametrize("d", [2, 3])
def test_clarabel_agrees_for_dynamics_that_change_and_drift(rng, d):
    for _ in range(4):
        steps = changing(rng, d=d)
        start = rng.normal(size=(20, 2 * d)) / 5
        u = rng.uniform(-0.3, 0.3, (20, len(steps), d)) * rng.random((20, 1, 1))
        target = steps.simulate(start, u)[:, -1]
        assert_same_as_clarabel(TransferProblem(steps, 0.3, 0.6, tie_break_rise=0.2), start, target)


def assert_same_as_clarabel(transfer, start, target):
    result = SpeedLimitedSolver(transfer).solve_many(start, target)
    clarabel = SparseTransferSolver(transfer)
    infeasible = 0
    for fuel, u, x, g in zip(result.fuel, result.u, start, target, strict=True):
        if np.isinf(fuel):
            infeasible += 1
            with pytest.raises(Infeasible):
                clarabel.solve(x, g)
            continue
        theirs = transfer.weights @ np.abs(clarabel.solve(x, g).u).sum(axis=1)
        assert transfer.weights @ np.abs(u).sum(axis=1) == pytest.approx(theirs, rel=1e-6)
    assert 3 < len(start) - infeasible


def test_linprog_agrees_in_one_dimension(rng):
    from scipy.optimize import linprog

    U, V, T = 0.1, 0.4, len(line)
    start, target, _ = bound_pairs(line, rng, U, V, 30)
    result = SpeedLimitedSolver(TransferProblem(line, U, V)).solve_many(start, target)
    R = TransferProblem(line, U).response_matrices[0]
    free = line.simulate(start, np.zeros((len(start), T, 1)))
    rows = np.vstack([R[1:T, 1], -R[1:T, 1]])
    for fuel, x, g in zip(result.fuel, free, target, strict=True):
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
    assert 8 < np.isfinite(result.fuel).sum() < len(start)


@settings(max_examples=15)
@given(seeds, any_model)
def test_fuel_falls_with_a_looser_speed_limit(seed, model):
    steps, U, V = model
    start, target = reachable_pairs(steps, np.random.default_rng(seed), U, V, 12)
    fuels = [
        SpeedLimitedSolver(TransferProblem(steps, U, v)).solve_many(start, target).fuel
        for v in (V, 1.3 * V, 1e3)
    ]
    tiny = 1e-9 * U * steps.dt
    for dearer, cheaper in pairwise(fuels):
        assert (cheaper <= dearer * (1 + 1e-7) + tiny).all()
    free = target - steps.simulate(start, np.zeros((12, len(steps), steps.axes)))[:, -1]
    unlimited = solve_minimum_fuel(steps, free, U, np.ones(len(steps))).fuel
    assert_allclose(fuels[-1], unlimited, rtol=1e-7, atol=tiny)


@settings(max_examples=15)
@given(seeds, any_model, st.floats(-6, 6))
def test_fuel_scales_with_lengths_and_ignores_along_track_position(seed, model, power):
    steps, U, V = model
    start, target = reachable_pairs(steps, np.random.default_rng(seed), U, V, 8)
    here = SpeedLimitedSolver(TransferProblem(steps, U, V)).solve_many(start, target).fuel
    s, tiny = 10.0**power, 1e-9 * U * steps.dt
    there = (
        SpeedLimitedSolver(TransferProblem(steps, s * U, s * V))
        .solve_many(s * start, s * target)
        .fuel
    )
    assert_allclose(there / s, here, rtol=1e-7, atol=tiny)
    away = np.eye(2 * steps.axes)[1] * 7 * V
    there = (
        SpeedLimitedSolver(TransferProblem(steps, U, V))
        .solve_many(start + away, target + away)
        .fuel
    )
    assert_allclose(there, here, rtol=1e-7, atol=tiny)


@settings(max_examples=15)
@given(seeds, any_model)
def test_fuel_is_convex_in_start_and_target(seed, model):
    steps, U, V = model
    start, target = reachable_pairs(steps, np.random.default_rng(seed), U, V, 16)
    solver = SpeedLimitedSolver(TransferProblem(steps, U, V))
    both = solver.solve_many(start, target).fuel.reshape(2, 8)
    middle = [end.reshape(2, 8, -1).mean(axis=0) for end in (start, target)]
    most = both.mean(axis=0) * (1 + 1e-7) + 1e-9 * U * steps.dt
    assert (solver.solve_many(*middle).fuel <= most).all()


def test_other_batches_do_not_change_the_last_bit(rng):
    solver = SpeedLimitedSolver(TransferProblem(orbit, 0.01, 2.5))
    start, target, _ = bound_pairs(orbit, rng, 0.01, 2.5, 30)
    first = np.array([0, 10, 10, 30])
    whole = solver.solve_many(start, target, first)
    changed = solver.solve_many(*(np.vstack([e[29:19:-1], e[10:]]) for e in (start, target)), first)
    assert_array_equal(whole.u[10:], changed.u[10:])
    assert_array_equal(whole.dual_bound[10:], changed.dual_bound[10:])
    together = solver.solve_many(start, target)
    assert_allclose(together.fuel, whole.fuel, rtol=1e-7)


def test_cutting_planes_solve_all_of_many_pairs(rng, monkeypatch):
    monkeypatch.setattr(speed_limited, "SparseTransferSolver", None)
    for steps, U, V in models.values():
        start, target, _ = bound_pairs(steps, rng, U, V, 200)
        result = SpeedLimitedSolver(TransferProblem(steps, U, V)).solve_many(start, target)
        assert len(start) == 200 and not np.isnan(result.fuel).any()


def test_clarabel_solves_what_runs_out_of_pivots(rng, monkeypatch):
    transfer = TransferProblem(plane, 0.1, 0.35)
    start, target, _ = bound_pairs(plane, rng, 0.1, 0.35, 12)
    cuts = SpeedLimitedSolver(transfer).solve_many(start, target)
    monkeypatch.setattr(speed_limited, "MAX_PIVOTS", 0)
    cones = SpeedLimitedSolver(transfer).solve_many(start, target)
    assert np.isinf(cuts.fuel).any() and np.isfinite(cuts.fuel).any()
    assert_allclose(cones.fuel, cuts.fuel, rtol=1e-6)
    assert_allclose(cones.dual_bound, cuts.dual_bound, rtol=1e-6)


@both_solvers
@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_steps_reach_what_their_controls_reach(rng, solver, count):
    steps = plane[:count]
    start, u = np.array([0, 0, 0.1, 0.1]), rng.uniform(-0.1, 0.1, (count, 2))
    target = steps.simulate(start, u)[-1]
    fast = solver(TransferProblem(steps, 0.1, 0.5))
    assert_allclose(fast.solve(start, target).x[-1], target, atol=1e-8)
    with pytest.raises(Infeasible):
        fast.solve(start, target + 1.0)


@all_models
def test_staying_and_coasting_cost_nothing_at_the_speed_limit(steps, U, V):
    solver, d = SpeedLimitedSolver(TransferProblem(steps, U, V)), steps.axes
    nothing = np.zeros(2 * d)
    assert solver.solve(nothing, nothing).fuel < 1e-10
    coast = np.zeros(2 * d)
    coast[d + 1] = 1.0
    x = steps.simulate(coast, np.zeros((len(steps), d)))
    coast *= V / np.linalg.norm(x[1:-1, d:], axis=1).max()
    end = steps.simulate(coast, np.zeros((len(steps), d)))[-1]
    assert solver.solve(coast, end).fuel < 1e-8 * U * steps.dt


def test_excess_speed_must_be_removed_in_the_first_step():
    """One step removes 0.1: enough from 0.4 to the limit of 0.35, not from 0.5."""
    solver = SpeedLimitedSolver(TransferProblem(plane, 0.1, 0.35))
    start = np.array([0, 0, 0.4, 0.0])
    flight = solver.solve(start, plane.simulate(start, np.full((16, 2), -1e-2))[-1])
    assert np.linalg.norm(flight.x[1, 2:]) <= 0.35 * (1 + 2e-9)
    start[2] = 0.5
    with pytest.raises(Infeasible, match="unreachable"):
        solver.solve(start, np.zeros(4))


def test_an_uncontrolled_speed_above_the_limit_is_infeasible():
    A, B = np.tile(np.eye(4), (5, 1, 1)), np.zeros((5, 4, 2))
    A[:, 0, 2] = A[:, 1, 3] = B[:, 2, 0] = 1.0  # the second axis has no thruster
    solver = SpeedLimitedSolver(
        TransferProblem(DiscreteModel(A, B, np.zeros((5, 4)), 1.0), 0.1, 0.5)
    )
    start = np.array([0, 0, 0, 0.3])
    assert solver.solve(start, np.array([0.5, 1.5, 0.1, 0.3])).fuel > 0
    with pytest.raises(Infeasible):
        solver.solve(start, np.array([0.5, 1.4, 0.1, 0.3]))
    start[3] = 0.6
    with pytest.raises(Infeasible):
        solver.solve(start, np.array([0.5, 3.0, 0.1, 0.6]))


@both_solvers
@pytest.mark.parametrize("changes", [(inf, 1, "inf"), (0.5, 2, "inf"), (0.5, 1, 2)])
def test_other_norms_and_no_speed_limit_are_refused(solver, changes):
    with pytest.raises(ValueError, match=r"use TransferProblem\.solve"):
        solver(TransferProblem(plane, 0.1, *changes))


@both_solvers
def test_no_steps_are_refused(solver):
    with pytest.raises(ValueError, match="at least one step"):
        solver(TransferProblem(plane[:0], 0.1, 0.5))


def test_no_pairs_give_empty_results():
    result = SpeedLimitedSolver(TransferProblem(plane, 0.1, 0.5)).solve_many(
        np.zeros((0, 4)), np.zeros((0, 4))
    )
    assert result.u.shape == (0, 16, 2) and result.fuel.shape == result.dual_bound.shape == (0,)
