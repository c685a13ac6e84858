"""Pairs that the speed limit binds: the sparse programme against the statement."""

from math import inf

import numpy as np
import pytest

from dynamics import ClohessyWiltshire, DoubleIntegrator, Steps, hold
from problems.conic import Infeasible
from problems.transfer import Transfer
from problems.within_speed import WithinSpeed

plane = hold(DoubleIntegrator(2), 1.0, 16)
orbit = hold(ClohessyWiltshire(1.1e-3), 60.0, 16)


def bound_pairs(steps, rng, U, V, count):
    """Starts and goals whose cheapest flights break the limit, and those prices."""
    d, free = steps.axes, Transfer(steps, U)
    while count:
        start = np.concatenate([rng.normal(0, V, d), rng.uniform(-V, V, d) / 2])
        goal = steps.roll(start, rng.uniform(-U, U, (len(steps), d)))[-1]
        cheapest = free.solve(start, goal)
        peak = np.linalg.norm(cheapest.x[1:-1, d:], axis=1).max()
        if 1.001 * V < peak < 1.1 * V:
            count -= 1
            yield start, goal, cheapest.fuel


@pytest.mark.parametrize(("steps", "U", "V"), [(plane, 0.1, 0.35), (orbit, 0.01, 2.5)])
def test_the_sparse_programme_is_the_statement(rng, steps, U, V):
    transfer = Transfer(steps, U, V)
    programme, found, d = WithinSpeed(transfer), 0, steps.axes
    for start, goal, lower in bound_pairs(steps, rng, U, V, 12):
        try:
            stated = transfer.solve(start, goal)
        except Infeasible:
            with pytest.raises(Infeasible):
                programme.solve(start, goal)
            continue
        found += 1
        x, u, fuel = programme.solve(start, goal)
        assert fuel == pytest.approx(stated.fuel, rel=1e-6)
        assert fuel >= lower * (1 - 1e-7)
        np.testing.assert_allclose(x[-1], goal, atol=1e-7 * np.abs(goal).max())
        np.testing.assert_allclose(steps.roll(start, u), x)
        assert np.abs(u).max() <= U
        assert np.linalg.norm(x[1:-1, d:], axis=1).max() <= V * (1 + 1e-7)
    assert found >= 3


def test_an_answer_does_not_depend_on_those_before_it(rng):
    transfer = Transfer(orbit, 0.01, 2.5, slope=1e-3)
    pairs = [pair[:2] for pair in bound_pairs(orbit, rng, 0.01, 2.5, 6)]

    def ask(programme, pair):
        try:
            return programme.solve(*pair).u
        except Infeasible:
            return np.zeros(0)

    one = WithinSpeed(transfer)
    forwards = [ask(one, pair) for pair in pairs]
    backwards = [ask(one, pair) for pair in pairs[::-1]][::-1]
    for pair, u, again in zip(pairs, forwards, backwards, strict=True):
        np.testing.assert_array_equal(u, again)
        np.testing.assert_array_equal(u, ask(WithinSpeed(transfer), pair))


def test_weights_drift_and_dynamics_that_change_are_carried_over(rng):
    A = np.eye(4) + rng.normal(size=(8, 4, 4)) / 10
    steps = Steps(A, rng.normal(size=(8, 4, 2)), rng.normal(size=(8, 4)) / 5, 0.5)
    start, u = rng.normal(size=4) / 5, rng.uniform(-0.2, 0.2, (8, 2))
    goal = steps.roll(start, u)[-1]
    free = Transfer(steps, 0.3, slope=0.2).solve(start, goal)
    V = 0.95 * np.linalg.norm(free.x[1:-1, 2:], axis=1).max()
    transfer = Transfer(steps, 0.3, V, slope=0.2)
    stated, flight = transfer.solve(start, goal), WithinSpeed(transfer).solve(start, goal)
    priced = [transfer.weight @ np.abs(f.u).sum(axis=1) for f in (stated, flight)]
    assert priced[1] == pytest.approx(priced[0], rel=1e-6)
    assert priced[0] > transfer.weight @ np.abs(free.u).sum(axis=1) * (1 + 1e-6)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_few_steps_are_enough_where_they_are(rng, count):
    steps = plane[:count]
    start, u = np.array([0, 0, 0.1, 0.1]), rng.uniform(-0.1, 0.1, (count, 2))
    goal = steps.roll(start, u)[-1]
    programme = WithinSpeed(Transfer(steps, 0.1, 0.5))
    np.testing.assert_allclose(programme.solve(start, goal).x[-1], goal, atol=1e-8)
    with pytest.raises(Infeasible):
        programme.solve(start, goal + 1.0)


@pytest.mark.parametrize("changes", [(inf, 1, "inf"), (0.5, 2, "inf"), (0.5, 1, 2)])
def test_what_needs_another_programme_is_refused(changes):
    with pytest.raises(ValueError, match=r"ask Transfer\.solve"):
        WithinSpeed(Transfer(plane, 0.1, *changes))


def test_no_steps_are_refused():
    with pytest.raises(ValueError, match="at least one step"):
        WithinSpeed(Transfer(plane[:0], 0.1, 0.5))


def test_a_proof_for_one_pair_serves_others_that_it_holds_for():
    """In 16 s nobody flies 9 m at 0.35 m/s; the second time that takes no solver."""
    transfer = Transfer(plane, 0.1, 0.35)
    programme, start, far = WithinSpeed(transfer), np.zeros(4), np.array([9.0, 0, 0, 0])
    with pytest.raises(Infeasible, match="Clarabel"):
        programme.solve(start, far)
    for goal in (far, np.array([10.0, 2.0, 0, 0])):
        with pytest.raises(Infeasible, match="the proof for another pair") as verdict:
            programme.solve(start, goal)
        problem, y = verdict.value.problem, verdict.value.ray
        assert problem.b @ y == pytest.approx(-1)
        assert np.abs(problem.A.T @ y).sum() < 1e-5
        assert problem.outside(y, dual=True) < 1e-5
    with pytest.raises(Infeasible, match="Clarabel"):  # the other way it says nothing
        programme.solve(start, -far)
    near = np.array([3.0, 0, 0, 0])
    assert programme.solve(start, near).fuel == pytest.approx(transfer.solve(start, near).fuel)
