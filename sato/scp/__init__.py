"""Collision-free trajectories by sequential convex programming [Morgan2016, Method 2].

`planner.update_planner` defines what one agent does in an exchange: it hears the trajectories of
its neighbors, keeps clear of those of higher priority, and sends its own. `exchange` repeats that
for all agents until their trajectories are final. `priority_orders` tries several orders of
priority, in `negotiation` two agents in conflict plan together, and `resolve` combines the two with
roundabouts, in which all pass on the same side.

`problems.path_separation` states what separation means, and `problems.convexify` makes it convex.
"""

from sato.scp.planner import CONVERGENCE_TOLERANCE, FEASIBILITY_TOLERANCE, Planner
from sato.scp.resolve import resolve_conflicts

__all__ = ["CONVERGENCE_TOLERANCE", "FEASIBILITY_TOLERANCE", "Planner", "resolve_conflicts"]
