"""Avoidance problems: the condensed program against CVXPY, and relaxations."""

from math import inf

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from problems.avoidance import AvoidanceProblem, HalfSpaces, empty_half_spaces
from problems.conic import Infeasible
from problems.transfer import TransferProblem

plane = discretize_zoh(DoubleIntegrator(2), 1.0, 12)
space = discretize_zoh(DoubleIntegrator(3), 1.0, 12)
orbit = discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 10)
start, goal = np.array([0.0, 0, 0, 0]), np.array([3.0, 0.5, 0, 0])


def wall(steps, directions, least):
    """At each step n · (position + h/3 velocity) ≥ least, as for a control point of the path."""
    T, d = len(steps), steps.axes
    on_state = np.concatenate([directions, directions * steps.dt / 3], axis=1)
    least = np.broadcast_to(least, T).astype(float)
    return HalfSpaces(np.arange(T), on_state, 0.1 * directions[:, :d], least)


def detour(steps=plane, least=0.4, first=3, last=9):
    """Stay to one side in the middle of the flight, where the cheapest path is not."""
    direction = np.zeros((len(steps), steps.axes))
    direction[:, 1] = 1.0
    spaces = wall(steps, direction, least)
    inside = (spaces.step_index >= first) & (spaces.step_index < last)
    return HalfSpaces(*(part[inside] for part in spaces))


def ends(steps):
    x, g = np.zeros(2 * steps.axes), np.zeros(2 * steps.axes)
    g[:2] = 3.0, 0.5
    return x, g


def test_without_half_spaces_the_solution_is_the_plain_transfer(rng):
    for steps, U in ((plane, 0.2), (space, 0.2), (orbit, 0.01)):
        for V in (inf, 0.45 if steps is not orbit else 3.0):
            transfer = TransferProblem(steps, U, V)
            d = steps.axes
            x0 = np.concatenate([rng.normal(0, 1, d), rng.normal(0, 0.1, d)])
            xf = steps.simulate(x0, rng.uniform(-U / 4, U / 4, (len(steps), d)))[-1]
            stated = transfer.solve(x0, xf)
            passage = AvoidanceProblem(transfer).solve(x0, xf, empty_half_spaces(transfer))
            assert passage.trajectory.fuel == pytest.approx(stated.fuel, rel=1e-6)
            assert_allclose(passage.trajectory.x[-1], xf, atol=1e-6)
            assert passage.terminal_error == passage.slack == 0


@pytest.mark.parametrize("V", [inf, 0.305])
@pytest.mark.parametrize("gives", ["none", "terminal", "separation"])
@pytest.mark.parametrize("steps", [plane, space], ids=["2-D", "3-D"])
def test_the_condensed_program_agrees_with_cvxpy(steps, gives, V):
    spaces, (x0, xf) = detour(steps), ends(steps)
    avoid = AvoidanceProblem(TransferProblem(steps, 0.25, V, tie_break_rise=1e-2))
    fast, stated = (solve(x0, xf, spaces, gives) for solve in (avoid.solve, avoid.solve_cvxpy))
    w = avoid.transfer.weights
    priced = [w @ np.abs(p.trajectory.u).sum(axis=1) for p in (fast, stated)]
    assert priced[0] == pytest.approx(priced[1], rel=1e-6)
    assert_allclose(fast.trajectory.x, stated.trajectory.x, atol=1e-4)  # the optimum is unique
    if V < inf:
        assert np.linalg.norm(stated.trajectory.x[1:-1, steps.axes :], axis=1).max() > 0.999 * V
    for passage in (fast, stated):
        x, u, _ = passage.trajectory
        assert spaces.violation(x, u).max() < 1e-7
        assert_allclose(x[-1], xf, atol=1e-7)
        assert np.abs(u).max() <= 0.25 * (1 + 1e-7)
        assert np.linalg.norm(x[1:-1, steps.axes :], axis=1).max() <= V * (1 + 1e-6)
        assert max(passage.terminal_error, passage.slack) < 1e-7


@pytest.mark.parametrize("V", [inf, 0.3])
def test_relaxations_agree_with_cvxpy(V):
    """The goal is out of reach, or the half-spaces are, by much."""
    far = np.array([9.0, 0, 0, 0])
    avoid = AvoidanceProblem(TransferProblem(plane, 0.1, V, tie_break_rise=1e-2))
    for target, spaces in ((far, empty_half_spaces(avoid.transfer)), (far, detour())):
        passages = [
            solve(start, target, spaces, "terminal") for solve in (avoid.solve, avoid.solve_cvxpy)
        ]
        assert passages[0].terminal_error == pytest.approx(passages[1].terminal_error, rel=1e-5)
        assert passages[0].terminal_error > 1
        assert spaces.violation(*passages[0].trajectory[:2]).max(initial=0) < 1e-7
    passages = [
        solve(start, goal, detour(least=4.0), "separation")
        for solve in (avoid.solve, avoid.solve_cvxpy)
    ]
    assert passages[0].slack == pytest.approx(passages[1].slack, rel=1e-4)
    assert passages[0].slack > 0.5


