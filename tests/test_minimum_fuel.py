"""Least fuel for very many end points, against its laws, HiGHS and Clarabel."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csc_array

import problems.minimum_fuel as module
from dynamics import ClohessyWiltshire, DiscreteModel, DoubleIntegrator, discretize_zoh
from problems.conic import ConicProgram, Infeasible, solve
from problems.minimum_fuel import decouple_axes, reachability_matrix, solve_minimum_fuel
from problems.solvers import solve_clarabel, solve_highs
from problems.transfer import tie_break_weights

plane, space = (discretize_zoh(DoubleIntegrator(d), 1.0, 20) for d in (2, 3))
orbit = discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 24)
models = {"2-D": plane, "3-D": space, "CW": orbit}
all_models = pytest.mark.parametrize("steps", models.values(), ids=models)
any_model = st.sampled_from(list(models)).map(models.get)
seeds = st.integers(0, 2**32 - 1)
even = np.ones


def landed(steps, u):
    return np.einsum("nkm,qkm->qn", reachability_matrix(steps), u)


def displacements(steps, rng, count, U):
    """Half of them by random controls, the other half anywhere nearby; some out of reach."""
    d = steps.axes
    idle = rng.random((count, len(steps), d)) < rng.random((count, 1, 1))
    b = landed(steps, np.where(idle, 0, rng.uniform(-U, U, (count, len(steps), d))))
    b[::2] *= rng.uniform(0, 8, (len(b[::2]), 2 * d))
    return b


def truth(steps, b, U, weight, solver=solve_highs):
    """The same question as a linear programme in u⁺ and u⁻; infinite where out of reach."""
    C = reachability_matrix(steps).reshape(len(b), -1)
    scale = np.abs(C).max(axis=1)
    C, N = C / scale[:, None], 2 * C.shape[1]
    A = csc_array(np.vstack([np.hstack([C, -C]), np.eye(N), -np.eye(N)]))
    limits = np.concatenate([b / scale / U, np.ones(N), np.zeros(N)])
    cost = steps.dt * U * np.tile(np.repeat(weight, steps.axes), 2)
    try:
        return cost @ solve(ConicProgram(cost, A, limits, len(b), 2 * N), solver).x
    except Infeasible:
        return np.inf


@all_models
def test_nothing_costs_nothing(steps):
    burns = solve_minimum_fuel(steps, np.zeros((3, 2 * steps.axes)), 0.3, even(len(steps)))
    assert burns.fuel.max() < 1e-11
    np.testing.assert_allclose(burns.dual_bound, 0, atol=1e-12)


@all_models
def test_answers_arrive_within_the_limit_and_are_proven(rng, steps):
    U, weight = 0.02, tie_break_weights(len(steps), 1e-3)
    b = displacements(steps, rng, 400, U)
    burns = solve_minimum_fuel(steps, b, U, weight)
    found = np.isfinite(burns.fuel)
    assert 100 < found.sum() < 400
    u = burns.u[found]
    assert np.abs(u).max() <= U
    size = np.abs(reachability_matrix(steps)).max(axis=(1, 2)) * U
    np.testing.assert_allclose(landed(steps, u) / size, b[found] / size, atol=1e-8)
    np.testing.assert_allclose(burns.fuel[found], steps.dt * np.abs(u).sum(axis=(1, 2)))
    priced = steps.dt * np.einsum("k,qkm->q", weight, np.abs(u))
    assert (burns.dual_bound[found] <= priced * (1 + 1e-9) + 1e-12).all()
    np.testing.assert_allclose(burns.dual_bound[found], priced, rtol=1e-8, atol=1e-12)
    assert np.isnan(burns.u[~found]).all()
    assert np.isposinf(burns.fuel[~found]).all() and np.isposinf(burns.dual_bound[~found]).all()


@settings(deadline=None, max_examples=25)
@given(seeds, any_model)
def test_the_way_back_costs_the_same_and_scale_is_scale(seed, steps):
    rng, U, w = np.random.default_rng(seed), 0.05, even(len(steps))
    b = displacements(steps, rng, 8, U)
    fuel = solve_minimum_fuel(steps, b, U, w).fuel
    tiny = 1e-9 * U * steps.dt
    np.testing.assert_allclose(solve_minimum_fuel(steps, -b, U, w).fuel, fuel, rtol=1e-9, atol=tiny)
    for scale in (1e-9, 1e6):
        scaled = solve_minimum_fuel(steps, scale * b, scale * U, w).fuel
        np.testing.assert_allclose(scaled, scale * fuel, rtol=1e-9, atol=scale * tiny)


@settings(deadline=None, max_examples=25)
@given(seeds, any_model)
def test_fuel_is_convex_in_the_displacement_and_falls_with_the_limit(seed, steps):
    rng, U, w = np.random.default_rng(seed), 0.05, even(len(steps))
    a, b = displacements(steps, rng, 16, U).reshape(2, 8, -1)
    both = np.array([solve_minimum_fuel(steps, c, U, w).fuel for c in (a, b)])
    middle = solve_minimum_fuel(steps, (a + b) / 2, U, w).fuel
    tiny = 1e-9 * U * steps.dt
    assert (middle <= both.mean(axis=0) + tiny).all()
    assert (solve_minimum_fuel(steps, a, 2 * U, w).fuel <= both[0] + tiny).all()


@settings(deadline=None, max_examples=25)
@given(seeds, st.integers(1, 6), st.sampled_from([DoubleIntegrator(2), ClohessyWiltshire(1.1e-3)]))
def test_every_end_that_some_control_reaches_is_reached_for_no_more(seed, count, model):
    steps = discretize_zoh(model, 30.0, count)
    rng, U = np.random.default_rng(seed), 0.1
    u = rng.choice([-U, 0.0, 0.3 * U, U], size=(8, count, model.axes))  # also at the very limit
    burns = solve_minimum_fuel(steps, landed(steps, u), U, even(count))
    spent = steps.dt * np.abs(u).sum(axis=(1, 2))
    assert (burns.fuel <= spent * (1 + 1e-6) + 1e-9).all()


def test_the_answer_to_many_is_the_answer_to_each(rng):
    b = displacements(orbit, rng, 60, 0.01)
    together = solve_minimum_fuel(orbit, b, 0.01, tie_break_weights(24, 1e-6))
    for q in range(60):
        alone = solve_minimum_fuel(orbit, b[q : q + 1], 0.01, tie_break_weights(24, 1e-6))
        np.testing.assert_allclose(alone.u[0], together.u[q], atol=1e-10)
        np.testing.assert_allclose(alone.fuel[0], together.fuel[q], rtol=1e-12)


def test_another_lot_does_not_change_a_bit(rng):
    b = displacements(plane, rng, 120, 0.1)
    whole = solve_minimum_fuel(plane, b, 0.1, even(20), batches=6)
    b[:40] = displacements(plane, rng, 40, 0.1)
    changed = solve_minimum_fuel(plane, b, 0.1, even(20), batches=6)
    np.testing.assert_array_equal(whole.u[40:], changed.u[40:])
    np.testing.assert_array_equal(whole.dual_bound[40:], changed.dual_bound[40:])


@pytest.mark.parametrize("count", [1, 2, 3, 24])
@pytest.mark.parametrize("solver", [solve_highs, solve_clarabel])
@pytest.mark.parametrize(
    "model",
    [DoubleIntegrator(2), DoubleIntegrator(3), ClohessyWiltshire(1.1e-3)],
    ids=["2-D", "3-D", "CW"],
)
def test_other_solvers_find_the_same(rng, model, count, solver):
    steps = discretize_zoh(model, 60.0, count)
    U, weight = 0.01, tie_break_weights(count, 0.1)
    b = displacements(steps, rng, 24, U)
    burns = solve_minimum_fuel(steps, b, U, weight)
    priced = steps.dt * np.einsum("k,qkm->q", weight, np.abs(burns.u))
    priced[np.isnan(priced)] = np.inf
    other = np.array([truth(steps, row, U, weight, solver) for row in b])
    assert np.isfinite(other).any() and np.isinf(other).any()
    np.testing.assert_allclose(priced, other, rtol=1e-6, atol=1e-7)


def test_dynamics_that_change_in_time_are_no_different(rng):
    shapes = (8, 4, 4), (8, 4, 2)
    A, B = np.eye(4) + rng.normal(size=shapes[0]) / 5, rng.normal(size=shapes[1])
    steps = DiscreteModel(A, B, np.zeros((8, 4)), 0.5)
    assert len(decouple_axes(steps)) == 1
    b = displacements(steps, rng, 20, 0.2)
    fuel = solve_minimum_fuel(steps, b, 0.2, even(8)).fuel
    np.testing.assert_allclose(fuel, [truth(steps, row, 0.2, even(8)) for row in b], rtol=1e-6)


def test_axes_are_told_apart():
    def groups(steps):
        return [(s.tolist(), i.tolist()) for s, i in decouple_axes(steps)]

    assert groups(plane) == [([0, 2], [0]), ([1, 3], [1])]
    assert groups(space) == [([0, 3], [0]), ([1, 4], [1]), ([2, 5], [2])]
    assert groups(orbit) == [([0, 1, 3, 4], [0, 1]), ([2, 5], [2])]


def test_a_state_that_nothing_moves_must_be_left_alone():
    A, B = np.tile(np.eye(4), (5, 1, 1)), np.zeros((5, 4, 2))
    A[:, 0, 2] = B[:, 2, 0] = 1.0  # the second axis has lost its thruster
    steps = DiscreteModel(A, B, np.zeros((5, 4)), 1.0)
    burns = solve_minimum_fuel(
        steps, np.array([[1.0, 0, 0.2, 0], [1.0, 0.1, 0.2, 0]]), 0.5, even(5)
    )
    assert burns.fuel[0] > 0
    assert burns.fuel[1] == np.inf
    np.testing.assert_allclose(landed(steps, burns.u[:1]), [[1.0, 0, 0.2, 0]], atol=1e-12)


def test_two_thrusters_that_push_alike_share():
    # Rank 2 for 4 states, and 5 × 2 controls: the answer is still the cheapest.
    A, B = np.tile(np.eye(4), (5, 1, 1)), np.zeros((5, 4, 2))
    A[:, 0, 2] = 1.0
    B[:, 2], B[:, 3, 1] = [1.0, 2.0], 0.0
    B[:, 1] = B[:, 2]
    steps = DiscreteModel(A, B, np.zeros((5, 4)), 1.0)
    u = np.zeros((1, 5, 2))
    u[0, :2, 1] = 0.4, -0.1
    b = landed(steps, u)
    burns = solve_minimum_fuel(steps, b, 0.5, even(5))
    np.testing.assert_allclose(landed(steps, burns.u), b, atol=1e-12)
    assert burns.fuel[0] <= 0.5 + 1e-12
    assert solve_minimum_fuel(steps, b + np.eye(4)[1] / 10, 0.5, even(5)).fuel[0] == np.inf


def test_far_beyond_reach_is_beyond_reach():
    b = np.array([[1e12, 0, 0, 0], [0, 0, 1e9, 0], [1e-300, 0, 0, 0], [0, 0, 0, 1e-20]])
    fuel = solve_minimum_fuel(plane, b, 0.1, even(20)).fuel
    assert np.isinf(fuel[:2]).all()
    assert (fuel[2:] < 1e-10).all()


@pytest.mark.parametrize("pivots", [0, 1, 3])
def test_a_question_that_runs_out_of_pivots_is_answered_by_highs(rng, monkeypatch, pivots):
    b = displacements(plane, rng, 20, 0.1)
    weight = tie_break_weights(20, 1e-2)
    whole = solve_minimum_fuel(plane, b, 0.1, weight)
    monkeypatch.setattr(module, "MAX_PIVOTS", pivots)
    short = solve_minimum_fuel(plane, b, 0.1, weight)
    assert np.isinf(whole.fuel).any()
    np.testing.assert_allclose(short.fuel, whole.fuel, rtol=1e-6)
    np.testing.assert_allclose(short.dual_bound, whole.dual_bound, rtol=1e-6)


def test_an_answer_that_cannot_be_proven_is_asked_of_highs(rng, monkeypatch):
    b = displacements(plane, rng, 20, 0.1)
    asked = []

    def ask(Q, b, U, w):
        asked.append(b)
        return np.zeros(Q.shape[1]), 0.0

    monkeypatch.setattr(module, "_solve_with_highs", ask)
    solve_minimum_fuel(plane, b, 0.1, even(20))
    assert not asked
    monkeypatch.setattr(module, "MAX_PIVOTS", 0)
    solve_minimum_fuel(plane, b, 0.1, even(20))
    assert len(asked) > 20  # two axes a question, but for a lucky few


@pytest.mark.parametrize(
    ("what", "changes"),
    [
        ("at least one step", {"steps": plane[:0], "weight": np.ones(0)}),
        ("max_control must be positive and finite, got 0", {"max_control": 0.0}),
        ("max_control must be positive and finite, got nan", {"max_control": np.nan}),
        ("max_control must be positive and finite, got inf", {"max_control": np.inf}),
        ("displacement 1 is not finite", {"displacement": np.array([[0.0] * 4, [np.nan] * 4])}),
        ("a positive weight for each of 20 steps", {"weight": np.zeros(20)}),
        ("a positive weight for each of 20 steps", {"weight": -np.ones(20)}),
    ],
)
def test_what_makes_no_sense_is_refused(what, changes):
    good = {
        "steps": plane,
        "displacement": np.zeros((2, 4)),
        "max_control": 0.1,
        "weight": np.ones(20),
    }
    with pytest.raises(ValueError, match=what):
        solve_minimum_fuel(**(good | changes))


def test_no_questions_have_no_answers():
    burns = solve_minimum_fuel(plane, np.zeros((0, 4)), 0.1, even(20))
    assert burns.u.shape == (0, 20, 2)
    assert burns.fuel.shape == burns.dual_bound.shape == (0,)
