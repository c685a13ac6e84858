"""Problem 6, as it is stated, for all norms."""

from itertools import product
from math import inf

import cvxpy as cp
import numpy as np
import pytest

from dynamics import ClohessyWiltshire, DiscreteModel, DoubleIntegrator, discretize_zoh
from problems.conic import Infeasible, Unsolved
from problems.transfer import TransferProblem, compute_fuel, solve_cvxpy, tie_break_weights

plane = discretize_zoh(DoubleIntegrator(2), 1.0, 12)
space = discretize_zoh(DoubleIntegrator(3), 1.0, 10)
orbit = discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 10)
turning = discretize_zoh(ClohessyWiltshire(1.0), 0.25, 12)  # half a period, in units of the orbit
norms = list(product((1, 2, "inf"), repeat=2))


def size(v, norm):
    return np.linalg.norm(v, np.inf if norm == "inf" else norm, axis=-1)


def reachable(steps, rng, U, V=0.3):
    """A start, and a goal that some flight within half the limit reaches."""
    d = steps.axes
    start = np.concatenate([rng.normal(0, 2, d), rng.normal(0, V / 3, d)])
    return start, steps.simulate(start, rng.uniform(-U / 2, U / 2, (len(steps), d)))[-1]


@pytest.mark.parametrize(("q", "r"), norms)
def test_coasting_is_free(rng, q, r):
    start = rng.normal(size=4)
    goal = plane.simulate(start, np.zeros((12, 2)))[-1]
    flight = TransferProblem(plane, 0.3, fuel_norm=q, control_norm=r).solve(start, goal)
    assert 0 <= flight.fuel < 1e-7


@pytest.mark.parametrize("steps", [plane, space, orbit], ids=["plane", "space", "orbit"])
@pytest.mark.parametrize(("q", "r"), norms)
def test_a_flight_keeps_every_constraint(rng, steps, q, r):
    U, V, d = (0.4, 1.2, steps.axes) if steps is not orbit else (0.01, 3.0, 3)
    transfer = TransferProblem(steps, U, V, q, r)
    start, goal = reachable(steps, rng, U / 3)
    x, u, fuel = transfer.solve(start, goal)
    np.testing.assert_array_equal(x[0], start)
    np.testing.assert_allclose(x[-1], goal, atol=1e-5 if steps is orbit else 1e-7)
    for k in range(len(steps)):
        moved = steps.A[k] @ x[k] + steps.B[k] @ u[k] + steps.z[k]
        np.testing.assert_allclose(x[k + 1], moved, atol=1e-9)
    assert size(u, r).max() <= U * (1 + 1e-7)
    assert size(x[1:-1, d:], 2).max() <= V * (1 + 1e-6)
    assert fuel == pytest.approx(steps.dt * size(u, q).sum(), rel=1e-12)


@pytest.mark.parametrize(("q", "r"), norms)
def test_another_solver_finds_no_cheaper_flight(q, r):
    """A second opinion on the programme as well: written with the states eliminated."""
    start, goal, U = (
        np.array([0.3, 0.8, 0.3, -0.4, 0.3, 0.1]),
        np.array([-0.5, 0.6, 0.4, 0.1, 0, 0.2]),
        2.0,
    )
    free = TransferProblem(turning, U, fuel_norm=q, control_norm=r).solve(start, goal)
    V = 0.95 * size(free.x[1:-1, 3:], 2).max()
    flight = TransferProblem(turning, U, V, q, r).solve(start, goal)
    coasting = turning.simulate(start, np.zeros((12, 3)))
    pushes = np.eye(36).reshape(36, 12, 3)
    pushed = turning.simulate(np.tile(start, (36, 1)), pushes) - coasting
    u = cp.Variable(36)
    x = [coasting[k] + pushed[:, k].T @ u for k in range(13)]
    limits = [x[12] == goal]
    limits += [cp.norm(u[3 * k : 3 * k + 3], q_of(r)) <= U for k in range(12)]
    limits += [cp.norm(x[k][3:]) <= V for k in range(1, 12)]
    cost = turning.dt * cp.sum([cp.norm(u[3 * k : 3 * k + 3], q_of(q)) for k in range(12)])
    problem = cp.Problem(cp.Minimize(cost), limits)
    problem.solve(solver=cp.SCS, eps_abs=1e-9, eps_rel=1e-9, max_iters=200_000)
    assert flight.fuel == pytest.approx(problem.value, rel=1e-6)
    assert flight.fuel > free.fuel * (1 + 1e-5)  # the limit does bind