def test_a_relaxation_changes_nothing_where_the_problem_is_feasible():
    avoid = AvoidanceProblem(TransferProblem(plane, 0.25))
    strict = avoid.solve(start, goal, detour()).trajectory.fuel
    for gives in ("terminal", "separation"):
        passage = avoid.solve(start, goal, detour(), gives)
        assert passage.trajectory.fuel == pytest.approx(strict, rel=1e-6)
        assert max(passage.terminal_error, passage.slack) < 1e-8


def test_the_terminal_state_is_relaxed_before_the_separation():
    # Half-spaces until the last step make the goal on the other side unreachable.
    spaces = detour(last=12)
    avoid = AvoidanceProblem(TransferProblem(plane, 0.1))
    with pytest.raises(Infeasible):
        avoid.solve(start, -goal, spaces)
    passage = avoid.solve(start, -goal, spaces, "separation")
    assert passage.slack < 1e-7
    assert passage.terminal_error > 0.1
    assert avoid.solve(start, -goal, spaces, "terminal").terminal_error == pytest.approx(
        passage.terminal_error, rel=1e-5
    )


def test_fuel_does_not_fall_as_half_spaces_tighten():
    avoid = AvoidanceProblem(TransferProblem(plane, 0.25))
    fuel = [
        avoid.solve(start, goal, detour(least=h)).trajectory.fuel for h in (-1, 0.2, 0.4, 0.6, 0.8)
    ]
    assert (np.diff(fuel) > -1e-8).all()
    assert fuel[-1] > 1.2 * fuel[0]


def test_other_norms_are_solved_in_cvxpy():
    for q, r in ((2, 2), ("inf", 1)):
        avoid = AvoidanceProblem(TransferProblem(plane, 0.4, 0.6, q, r))
        passage = avoid.solve(start, goal, detour())
        x, u, fuel = passage.trajectory
        assert detour().violation(x, u).max() < 1e-7
        assert_allclose(x[-1], goal, atol=1e-7)
        size = {1: np.abs(u).sum(1), 2: np.linalg.norm(u, axis=1), "inf": np.abs(u).max(1)}
        assert size[r].max() <= 0.4 * (1 + 1e-7)
        assert fuel == pytest.approx(size[q].sum())
        assert fuel > TransferProblem(plane, 0.4, 0.6, q, r).solve(start, goal).fuel * (1 + 1e-6)


@pytest.mark.parametrize("solve", ["solve", "solve_cvxpy"])
def test_unreachable_goals_and_half_spaces_are_infeasible(solve):
    avoid = AvoidanceProblem(TransferProblem(plane, 0.1))
    with pytest.raises(Infeasible):
        getattr(avoid, solve)(start, 20 * goal, empty_half_spaces(avoid.transfer))
    with pytest.raises(Infeasible):
        getattr(avoid, solve)(start, goal, detour(least=9.0))


@pytest.mark.parametrize("gives", ["none", "terminal", "separation"])
@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_steps_reach_what_they_can(rng, gives, count):
    steps = plane[:count]
    avoid = AvoidanceProblem(TransferProblem(steps, 0.1, 5.0))
    u = rng.uniform(-0.1, 0.1, (count, 2))
    x = steps.simulate(start, u)
    passage = avoid.solve(start, x[-1], empty_half_spaces(avoid.transfer), gives)
    assert_allclose(passage.trajectory.u, u, atol=1e-6)
    if gives == "none":
        with pytest.raises(Infeasible):
            avoid.solve(start, goal, empty_half_spaces(avoid.transfer), gives)
    else:
        passage = avoid.solve(start, goal, empty_half_spaces(avoid.transfer), gives)
        stated = avoid.solve_cvxpy(start, goal, empty_half_spaces(avoid.transfer), gives)
        assert passage.terminal_error == pytest.approx(stated.terminal_error, rel=1e-5)
        assert_allclose(passage.trajectory.u, stated.trajectory.u, atol=1e-5)


def test_no_steps_are_refused():
    avoid = AvoidanceProblem(TransferProblem(plane[:0], 0.1))
    with pytest.raises(ValueError, match="at least one step"):
        avoid.solve(start, goal, empty_half_spaces(avoid.transfer))
