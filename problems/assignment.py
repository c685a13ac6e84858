"""Optimal assignment from all costs, and its prices, to compare with auctions or forecast one."""

from typing import Annotated

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array
from scipy.optimize import linear_sum_assignment

from dynamics.doors import ANY_NUMBER, checked

Costs = Float[Array, "agents targets"]


@checked
def solve_assignment(cost: Annotated[Costs, ANY_NUMBER]) -> Int[Array, " agents"]:
    """Assign a different target to every agent at the least total cost [Morgan2016, Problem 2].

    This needs all costs at once. No agent of a swarm knows those of the others for certain.

    Args:
        cost: Cost of each target for each agent; at least as many targets as agents.

    Returns:
        The target of each agent.

    Raises:
        ValueError: A cost is not finite, or there are fewer targets than agents.
    """
    agents, targets = cost.shape
    if agents > targets:
        reason = f"{agents} agents cannot have a target each of {targets}"
        raise ValueError(f"{reason}: add targets or leave agents out")
    if not np.all(np.isfinite(cost)):
        i, j = np.argwhere(~np.isfinite(cost))[0]
        reason = f"the cost of target {j} for agent {i} is {cost[i, j]}"
        raise ValueError(f"{reason}: give an unreachable target a large finite cost")
    return np.asarray(linear_sum_assignment(cost)[1], dtype=np.int64)


def least_prices(cost: Costs, target_index: Int[Array, " agents"]) -> Float[Array, " targets"]:
    """Compute the least prices at which no agent would rather have another target.

    They are the least p ≥ 0 with p_j ≥ p_σ(i) + c_iσ(i) − c_ij for all i and j: lengths of longest
    paths, found in at most N sweeps. A target that is left over costs nothing.
    """
    rows, price = np.arange(len(cost)), np.zeros(cost.shape[1])
    own = cost[rows, target_index]
    for _ in range(len(cost)):
        total = price[target_index[rows]] + own[rows]
        least = np.max(total[:, None] - cost[rows], axis=0, initial=0.0)
        is_raised, price = least > price, np.maximum(price, least)
        rows = np.flatnonzero(is_raised[target_index])  # agents whose own target became dearer
        if not len(rows):
            break
    return price
