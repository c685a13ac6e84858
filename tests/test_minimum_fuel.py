"""Transfers of least fuel to many displacements: laws, HiGHS and Clarabel."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.sparse import csc_array

from dynamics import ClohessyWiltshire, DiscreteModel, DoubleIntegrator, discretize_zoh
from problems import minimum_fuel
from problems.conic import ConicProgram, Infeasible, solve
from problems.dual_simplex import INFEASIBLE
from problems.minimum_fuel import decouple_axes, reachability_matrix, solve_minimum_fuel
from problems.solvers import solve_clarabel, solve_highs
from problems.transfer import tie_break_weights

plane, space = (discretize_zoh(DoubleIntegrator(d), 1.0, 20) for d in (2, 3))
orbit = discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 24)
models = {"2-D": plane, "3-D": space, "CW": orbit}
all_models = pytest.mark.parametrize("steps", models.values(), ids=models)
any_model = st.sampled_from(list(models)).map(models.get)
seeds = st.integers(0, 2**32 - 1)


def terminal_states(steps, u):
    return np.einsum("nkm,qkm->qn", reachability_matrix(steps), u)


def displacements(steps, rng, count, U):
    """Draw half of them by random controls, the others anywhere nearby; some are unreachable."""
    d = steps.axes
    is_zero = rng.random((count, len(steps), d)) < rng.random((count, 1, 1))
    b = terminal_states(steps, np.where(is_zero, 0, rng.uniform(-U, U, (count, len(steps), d))))
    b[::2] *= rng.uniform(0, 8, (len(b[::2]), 2 * d))
    return b


def fuel_by_conic_solver(steps, b, U, weight, solver=solve_highs):
    """Solve the linear program in u⁺ and u⁻; infinite where it is infeasible."""
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
def test_solutions_arrive_within_limits_at_the_fuel_of_their_controls(rng, steps):
    U, weight = 0.02, tie_break_weights(len(steps), 1e-3)
    b = displacements(steps, rng, 400, U)
    b[0] = 0
    result = solve_minimum_fuel(steps, b, U, weight)
    found = np.isfinite(result.fuel)
    assert 100 < found.sum() < 400 and result.fuel[0] < 1e-11
    u = result.u[found]
    assert np.abs(u).max() <= U
    size = np.abs(reachability_matrix(steps)).max(axis=(1, 2)) * U
    assert_allclose(terminal_states(steps, u) / size, b[found] / size, atol=1e-8)
    assert_allclose(result.fuel[found], steps.dt * np.abs(u).sum(axis=(1, 2)))
    assert np.isnan(result.u[~found]).all() and np.isposinf(result.fuel[~found]).all()


@pytest.mark.parametrize("count", [3, 5, 11])
def test_each_step_has_a_weight(count):
    steps = discretize_zoh(DoubleIntegrator(2), 1.0, 10)
    with pytest.raises(ValueError, match="weight: must have an entry for each of 10 steps"):
        solve_minimum_fuel(steps, np.ones((2, 4)), 0.1, np.ones(count))


def test_dynamics_of_each_program_give_the_same_as_program_by_program(rng):
    own = [discretize_zoh(ClohessyWiltshire(n), 60.0, 12) for n in (1.0e-3, 1.1e-3, 1.2e-3)]
    steps = DiscreteModel(*(np.stack([getattr(one, k) for one in own]) for k in "ABz"), 60.0)
    b, weight = terminal_states(orbit[:12], rng.uniform(-0.01, 0.01, (3, 12, 3))), np.ones(12)
    b[1] *= 1e3  # out of reach
    together = solve_minimum_fuel(steps, b, 0.02, weight)
    alone = [solve_minimum_fuel(one, b[[q]], 0.02, weight) for q, one in enumerate(own)]
    assert np.isinf(together.fuel).tolist() == [False, True, False]
    assert_allclose(together.fuel, [one.fuel[0] for one in alone])
    assert_allclose(together.u, [one.u[0] for one in alone], atol=1e-12)


@settings(deadline=None, max_examples=25)
@given(seeds, any_model)
def test_fuel_is_even_homogeneous_convex_and_falls_with_the_limit(seed, steps):
    rng, U, w = np.random.default_rng(seed), 0.05, np.ones(len(steps))
    a, b = displacements(steps, rng, 16, U).reshape(2, 8, -1)
    both, tiny = [solve_minimum_fuel(steps, c, U, w).fuel for c in (a, b)], 1e-9 * U * steps.dt
    for scale in (-1.0, 1e-9, 1e6):
        size = abs(scale)
        scaled = solve_minimum_fuel(steps, scale * a, size * U, w).fuel
        assert_allclose(scaled, size * both[0], rtol=1e-9, atol=size * tiny)
    middle = solve_minimum_fuel(steps, (a + b) / 2, U, w).fuel
    assert (middle <= np.mean(both, axis=0) + tiny).all()
    assert (solve_minimum_fuel(steps, a, 2 * U, w).fuel <= both[0] + tiny).all()


@settings(deadline=None, max_examples=25)
@given(seeds, st.integers(1, 6), st.sampled_from([DoubleIntegrator(2), ClohessyWiltshire(1.1e-3)]))
def test_every_reachable_displacement_costs_no_more_than_its_control(seed, count, model):
    steps = discretize_zoh(model, 30.0, count)
    rng, U = np.random.default_rng(seed), 0.1
    u = rng.choice([-U, 0.0, 0.3 * U, U], size=(8, count, model.axes))  # also at the very limit
    result = solve_minimum_fuel(steps, terminal_states(steps, u), U, np.ones(count))
    assert (result.fuel <= steps.dt * np.abs(u).sum(axis=(1, 2)) * (1 + 1e-6) + 1e-9).all()


def test_many_displacements_are_solved_as_each_alone(rng):
    b = displacements(orbit, rng, 60, 0.01)
    together = solve_minimum_fuel(orbit, b, 0.01, tie_break_weights(24, 1e-6))
    for q in range(60):
        alone = solve_minimum_fuel(orbit, b[q : q + 1], 0.01, tie_break_weights(24, 1e-6))
        assert_allclose(alone.u[0], together.u[q], atol=1e-10)
        assert_allclose(alone.fuel[0], together.fuel[q], rtol=1e-12)


def test_other_batches_do_not_change_the_last_bit(rng):
    b = displacements(orbit, rng, 120, 0.1)
    before = solve_minimum_fuel(orbit, b, 0.1, np.ones(24), batches=6)
    b[:40] = displacements(orbit, rng, 40, 0.1)
    after = solve_minimum_fuel(orbit, b, 0.1, np.ones(24), batches=6)
    for one, other in zip(before, after, strict=True):
        assert_array_equal(one[40:], other[40:])


@pytest.mark.parametrize("count", [1, 2, 3, 24])
@pytest.mark.parametrize("solver", [solve_highs, solve_clarabel])
@pytest.mark.parametrize(
    "model", [DoubleIntegrator(2), ClohessyWiltshire(1.1e-3)], ids=["2-D", "CW"]
)
def test_highs_and_clarabel_find_the_same_fuel(rng, model, count, solver):
    steps = discretize_zoh(model, 60.0, count)
    U, weight = 0.01, tie_break_weights(count, 0.1)
    b = displacements(steps, rng, 24, U)
    u = solve_minimum_fuel(steps, b, U, weight).u
    weighted = steps.dt * np.einsum("k,qkm->q", weight, np.abs(u))
    weighted[np.isnan(weighted)] = np.inf
    other = np.array([fuel_by_conic_solver(steps, row, U, weight, solver) for row in b])
    assert np.isfinite(other).any() and np.isinf(other).any()
    assert_allclose(weighted, other, rtol=1e-6, atol=1e-7)


def test_highs_finds_the_same_fuel_for_time_varying_dynamics(rng):
    shapes = (8, 4, 4), (8, 4, 2)
    A, B = np.eye(4) + rng.normal(size=shapes[0]) / 5, rng.normal(size=shapes[1])
    steps, w = DiscreteModel(A, B, np.zeros((8, 4)), 0.5), np.ones(8)
    assert len(decouple_axes(steps)) == 1
    b = displacements(steps, rng, 20, 0.2)
    expected = [fuel_by_conic_solver(steps, row, 0.2, w) for row in b]
    assert_allclose(solve_minimum_fuel(steps, b, 0.2, w).fuel, expected, rtol=1e-6)


def test_axes_that_do_not_act_on_one_another_are_separated():
    def groups(steps):
        return [(s.tolist(), i.tolist()) for s, i in decouple_axes(steps)]

    assert groups(plane) == [([0, 2], [0]), ([1, 3], [1])]
    assert groups(orbit) == [([0, 1, 3, 4], [0, 1]), ([2, 5], [2])]


def test_displacements_of_an_uncontrolled_state_are_unreachable():
    A, B = np.tile(np.eye(4), (5, 1, 1)), np.zeros((5, 4, 2))
    A[:, 0, 2] = B[:, 2, 0] = 1.0  # the second axis has no thruster
    steps = DiscreteModel(A, B, np.zeros((5, 4)), 1.0)
    b = np.array([[1.0, 0, 0.2, 0], [1.0, 0.1, 0.2, 0]])
    result = solve_minimum_fuel(steps, b, 0.5, np.ones(5))
    assert result.fuel[0] > 0 and result.fuel[1] == np.inf
    assert_allclose(terminal_states(steps, result.u[:1]), b[:1], atol=1e-12)


def test_redundant_thrusters_share_the_cheapest_control():
    # Rank 2 for 4 states, and 5 × 2 controls.
    A, B = np.tile(np.eye(4), (5, 1, 1)), np.zeros((5, 4, 2))
    A[:, 0, 2] = 1.0
    B[:, 2], B[:, 3, 1] = [1.0, 2.0], 0.0
    B[:, 1] = B[:, 2]
    steps = DiscreteModel(A, B, np.zeros((5, 4)), 1.0)
    u = np.zeros((1, 5, 2))
    u[0, :2, 1] = 0.4, -0.1
    b = terminal_states(steps, u)
    result = solve_minimum_fuel(steps, b, 0.5, np.ones(5))
    assert_allclose(terminal_states(steps, result.u), b, atol=1e-12)
    assert result.fuel[0] <= 0.5 + 1e-12
    assert solve_minimum_fuel(steps, b + np.eye(4)[1] / 10, 0.5, np.ones(5)).fuel[0] == np.inf


def test_extreme_displacements_are_solved():
    b = np.array([[1e12, 0, 0, 0], [0, 0, 1e9, 0], [1e-300, 0, 0, 0], [0, 0, 0, 1e-20]])
    fuel = solve_minimum_fuel(plane, b, 0.1, np.ones(20)).fuel
    assert np.isinf(fuel[:2]).all()
    assert (fuel[2:] < 1e-10).all()


@pytest.mark.parametrize("wrong", ["controls", "duals", "certificate", "pivots"])
def test_highs_solves_what_is_not_solved_or_wrongly_solved(rng, monkeypatch, wrong):
    b, weight = displacements(orbit, rng, 20, 0.1), tie_break_weights(24, 1e-2)
    right, original = solve_minimum_fuel(orbit, b, 0.1, weight), minimum_fuel.solve_batches

    def solve_wrongly(Q, basis, w, b, starts, pivots, x, λ, status):
        original(Q, basis, w, b, starts, pivots, x, λ, status)
        if wrong == "controls":
            x *= 1 - 1e-7
        elif wrong == "duals":
            λ *= 0.9
        elif wrong == "certificate":
            status[:], λ[:] = INFEASIBLE, 0.1 * b

    monkeypatch.setattr(minimum_fuel, "solve_batches", solve_wrongly)
    monkeypatch.setattr(minimum_fuel, "MAX_PIVOTS", 0 if wrong == "pivots" else 1000)
    result = solve_minimum_fuel(orbit, b, 0.1, weight)
    assert_allclose(result.fuel, right.fuel, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    ("message", "changes"),
    [
        ("at least one step", {"steps": plane[:0], "weight": np.ones(0)}),
        ("max_control: must be a finite number above 0", {"max_control": 0.0}),
        ("max_control: must be a finite number", {"max_control": np.inf}),
        (
            r"displacement: .* with nan at \[1, 0\]",
            {"displacement": np.array([[0.0] * 4, [np.nan] * 4])},
        ),
        ("weight: must be an array of finite numbers above 0", {"weight": np.zeros(20)}),
    ],
)
def test_invalid_arguments_are_refused(message, changes):
    good = {"steps": plane, "displacement": np.zeros((2, 4)), "max_control": 0.1}
    with pytest.raises(ValueError, match=message):
        solve_minimum_fuel(**(good | {"weight": np.ones(20)} | changes))


def test_no_displacements_give_empty_results():
    result = solve_minimum_fuel(plane, np.zeros((0, 4)), 0.1, np.ones(20))
    assert result.u.shape == (0, 20, 2)
    assert result.fuel.shape == (0,)
