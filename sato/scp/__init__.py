"""Collision-free paths by sequential convex programming [Morgan2016, Method 2].

`revise` is the definition: what one agent does in an exchange. It hears the paths of
its neighbours, keeps clear of those that go before it, and tells its own. `settle`
runs the same for all agents and calls it only where something binds; a test holds the
two equal, exchange by exchange.
`settle_orders` tries several orders of priority, `bargain` lets two who are in each other's
way plan together, and `come_to_terms` does both, and begins from roundabouts besides.

What "apart" means, and how it is made convex, is in `problems.convexify`.
"""

from sato.scp.exchange import run_batched, run_by_messages, run_scp
from sato.scp.negotiation import negotiate
from sato.scp.planner import (
    CONVERGENCE_TOLERANCE,
    FEASIBILITY_TOLERANCE,
    Planner,
    TrajectoryMessage,
    update_planner,
)
from sato.scp.priority_orders import try_priority_orders
from sato.scp.roundabout import resolve_conflicts

__all__ = [
    "CONVERGENCE_TOLERANCE",
    "FEASIBILITY_TOLERANCE",
    "Planner",
    "TrajectoryMessage",
    "negotiate",
    "resolve_conflicts",
    "run_batched",
    "run_by_messages",
    "run_scp",
    "try_priority_orders",
    "update_planner",
]