def q_of(norm):
    return np.inf if norm == "inf" else norm


@pytest.mark.parametrize(("q", "r"), [(1, "inf"), (1, 1), ("inf", 1), ("inf", "inf")])
def test_highs_agrees_where_the_programme_is_linear(rng, q, r):
    for _ in range(3):
        transfer = TransferProblem(plane, 0.1, fuel_norm=q, control_norm=r)
        start, goal = reachable(plane, rng, 0.1)
        x, _, effort, limits = transfer.build_cvxpy(start)
        problem = cp.Problem(cp.Minimize(effort), [*limits, x[12] == goal])
        problem.solve(solver=cp.HIGHS)
        assert transfer.solve(start, goal).fuel == pytest.approx(problem.value, rel=1e-7, abs=1e-8)


def test_fuel_does_not_rise_with_looser_limits_or_norms(rng):
    start, goal = np.array([0, 0, 0.1, -0.2]), np.array([2.5, 1.0, 0.2, 0.1])
    for loose, tight in (((0.2, inf), (0.1, inf)), ((0.1, inf), (0.1, 0.45))):
        for q, r in norms:
            fuel = [
                TransferProblem(plane, *limits, q, r).solve(start, goal).fuel
                for limits in (loose, tight)
            ]
            assert fuel[0] <= fuel[1] + 1e-7
    of = {(q, r): TransferProblem(plane, 0.1, 0.45, q, r).solve(start, goal).fuel for q, r in norms}
    for r in (1, 2, "inf"):  # ‖u‖₁ ≥ ‖u‖₂ ≥ ‖u‖_∞
        assert of[1, r] >= of[2, r] - 1e-7 >= of["inf", r] - 2e-7
    for q in (1, 2, "inf"):
        assert of[q, 1] >= of[q, 2] - 1e-7 >= of[q, "inf"] - 2e-7


@pytest.mark.parametrize("scale", [1e-3, 10.0])
def test_fuel_scales_with_lengths(rng, scale):
    start, goal = reachable(plane, rng, 0.2)
    fuel = TransferProblem(plane, 0.2, 1.0).solve(start, goal).fuel
    scaled = TransferProblem(plane, 0.2 * scale, scale).solve(scale * start, scale * goal).fuel
    assert scaled == pytest.approx(scale * fuel, rel=1e-5)


def test_weights_are_one_at_the_ends_and_most_in_the_middle():
    w = tie_break_weights(9, 0.01)
    assert w[0] == w[-1] == 1
    assert w[4] == w.max() == 1.01
    np.testing.assert_allclose(w, w[::-1])
    assert (np.diff(w, 2) < 0).all()  # concave, so that two burns beat the one between them
    np.testing.assert_array_equal(tie_break_weights(5, 0.0), np.ones(5))
    assert tie_break_weights(1, 0.1) == pytest.approx(1.1)
    assert len(tie_break_weights(0, 0.1)) == 0


def test_a_slope_makes_the_optimum_straight_at_no_fuel():
    start, goal = np.zeros(4), np.array([2.0, 1.0, 0, 0])
    plain = TransferProblem(plane, 1.0).solve(start, goal)
    x, u, fuel = TransferProblem(plane, 1.0, tie_break_rise=1e-3).solve(start, goal)
    assert fuel == pytest.approx(plain.fuel, rel=1e-6)
    np.testing.assert_allclose(u[1:-1], 0, atol=1e-6)
    np.testing.assert_allclose(x[:, 1], x[:, 0] / 2, atol=1e-6)


