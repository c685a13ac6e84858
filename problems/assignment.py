"""Optimal assignment from all costs, for comparison with auctions."""

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment


def solve_assignment(cost: Float[Array, "agents targets"]) -> Int[Array, " agents"]:
    """Assign a different target to every agent at the least total cost [Morgan2016, Problem 2].

    This needs all costs at once, which no agent of a swarm knows; no distributed decision uses
    it.

    Args:
        cost: Cost of each target for each agent; at least as many targets as agents.

    Returns:
        The target of each agent.

    Raises:
        ValueError: A cost is not finite, or there are fewer targets than agents.
    """
    if cost.ndim != 2:
        raise ValueError(f"cost must have two axes, agents and targets, got {cost.ndim}")
    agents, targets = cost.shape
    if agents > targets:
        raise ValueError(
            f"{agents} agents cannot have a target each of {targets}: "
            "add targets or leave agents out"
        )
    if not np.all(np.isfinite(cost)):
        i, j = np.argwhere(~np.isfinite(cost))[0]
        raise ValueError(
            f"the cost of target {j} for agent {i} is {cost[i, j]}: "
            "give an unreachable target a large finite cost"
        )
    return np.asarray(linear_sum_assignment(cost)[1], dtype=np.int64)
