"""Transfer problem in all norms: laws, SCS and HiGHS."""

from copy import deepcopy
from itertools import product
from math import inf

import cvxpy as cp
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from dynamics import ClohessyWiltshire, DiscreteModel, DoubleIntegrator, discretize_zoh
from problems.conic import Infeasible, Unsolved
from problems.transfer import TransferProblem, solve_cvxpy, tie_break_weights

plane = discretize_zoh(DoubleIntegrator(2), 1.0, 12)
space = discretize_zoh(DoubleIntegrator(3), 1.0, 10)
orbit = discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 10)
half_period = discretize_zoh(ClohessyWiltshire(1.0), 0.25, 12)  # of a unit orbit
norms = list(product((1, 2, "inf"), repeat=2))


def size(v, norm):
    return np.linalg.norm(v, np.inf if norm == "inf" else norm, axis=-1)


def reachable(steps, rng, U, V=0.3):
    """Draw a start, and a target that controls of half the limit reach."""
    d = steps.axes
    start = np.concatenate([rng.normal(0, 2, d), rng.normal(0, V / 3, d)])
    return start, steps.simulate(start, rng.uniform(-U / 2, U / 2, (len(steps), d)))[-1]


@pytest.mark.parametrize(("q", "r"), norms)
def test_coasting_costs_no_fuel(rng, q, r):
    start = rng.normal(size=4)
    target = plane.simulate(start, np.zeros((12, 2)))[-1]
    found = TransferProblem(plane, 0.3, fuel_norm=q, control_norm=r).solve(start, target)
    assert 0 <= found.fuel < 1e-7


@pytest.mark.parametrize("steps", [plane, space, orbit], ids=["plane", "space", "orbit"])
@pytest.mark.parametrize(("q", "r"), norms)
def test_solutions_keep_every_constraint(rng, steps, q, r):
    U, V, d = (0.4, 1.2, steps.axes) if steps is not orbit else (0.01, 3.0, 3)
    transfer = TransferProblem(steps, U, V, q, r)
    start, target = reachable(steps, rng, U / 3)
    x, u, fuel = transfer.solve(start, target)
    assert_array_equal(x[0], start)
    assert_allclose(x[-1], target, atol=1e-5 if steps is orbit else 1e-7)
    for k in range(len(steps)):
        expected = steps.A[k] @ x[k] + steps.B[k] @ u[k] + steps.z[k]
        assert_allclose(x[k + 1], expected, atol=1e-9)
    assert size(u, r).max() <= U * (1 + 1e-7)
    assert size(x[1:-1, d:], 2).max() <= V * (1 + 1e-6)
    assert fuel == pytest.approx(steps.dt * size(u, q).sum(), rel=1e-12)


@pytest.mark.parametrize(("q", "r"), norms)
def test_scs_finds_the_same_fuel_without_states(q, r):
    """Check the program too: here the states are eliminated."""
    start = np.array([0.3, 0.8, 0.3, -0.4, 0.3, 0.1])
    target = np.array([-0.5, 0.6, 0.4, 0.1, 0, 0.2])
    U = 2.0
    free = TransferProblem(half_period, U, fuel_norm=q, control_norm=r).solve(start, target)
    V = 0.95 * size(free.x[1:-1, 3:], 2).max()
    found = TransferProblem(half_period, U, V, q, r).solve(start, target)
    coasting = half_period.simulate(start, np.zeros((12, 3)))
    units = np.eye(36).reshape(36, 12, 3)
    response = half_period.simulate(np.tile(start, (36, 1)), units) - coasting
    u = cp.Variable(36)
    x = [coasting[k] + response[:, k].T @ u for k in range(13)]
    limits = [x[12] == target]
    limits += [cp.norm(u[3 * k : 3 * k + 3], cvxpy_norm(r)) <= U for k in range(12)]
    limits += [cp.norm(x[k][3:]) <= V for k in range(1, 12)]
    cost = half_period.dt * cp.sum(
        [cp.norm(u[3 * k : 3 * k + 3], cvxpy_norm(q)) for k in range(12)]
    )
    problem = cp.Problem(cp.Minimize(cost), limits)
    problem.solve(solver=cp.SCS, eps_abs=1e-9, eps_rel=1e-9, max_iters=200_000)
    assert found.fuel == pytest.approx(problem.value, rel=1e-6)
    assert found.fuel > free.fuel * (1 + 1e-5)  # the limit does bind


def cvxpy_norm(norm):
    return np.inf if norm == "inf" else norm


def test_fuel_falls_with_looser_limits_and_smaller_norms(rng):
    start, target = np.array([0, 0, 0.1, -0.2]), np.array([2.5, 1.0, 0.2, 0.1])
    for loose, tight in (((0.2, inf), (0.1, inf)), ((0.1, inf), (0.1, 0.45))):
        for q, r in norms:
            fuel = [
                TransferProblem(plane, *limits, q, r).solve(start, target).fuel
                for limits in (loose, tight)
            ]
            assert fuel[0] <= fuel[1] + 1e-7
    of = {
        (q, r): TransferProblem(plane, 0.1, 0.45, q, r).solve(start, target).fuel for q, r in norms
    }
    for r in (1, 2, "inf"):  # ‖u‖₁ ≥ ‖u‖₂ ≥ ‖u‖_∞
        assert of[1, r] >= of[2, r] - 1e-7 >= of["inf", r] - 2e-7
    for q in (1, 2, "inf"):
        assert of[q, 1] >= of[q, 2] - 1e-7 >= of[q, "inf"] - 2e-7


