"""Transfers of least energy: the condensed program, its closed form, avoidance and pairs."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from problems.auction_cost import compute_energies, compute_transfer_costs, solve_transfer
from problems.avoidance import AvoidanceProblem
from problems.conic import Infeasible
from problems.half_spaces import HalfSpaces
from problems.minimum_fuel import solve_minimum_fuel
from problems.transfer import TransferProblem, compute_energy

MODELS = [
    (discretize_zoh(DoubleIntegrator(2), 1.0, 20), 0.1),
    (discretize_zoh(DoubleIntegrator(3), 1.0, 15), 0.2),
    (discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 20), 1e-3),
]


def draw_problem(rng, model, U, half_spaces, **limits):
    """Draw a transfer near full control, past half-spaces that its optimum would violate."""
    T, d = len(model), model.axes
    transfer = TransferProblem(model, U, objective="energy", **limits)
    start = np.concatenate([rng.normal(0, 5, d), rng.normal(0, 0.1, d)])
    push = rng.choice([-1, 1], d) * U * rng.uniform(0.5, 0.95)
    u = np.where(np.arange(T)[:, None] < T / 2, push, -push) + rng.normal(0, U / 50, (T, d))
    flown = transfer.simulate(start, u)
    (free,), _, _ = transfer.solve_without_limits(start, flown.x[-1:])
    step, normal = rng.integers(1, T, half_spaces), rng.normal(size=(half_spaces, d))
    values = [(normal * x[step, :d]).sum(axis=1) for x in (free, flown.x)]
    normal *= np.sign(values[1] - values[0])[:, None]
    rhs = (normal * (free + flown.x)[step, :d] / 2).sum(axis=1)
    on_state = np.hstack([normal, 0 * normal])
    spaces = HalfSpaces(step, on_state, np.zeros((half_spaces, d)), rhs)
    return AvoidanceProblem(transfer, start, flown.x[-1], spaces)


@pytest.mark.parametrize("relaxation", ["none", "terminal", "separation"])
@pytest.mark.parametrize("count", [0, 4])
@pytest.mark.parametrize(("model", "U"), MODELS, ids=["plane", "space", "orbit"])
def test_energy_agrees_with_the_statement_in_cvxpy(rng, model, U, count, relaxation):
    for _ in range(3):
        problem = draw_problem(rng, model, U, count)
        free = problem.solve().trajectory
        V = 0.97 * np.linalg.norm(free.x[1:-1, model.axes :], axis=1).max()
        slower = replace(problem, transfer=replace(problem.transfer, max_speed=V))
        # A speed limit may leave no way to the goal.
        for each in (problem,) if relaxation == "none" else (problem, slower):
            found, stated = each.solve(relaxation), each.solve_cvxpy(relaxation)
            energies = [each.transfer.cost(result.trajectory) for result in (found, stated)]
            assert energies[0] == pytest.approx(energies[1], rel=1e-6)
            assert found.terminal_error == pytest.approx(stated.terminal_error, abs=1e-5)
            assert found.slack == pytest.approx(stated.slack, abs=1e-5)


def test_energy_without_active_limits_is_the_closed_form(rng):
    for model, U in MODELS:
        problem = draw_problem(rng, model, U, 0)
        problem = replace(problem, transfer=replace(problem.transfer, max_control=10 * U))
        found, ends = problem.solve().trajectory, (problem.start[None], problem.goal[None])
        energy = compute_energy(found.u, model.dt)
        assert energy == pytest.approx(compute_energies(model, *ends)[0, 0])
        assert_allclose(found.x[-1], problem.goal, atol=1e-9)
        cheapest = replace(problem.transfer, objective="fuel").solve(problem.start, problem.goal)
        assert energy <= compute_energy(cheapest.u, model.dt) and cheapest.fuel <= found.fuel


@pytest.mark.parametrize("control_norm", [1, 2])
def test_energy_under_other_norms_of_the_control(rng, control_norm):
    problem = draw_problem(rng, *MODELS[0], 3, control_norm=control_norm)
    transfer = replace(problem.transfer, max_control=0.2)
    found = replace(problem, transfer=transfer).solve().trajectory
    assert np.linalg.norm(found.u, control_norm, axis=1).max() <= 0.2 * (1 + 1e-7)
    box = replace(problem, transfer=replace(transfer, control_norm="inf")).solve().trajectory
    assert transfer.cost(found) >= transfer.cost(box) * (1 - 1e-7)


def test_costs_are_exact_or_lower_bounds_and_reach_is_that_of_fuel(rng):
    model, U = MODELS[0]
    start = np.hstack([rng.normal(0, 4, (6, 2)), rng.normal(0, 0.2, (6, 2))])
    targets = np.hstack([rng.normal(0, 8, (7, 2)), np.zeros((7, 2))])
    for V in (inf, 0.8):
        transfer = TransferProblem(model, U, V, objective="energy")
        found = compute_transfer_costs(transfer, start, targets)
        b = targets[None] - transfer.coast(start)[:, -1][:, None]
        fuel = solve_minimum_fuel(model, b.reshape(-1, 4), U, np.ones(len(model))).fuel
        assert (np.isfinite(fuel).reshape(found.cost.shape) == found.is_reachable).all()
        assert found.is_exact.any() and not found.is_exact.all()
        for i, j in np.argwhere(found.is_reachable):
            exact = solve_transfer(transfer, start[i], targets[j])
            energy = inf if exact is None else transfer.cost(exact)
            assert found.cost[i, j] <= energy * (1 + 1e-9)
            if found.is_exact[i, j]:
                assert found.cost[i, j] == pytest.approx(energy, rel=1e-9)
        assert found.cost[~found.is_reachable].min() > found.cost[found.is_reachable].max()


def test_goals_out_of_reach_are_infeasible():
    model, U = MODELS[0]
    transfer = TransferProblem(model, U, objective="energy")
    with pytest.raises(Infeasible):
        AvoidanceProblem.alone(transfer, np.zeros(4), np.array([30.0, 0, 0, 0])).solve()


@pytest.mark.parametrize("steps", [4, 10, 40])
def test_least_energy_from_rest_to_rest_is_the_squared_distance(rng, steps):
    goals = np.hstack([rng.normal(0, 5, (6, 2)), np.zeros((6, 2))])
    model = discretize_zoh(DoubleIntegrator(2), 0.5, steps)
    energy = compute_energies(model, np.zeros((1, 4)), goals)[0]
    squares = (goals**2).sum(axis=1) / (1 - 1 / steps**2)
    assert_allclose(energy * (0.5 * steps) ** 3 / 12, squares, rtol=1e-9)
