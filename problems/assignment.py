"""The central optimum of an assignment: the yardstick of every auction."""

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment


def solve_assignment(cost: Float[Array, "agents targets"]) -> Int[Array, " agents"]:
    """Give every agent its own target at the least total cost [Morgan2016, Problem 2].

    It sees every cost at once, which no agent of a swarm can; nothing here takes part
    in a distributed decision.

    Args:
        cost: Price of each target for each agent; at least as many targets as agents.

    Returns:
        The target of each agent.

    Raises:
        ValueError: The table is not finite, or has fewer targets than agents.
    """
    if cost.ndim != 2:
        raise ValueError(f"a cost table has two axes, agents and targets, got {cost.ndim}")
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