def test_fuel_spent_is_for_one_flight_or_many(rng):
    u = rng.normal(size=(3, 5, 2))
    assert compute_fuel(u[0], 2.0, 1) == pytest.approx(2 * np.abs(u[0]).sum())
    np.testing.assert_allclose(compute_fuel(u, 2.0, "inf"), 2 * np.abs(u).max(axis=2).sum(axis=1))


@pytest.mark.parametrize(("q", "r"), norms)
def test_too_far_is_infeasible_and_comes_with_its_proof(q, r):
    transfer = TransferProblem(plane, 0.01, fuel_norm=q, control_norm=r)
    with pytest.raises(Infeasible, match="TransferProblem is infeasible") as verdict:
        transfer.solve(np.zeros(4), np.array([5.0, 0, 0, 0]))
    assert verdict.value.problem is transfer
    assert verdict.value.ray is not None


def test_too_fast_is_infeasible():
    goal = np.array([5.0, 0, 0, 0])  # 12 steps at 0.4 come to less
    assert TransferProblem(plane, 1.0).solve(np.zeros(4), goal).fuel > 0
    with pytest.raises(Infeasible):
        TransferProblem(plane, 1.0, 0.4).solve(np.zeros(4), goal)


def test_the_speeds_at_both_ends_are_data():
    start, goal = np.array([0, 0, 2.0, 0]), np.array([6.0, 0, 2.0, 0])
    flight = TransferProblem(plane, 2.0, 1.0).solve(start, goal)
    assert np.abs(flight.x[1:-1, 2]).max() <= 1 + 1e-6


def test_a_single_step_reaches_what_it_can(rng):
    one = plane[:1]
    start, u = rng.normal(size=4), np.array([0.1, -0.2])
    goal = one.simulate(start, u[None])[-1]
    np.testing.assert_allclose(TransferProblem(one, 0.3, 0.1).solve(start, goal).u, [u], atol=1e-8)
    with pytest.raises(Infeasible):
        TransferProblem(one, 0.3).solve(start, goal + 0.1)


def test_a_transfer_without_steps_is_refused():
    transfer = TransferProblem(discretize_zoh(DoubleIntegrator(2), 1.0, 0), 0.3)
    with pytest.raises(ValueError, match="at least one step"):
        transfer.solve(np.zeros(4), np.zeros(4))


@pytest.mark.parametrize(
    ("U", "V"), [(0.0, 1.0), (-0.3, 1.0), (np.nan, 1.0), (inf, 1.0), (0.3, 0.0), (0.3, np.nan)]
)
def test_limits_must_leave_something(U, V):
    with pytest.raises(ValueError, match=f"max_control = {U} and max_speed = {V}"):
        TransferProblem(plane, U, V)


def test_a_start_that_is_no_number_is_refused():
    with pytest.raises(ValueError, match="finite|real"):  # noqa: RUF043
        TransferProblem(plane, 0.3).solve(np.full(4, np.nan), np.zeros(4))


def test_a_statement_is_not_believed_either():
    x = cp.Variable(2)
    with pytest.raises(Unsolved, match="str is not solved"):
        solve_cvxpy("unbounded", cp.Problem(cp.Minimize(cp.sum(x)), [x <= 1]))


def test_time_varying_steps_and_drift_are_flown(rng):
    shapes = (6, 4, 4), (6, 4, 2), (6, 4)
    A, B, z = (rng.normal(size=shape) / 3 for shape in shapes)
    steps = DiscreteModel(A, B, z, 0.5)
    start, u = rng.normal(size=4), rng.uniform(-0.2, 0.2, (6, 2))
    flight = TransferProblem(steps, 0.3, fuel_norm=2, control_norm=2).solve(
        start, steps.simulate(start, u)[-1]
    )
    np.testing.assert_allclose(flight.x[-1], steps.simulate(start, u)[-1], atol=1e-7)
    assert flight.fuel <= 0.5 * size(u, 2).sum() + 1e-7
