"""Conflict resolution: orders of priority, negotiation, and roundabouts."""

from collections.abc import Mapping

from sato.network.graph import CommunicationGraph
from sato.scp.negotiation import negotiate
from sato.scp.planner import Planner
from sato.scp.priority_orders import (
    ConflictResolution,
    compute_priority_costs,
    keep_cheaper,
    select_components,
    sum_by_component,
    try_priority_orders,
)
from sato.scp.roundabout import can_use_roundabout, solve_roundabout

OFFSETS = (1.0, -1.0, 2.0, -2.0)  # of the nominals in a roundabout, over R: right and left


def resolve_conflicts(
    planners: Mapping[int, Planner], graph: CommunicationGraph, orders: int, sweeps: int
) -> ConflictResolution:
    """Try orders of priority and then roundabouts, each followed by negotiation.

    Each component keeps the cheapest.

    Args:
        planners: Planner of each live agent, by its number; the first order is that of `priority`.
        graph: Communication graph.
        orders: Largest number of orders of priority.
        sweeps: Largest number of sweeps of negotiation; with 0 there are no roundabouts either.
    """
    ordered = try_priority_orders(planners, graph, orders)
    if sweeps == 0:
        return ordered
    negotiated = negotiate(ordered.planners, graph, sweeps)
    kept, costs = negotiated.planners, compute_priority_costs(negotiated.planners)
    flooding = int(graph.diameter[list(kept)].max(initial=0))
    trials, floods = [ordered, negotiated], 1
    able = select_components(planners, graph, can_use_roundabout)
    for offset in OFFSETS:
        totals = sum_by_component(costs, graph)
        costly = {i: able[i] for i, total in totals.items() if i in able and any(total)}
        roundabout = solve_roundabout(costly, graph, offset)
        trials.append(roundabout)
        if roundabout.planners:
            negotiated = negotiate(roundabout.planners, graph, sweeps)
            tried_costs = compute_priority_costs(negotiated.planners)
            kept, costs = keep_cheaper(kept, costs, negotiated.planners, tried_costs, graph)
            trials.append(negotiated)
            floods += 1
    return ConflictResolution(
        kept,
        sum(trial.round_count for trial in trials) + floods * flooding,
        sum(trial.solve_count for trial in trials),
    )
