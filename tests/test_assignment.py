"""Optimal assignment, against all permutations."""

from itertools import permutations

import numpy as np
import pytest
from scipy.optimize import linprog

from problems.assignment import least_prices, solve_assignment


@pytest.mark.parametrize(("agents", "targets"), [(1, 1), (3, 3), (3, 6), (5, 6)])
def test_no_permutation_is_cheaper(rng, agents, targets):
    cost = rng.normal(size=(agents, targets))
    best = min(
        sum(cost[i, j] for i, j in enumerate(chosen))
        for chosen in permutations(range(targets), agents)
    )
    target = solve_assignment(cost)
    assert len(set(target.tolist())) == agents
    assert cost[np.arange(agents), target].sum() == pytest.approx(best, abs=1e-12)


@pytest.mark.parametrize(("agents", "targets"), [(1, 1), (6, 6), (6, 9), (30, 30), (30, 33)])
def test_prices_are_the_least_at_which_nobody_would_exchange(rng, agents, targets):
    cost, rows = rng.normal(size=(agents, targets)), np.arange(agents)
    target = solve_assignment(cost)
    price, own = least_prices(cost, target), cost[rows, target]
    assert (price[target] + own <= (price + cost).min(axis=1) + 1e-12).all()
    assert not np.delete(price, target).any()
    # p_σ(i) − p_j ≤ c_ij − c_iσ(i) for all i and j
    unit = np.eye(targets)
    exchanges = (unit[target][:, None] - unit).reshape(-1, targets)
    most = (cost - own[:, None]).ravel()
    found = linprog(np.ones(targets), exchanges, most, bounds=(0, None))
    np.testing.assert_allclose(price, found.x, rtol=0, atol=1e-9)


def test_no_agents_get_an_empty_assignment():
    assert solve_assignment(np.zeros((0, 3))).shape == (0,)


def test_fewer_targets_than_agents_are_refused():
    with pytest.raises(ValueError, match="3 agents cannot have a target each of 2"):
        solve_assignment(np.zeros((3, 2)))


@pytest.mark.parametrize("bad", [np.inf, np.nan])
def test_a_cost_that_is_not_finite_is_refused_with_its_indices(bad):
    cost = np.zeros((2, 3))
    cost[1, 2] = bad
    with pytest.raises(ValueError, match="cost of target 2 for agent 1"):
        solve_assignment(cost)
