"""Joint avoidance of two agents: the condensed program against CVXPY, and priority."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from planner_examples import RADIUS, T, make_planner, make_problem

from problems.avoidance import AvoidanceProblem
from problems.conic import Infeasible
from problems.convexify import choose_normals, convexify
from problems.half_spaces import HalfSpaces, empty_half_spaces
from problems.pair_avoidance import PairProblem, RelativeHalfSpaces
from problems.transfer import TransferProblem


def crossing(rng, axes=2, **limits):
    """Two agents that exchange sides, and a third one that the second avoids."""
    transfer, horizon = make_problem(axes)
    transfer = replace(transfer, tie_break_rise=0.0, **limits)
    aside = np.eye(axes)[1]
    ends = rng.uniform(-0.1, 0.1, (2, 2, axes))
    ends[:, 0] += [[-1.5 * (k == 0) for k in range(axes)], [1.5 * (k == 0) for k in range(axes)]]
    ends[:, 1] += [[1.5 * (k == 0) for k in range(axes)], [-1.5 * (k == 0) for k in range(axes)]]
    ends[:, 1] += 0.2 * aside
    both = [make_planner(i, *(side[i] for side in ends)) for i in range(2)]
    nominal = both[0].control_points + 0.3 * aside - both[1].control_points
    between = RelativeHalfSpaces.from_normals(
        horizon, T, choose_normals(nominal[None], horizon.required_separation)[0]
    )
    third = both[1].control_points + 1.2 * RADIUS * aside
    normal = choose_normals((both[1].control_points - third)[None], horizon.required_separation)
    own = [empty_half_spaces(transfer), convexify(horizon, T, third[None], normal)]
    sides = [
        AvoidanceProblem(transfer, p.nominal.x[0], p.target_state, spaces)
        for p, spaces in zip(both, own, strict=True)
    ]
    return both, PairProblem(*sides, between), horizon


def stands(pair, flights):
    for side, flight in zip((pair.first, pair.second), flights, strict=True):
        assert_allclose(flight.x[-1], side.goal, atol=1e-6)
        assert side.half_spaces.violation(flight.x, flight.u).max(initial=-1.0) <= 1e-7
        assert np.abs(flight.u).max() <= side.transfer.max_control * (1 + 1e-9)
        assert fastest([flight]) <= side.transfer.max_speed * (1 + 1e-8)
    assert pair.relative_half_spaces.violation(*flights).max(initial=-1.0) <= 1e-7


@pytest.mark.parametrize("objective", ["fuel", "energy"])
@pytest.mark.parametrize("axes", [2, 3])
def test_the_condensed_program_agrees_with_cvxpy(rng, axes, objective):
    for _ in range(2):
        _, pair, _ = crossing(rng, axes, objective=objective)
        cost = pair.first.transfer.cost
        unhurried = pair.solve()
        slower = with_limits(pair, max_speed=0.999 * fastest(unhurried))  # which that flight breaks
        for question in (pair, slower):
            found, stated = question.solve(), question.solve_cvxpy()
            stands(question, found)
            costs = [sum(map(cost, both)) for both in (found, stated)]
            assert costs[0] == pytest.approx(costs[1], rel=1e-6)


def with_limits(pair, **limits):
    sides = (replace(p, transfer=replace(p.transfer, **limits)) for p in (pair.first, pair.second))
    return PairProblem(*sides, pair.relative_half_spaces)


def fastest(flights):
    d = flights[0].u.shape[1]
    return max(np.linalg.norm(flight.x[1:-1, d:], axis=1).max() for flight in flights)


def test_relative_rows_are_those_of_the_relative_control_points(rng):
    both, _, horizon = crossing(rng)
    first, second = (p.nominal for p in both)
    normal = rng.normal(size=(len(both[0].control_points), 2))
    between = RelativeHalfSpaces.from_normals(horizon, T, normal)
    room = (
        np.einsum("pd,pid->pi", normal, both[0].control_points - both[1].control_points)
        - horizon.required_separation
    )
    missing = between.violation(first, second)
    assert_allclose(np.sort(-missing), np.sort(room.ravel()[-len(missing) :]), atol=1e-9)


def test_without_relative_half_spaces_both_fly_their_own_transfers(rng):
    _, pair, _ = crossing(rng)
    nothing = replace(
        pair,
        second=pair.second.select(np.zeros(0, dtype=int)),
        relative_half_spaces=pair.relative_half_spaces.select(np.zeros(0, dtype=int)),
    )
    for flight, side in zip(nothing.solve(), (nothing.first, nothing.second), strict=True):
        assert flight.fuel == pytest.approx(side.transfer.solve(side.start, side.goal).fuel)


def test_a_joint_solution_costs_no_more_than_one_by_priority(rng):
    saved = []
    for _ in range(4):
        _, pair, _ = crossing(rng)
        together = sum(flight.fuel for flight in pair.solve())
        first, second = pair.first, pair.second
        alone = first.transfer.solve(first.start, first.goal)
        # What is between them, for the second alone: the first flies as it likes.
        common = pair.relative_half_spaces.second
        least = common.rhs + pair.relative_half_spaces.first.violation(alone.x, alone.u)
        both = zip(common._replace(rhs=least), second.half_spaces, strict=True)
        spaces = HalfSpaces(*map(np.concatenate, both))
        around = replace(second, half_spaces=spaces).solve().trajectory
        saved.append(alone.fuel + around.fuel - together)
    assert min(saved) >= -1e-7 and max(saved) > 1e-3


@pytest.mark.parametrize("norms", [(2, 2), ("inf", 1), (1, 2)])
def test_programs_of_other_norms_agree_with_cvxpy(rng, norms):
    _, pair, _ = crossing(rng, fuel_norm=norms[0], control_norm=norms[1])
    found, stated = pair.solve(), pair.solve_cvxpy()
    assert sum(own.fuel for own in found) == pytest.approx(sum(own.fuel for own in stated))
    assert pair.relative_half_spaces.violation(*found).max() <= 1e-6
    assert found[0].x[-1] == pytest.approx(pair.first.goal, abs=1e-6)


@pytest.mark.parametrize("solve", ["solve", "solve_cvxpy"])
def test_incompatible_constraints_are_infeasible(rng, solve):
    _, pair, _ = crossing(rng)
    first = pair.relative_half_spaces.first
    far = pair.relative_half_spaces._replace(first=first._replace(rhs=first.rhs + 50.0))
    with pytest.raises(Infeasible):
        getattr(replace(pair, relative_half_spaces=far), solve)()


def test_no_steps_are_refused(rng):
    _, pair, _ = crossing(rng)
    over = TransferProblem(pair.first.transfer.model[:0], 0.2)
    with pytest.raises(ValueError, match="at least one step"):
        replace(pair, first=replace(pair.first, transfer=over)).solve()