@pytest.mark.parametrize("scale", [1e-3, 10.0])
def test_fuel_scales_with_lengths(rng, scale):
    start, target = reachable(plane, rng, 0.2)
    fuel = TransferProblem(plane, 0.2, 1.0).solve(start, target).fuel
    scaled = TransferProblem(plane, 0.2 * scale, scale).solve(scale * start, scale * target).fuel
    assert scaled == pytest.approx(scale * fuel, rel=1e-5)


def test_weights_are_one_at_the_ends_and_largest_in_the_middle():
    w = tie_break_weights(9, 0.01)
    assert w[0] == w[-1] == 1
    assert w[4] == w.max() == 1.01
    assert_allclose(w, w[::-1])
    assert (np.diff(w, 2) < 0).all()  # concave, so that controls at the ends are cheaper
    assert_array_equal(tie_break_weights(5, 0.0), np.ones(5))
    assert tie_break_weights(1, 0.1) == pytest.approx(1.1)
    assert len(tie_break_weights(0, 0.1)) == 0


def test_rising_weights_make_the_path_straight_at_no_fuel():
    start, target = np.zeros(4), np.array([2.0, 1.0, 0, 0])
    plain = TransferProblem(plane, 1.0).solve(start, target)
    x, u, fuel = TransferProblem(plane, 1.0, tie_break_rise=1e-3).solve(start, target)
    assert fuel == pytest.approx(plain.fuel, rel=1e-6)
    assert_allclose(u[1:-1], 0, atol=1e-6)
    assert_allclose(x[:, 1], x[:, 0] / 2, atol=1e-6)


@pytest.mark.parametrize(("q", "r"), norms)
def test_too_far_a_target_is_infeasible_with_a_certificate(q, r):
    transfer = TransferProblem(plane, 0.01, fuel_norm=q, control_norm=r)
    with pytest.raises(Infeasible, match="TransferProblem is infeasible") as verdict:
        transfer.solve(np.zeros(4), np.array([5.0, 0, 0, 0]))
    assert verdict.value.problem is transfer
    assert verdict.value.ray is not None


def test_speeds_at_both_ends_need_not_keep_the_limit():
    start, target = np.array([0, 0, 2.0, 0]), np.array([6.0, 0, 2.0, 0])
    found = TransferProblem(plane, 2.0, 1.0).solve(start, target)
    assert np.abs(found.x[1:-1, 2]).max() <= 1 + 1e-6


def test_a_single_step_reaches_what_its_control_reaches(rng):
    one = plane[:1]
    start, u = rng.normal(size=4), np.array([0.1, -0.2])
    target = one.simulate(start, u[None])[-1]
    assert_allclose(TransferProblem(one, 0.3, 0.1).solve(start, target).u, [u], atol=1e-8)
    with pytest.raises(Infeasible):
        TransferProblem(one, 0.3).solve(start, target + 0.1)


def test_a_transfer_without_steps_is_refused():
    transfer = TransferProblem(discretize_zoh(DoubleIntegrator(2), 1.0, 0), 0.3)
    with pytest.raises(ValueError, match="at least one step"):
        transfer.solve(np.zeros(4), np.zeros(4))


@pytest.mark.parametrize(
    ("U", "V"), [(0.0, 1.0), (-0.3, 1.0), (np.nan, 1.0), (inf, 1.0), (0.3, 0.0), (0.3, np.nan)]
)
def test_limits_that_are_not_positive_are_refused(U, V):
    with pytest.raises(
        ValueError, match=f"max_control = {U} and max_speed = {V}|^max_(control|speed): must be"
    ):
        TransferProblem(plane, U, V)


def test_a_start_that_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="finite|real"):  # noqa: RUF043
        TransferProblem(plane, 0.3).solve(np.full(4, np.nan), np.zeros(4))


def test_cvxpy_solutions_are_verified_too():
    x = cp.Variable(2)
    with pytest.raises(Unsolved, match="str is not solved"):
        solve_cvxpy("unbounded", cp.Problem(cp.Minimize(cp.sum(x)), [x <= 1]))


def test_time_varying_dynamics_and_drift_are_solved(rng):
    shapes = (6, 4, 4), (6, 4, 2), (6, 4)
    A, B, z = (rng.normal(size=shape) / 3 for shape in shapes)
    steps = DiscreteModel(A, B, z, 0.5)
    start, u = rng.normal(size=4), rng.uniform(-0.2, 0.2, (6, 2))
    found = TransferProblem(steps, 0.3, fuel_norm=2, control_norm=2).solve(
        start, steps.simulate(start, u)[-1]
    )
    assert_allclose(found.x[-1], steps.simulate(start, u)[-1], atol=1e-7)
    assert found.fuel <= 0.5 * size(u, 2).sum() + 1e-7


def test_copies_of_a_solved_problem_solve_it_again():
    problem = TransferProblem(plane, 0.5, 1.0)
    ends = np.zeros(4), np.array([1.0, 1.0, 0.0, 0.0])
    fuel = problem.solve(*ends).fuel
    assert deepcopy(problem).solve(*ends).fuel == pytest.approx(fuel, abs=1e-9)
