"""Assignments without an auction, with the data and the result of one: for comparison."""

import numpy as np

from dynamics.doors import checked
from problems.assignment import solve_assignment
from sato.auctions.vsdaa import OutOfTargets, VsdaaAuction, VsdaaResult


@checked
def assign_given(auction: VsdaaAuction) -> VsdaaResult:
    """Assign to each live agent the target of its own number."""
    return _result(auction, np.arange(len(auction.cost)), auction.target_count)


@checked
def assign_centrally(auction: VsdaaAuction) -> VsdaaResult:
    """Assign the optimum over the first max(N, m) targets in each component.

    Raises:
        OutOfTargets: A component has more agents than there are targets.
    """
    cost, graph = auction.cost, auction.graph
    m, target_index = graph.component_max(auction.target_count), np.full(len(cost), -1)
    for c in range(graph.component.max(initial=-1) + 1):
        members = np.flatnonzero(graph.component == c)
        m[members] = np.maximum(m[members], len(members))
        if len(members) > cost.shape[1]:
            raise OutOfTargets(int(members[-1]), 0, cost.shape[1])
        target_index[members] = solve_assignment(cost[members, : m[members[0]]])
    return _result(auction, target_index, m)


def _result(auction: VsdaaAuction, target_index: np.ndarray, m: np.ndarray) -> VsdaaResult:
    graph = auction.graph
    return VsdaaResult(
        target_index=np.where(graph.alive, target_index, -1),
        target_count=m,
        bidder_count=np.bincount(graph.component[graph.alive], minlength=1)[graph.component],
        round_count=0,
        bid_count=0,
        last_bid_round=0,
        stop_round=np.zeros_like(m),
        price=np.zeros_like(auction.cost),
        message_count=np.zeros_like(m),
        entry_count=np.zeros_like(m),
    )
