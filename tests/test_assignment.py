"""Optimal assignment, against all permutations."""

from itertools import permutations

import numpy as np
import pytest

from problems.assignment import solve_assignment


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
