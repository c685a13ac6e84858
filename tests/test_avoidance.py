"""Avoidance problems: the condensed program against CVXPY, and relaxations."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from dynamics.errors import InputError
from problems.avoidance import AvoidanceProblem
from problems.conic import Infeasible
from problems.convexify import AvoidanceHorizon
from problems.half_spaces import HalfSpaces, empty_half_spaces
from problems.solvers.verified import VerifiedSolver, solve_program
from problems.transfer import TransferProblem

plane = discretize_zoh(DoubleIntegrator(2), 1.0, 12)
space = discretize_zoh(DoubleIntegrator(3), 1.0, 12)
orbit = discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 10)
conic = VerifiedSolver(tolerance=1e-7)  # one that was chosen, by its tolerance
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


@pytest.mark.parametrize(("x", "u", "key"), [(0, 4, "x"), (4, 0, "u"), (3, 4, "x")])
def test_half_spaces_need_a_state_and_a_control_for_each_of_their_steps(x, u, key):
    spaces = HalfSpaces(np.arange(4), np.ones((4, 4)), np.ones((4, 2)), np.zeros(4))
    with pytest.raises(InputError, match=f"{key}: must have more than 3 rows"):
        spaces.to_cvxpy(np.ones((x, 4)), np.ones((u, 2)))


def test_without_half_spaces_the_solution_is_the_plain_transfer(rng):
    for steps, U in ((plane, 0.2), (space, 0.2), (orbit, 0.01)):
        for V in (inf, 0.45 if steps is not orbit else 3.0):
            transfer = TransferProblem(steps, U, V)
            d = steps.axes
            x0 = np.concatenate([rng.normal(0, 1, d), rng.normal(0, 0.1, d)])
            xf = steps.simulate(x0, rng.uniform(-U / 4, U / 4, (len(steps), d)))[-1]
            stated = transfer.solve(x0, xf)
            passage = AvoidanceProblem.alone(transfer, x0, xf).solve()
            assert passage.trajectory.fuel == pytest.approx(stated.fuel, rel=1e-6)
            assert passage.terminal_error <= 1e-6 and passage.slack == 0


@pytest.mark.parametrize("V", [inf, 0.305])
@pytest.mark.parametrize("gives", ["none", "terminal", "separation"])
@pytest.mark.parametrize("solver", [solve_program, conic], ids=["generated", "conic"])
@pytest.mark.parametrize("steps", [plane, space], ids=["2-D", "3-D"])
def test_generated_and_condensed_programs_agree_with_cvxpy(steps, solver, gives, V):
    spaces, (x0, xf) = detour(steps), ends(steps)
    transfer = TransferProblem(steps, 0.25, V, tie_break_rise=1e-2)
    avoid = AvoidanceProblem(transfer, x0, xf, spaces, solver)
    fast, stated = avoid.solve(gives), avoid.solve_cvxpy(gives)
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
    transfer = TransferProblem(plane, 0.1, V, tie_break_rise=1e-2)
    for spaces in (empty_half_spaces(transfer), detour()):
        avoid = AvoidanceProblem(transfer, start, far, spaces)
        fast, stated = avoid.solve("terminal"), avoid.solve_cvxpy("terminal")
        assert fast.terminal_error == pytest.approx(stated.terminal_error, rel=1e-5)
        assert fast.terminal_error > 1
        assert spaces.violation(*fast.trajectory[:2]).max(initial=0) < 1e-7
    avoid = AvoidanceProblem(transfer, start, goal, detour(least=4.0))
    fast, stated = avoid.solve("separation"), avoid.solve_cvxpy("separation")
    assert fast.slack == pytest.approx(stated.slack, rel=1e-4)
    assert fast.slack > 0.5


@pytest.mark.parametrize("solver", [solve_program, conic], ids=["generated", "conic"])
@pytest.mark.parametrize("V", [inf, 0.6])
def test_half_spaces_are_violated_least_on_the_way_to_the_goal(V, solver):
    walls = detour(least=4.0)
    transfer = TransferProblem(plane, 0.1, V, tie_break_rise=1e-2)
    avoid = AvoidanceProblem(transfer, start, goal, walls, solver)
    found, stated = avoid.solve("half-spaces"), avoid.solve_cvxpy("half-spaces")
    assert found.slack == pytest.approx(stated.slack, rel=1e-5)
    assert found.slack > 0.5 and found.terminal_error < 1e-6


def test_a_relaxation_changes_nothing_where_the_problem_is_feasible():
    avoid = AvoidanceProblem(TransferProblem(plane, 0.25), start, goal, detour())
    strict = avoid.solve().trajectory.fuel
    for gives in ("terminal", "half-spaces", "separation"):
        passage = avoid.solve(gives)
        assert passage.trajectory.fuel == pytest.approx(strict, rel=1e-6)
        assert max(passage.terminal_error, passage.slack) < 1e-8


def test_the_terminal_state_is_relaxed_before_the_separation():
    # Half-spaces until the last step make the goal on the other side unreachable.
    avoid = AvoidanceProblem(TransferProblem(plane, 0.1), start, -goal, detour(last=12))
    with pytest.raises(Infeasible):
        avoid.solve()
    passage, error = avoid.solve("separation"), avoid.solve("terminal").terminal_error
    assert passage.slack < 1e-7
    assert passage.terminal_error > 0.1
    assert error == pytest.approx(passage.terminal_error, rel=1e-5)


def test_fuel_does_not_fall_as_half_spaces_tighten():
    transfer = TransferProblem(plane, 0.25)
    fuel = [
        AvoidanceProblem(transfer, start, goal, detour(least=h)).solve().trajectory.fuel
        for h in (-1, 0.2, 0.4, 0.6, 0.8)
    ]
    assert (np.diff(fuel) > -1e-8).all()
    assert fuel[-1] > 1.2 * fuel[0]


@pytest.mark.parametrize("gives", ["none", "separation"])
@pytest.mark.parametrize("objective", ["fuel", "energy"])
@pytest.mark.parametrize("most", [0.4, np.array([0.4, 0.5])])
@pytest.mark.parametrize("r", [1, 2, "inf"])
@pytest.mark.parametrize("q", [1, 2, "inf"])
def test_programs_of_all_norms_agree_with_cvxpy(q, r, most, objective, gives):
    transfer = TransferProblem(plane, most, 0.6, q, r, objective=objective)
    avoid = AvoidanceProblem(transfer, start, goal, detour())
    (x, u, fuel), *_ = found = avoid.solve_conic(gives)
    stated = avoid.solve_cvxpy(gives)
    assert detour().violation(x, u).max() < 1e-6
    assert_allclose(x[-1], goal, atol=1e-6)
    size = {1: np.abs(u).sum(1), 2: np.linalg.norm(u, axis=1), "inf": np.abs(u).max(1)}
    assert (transfer.control_limit.measure(u) <= np.max(most) * (1 + 1e-7)).all()
    assert fuel == pytest.approx(size[q].sum())
    cost = transfer.cost(found.trajectory)
    assert cost == pytest.approx(transfer.cost(stated.trajectory), rel=1e-6)
    assert cost > transfer.cost(transfer.solve(start, goal)) * (1 + 1e-6)


@pytest.mark.parametrize("solve", ["solve", "solve_cvxpy"])
def test_unreachable_goals_and_half_spaces_are_infeasible(solve):
    transfer = TransferProblem(plane, 0.1)
    far = AvoidanceProblem.alone(transfer, start, 20 * goal)
    for avoid in (far, AvoidanceProblem(transfer, start, goal, detour(least=9.0))):
        with pytest.raises(Infeasible):
            getattr(avoid, solve)()


@pytest.mark.parametrize("gives", ["none", "terminal", "separation"])
@pytest.mark.parametrize("count", [1, 2])
def test_one_or_two_steps_reach_what_they_can(rng, gives, count):
    transfer, u = TransferProblem(plane[:count], 0.1, 5.0), rng.uniform(-0.1, 0.1, (count, 2))
    x = transfer.model.simulate(start, u)
    passage = AvoidanceProblem.alone(transfer, start, x[-1]).solve(gives)
    assert_allclose(passage.trajectory.u, u, atol=1e-6)
    far = AvoidanceProblem.alone(transfer, start, goal)
    if gives == "none":
        with pytest.raises(Infeasible):
            far.solve(gives)
    else:
        passage, stated = far.solve(gives), far.solve_cvxpy(gives)
        assert passage.terminal_error == pytest.approx(stated.terminal_error, rel=1e-5)
        assert_allclose(passage.trajectory.u, stated.trajectory.u, atol=1e-5)


def test_no_steps_are_refused():
    with pytest.raises(ValueError, match="at least one step"):
        AvoidanceProblem.alone(TransferProblem(plane[:0], 0.1), start, goal).solve()


@pytest.mark.parametrize("fuel_norm", [1, 2])
@pytest.mark.parametrize("speed_norm", [1, 2, "inf"])
def test_no_solution_exceeds_the_speed_limit(rng, speed_norm, fuel_norm):
    solver = VerifiedSolver("scs", 1e-4)  # whose own accuracy would exceed it
    for relaxation in ("none", "terminal", "half-spaces", "separation"):
        V = rng.uniform(0.2, 0.4)
        transfer = TransferProblem(plane, 0.2, V, fuel_norm=fuel_norm, speed_norm=speed_norm)
        start, goal = np.zeros(4), np.zeros(4)
        goal[:2] = rng.uniform(0.4, 0.5) * V * len(plane) * rng.choice([-1, 1], 2)
        problem = AvoidanceProblem.alone(transfer, start, goal, solver)
        for factor in (1.0, 3.0) if relaxation in ("terminal", "separation") else (1.0,):
            question = replace(problem, goal=factor * goal)
            found = question.solve(relaxation).trajectory
            assert not transfer.is_too_fast(found.x).any()
            assert transfer.control_limit.measure(found.u).max() <= 0.2 * (1 + 1e-9)


@pytest.mark.parametrize("speed_norm", [2, "inf"])
def test_targets_within_reach_at_full_speed_alone_are_reached(speed_norm):
    # Coasting at the limit, with the least of control: any lower limit leaves no way.
    transfer = TransferProblem(plane, 0.2, 0.3, speed_norm=speed_norm, fuel_norm=1)
    start = np.array([0.0, 0.0, 0.3, 0.0])
    goal = plane.simulate(start, np.zeros((len(plane), 2)))[-1]
    for solver in (VerifiedSolver(), VerifiedSolver("scs", 1e-5)):
        found = AvoidanceProblem.alone(transfer, start, goal, solver).solve()
        assert not transfer.is_too_fast(found.trajectory.x).any()
        assert found.terminal_error <= 1e-5 * 0.3 * len(plane)


def test_half_spaces_beyond_the_horizon_are_refused():
    beyond = HalfSpaces(np.array([len(plane)]), np.ones((1, 4)), np.zeros((1, 2)), np.ones(1))
    with pytest.raises(InputError, match=r"half_spaces\.step_index: must be less than"):
        AvoidanceProblem(TransferProblem(plane, 0.2), np.zeros(4), np.zeros(4), beyond)


@pytest.mark.parametrize(("dt", "count"), [(0.5, 12), (0.3, 10), (1.0, 2)])
def test_pieces_of_another_time_than_the_steps_are_refused(dt, count):
    steps, pieces = (discretize_zoh(DoubleIntegrator(2), *each) for each in ((1.0, 3), (dt, count)))
    with pytest.raises(InputError, match="fine_model: must divide each of 3 steps of 1 s"):
        AvoidanceHorizon(steps, pieces, 0.5)
