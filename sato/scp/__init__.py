"""Collision-free paths by sequential convex programming [Morgan2016, Method 2].

`revise` is the definition: what one agent does in an exchange. It hears the paths of
its neighbours, keeps clear of those that go before it, and tells its own. `settle`
runs the same for all agents and calls it only where something binds; a test holds the
two equal, exchange by exchange.
`settle_orders` tries several orders of priority, `bargain` lets two who are in each other's
way plan together, and `come_to_terms` does both, and begins from roundabouts besides.

What "apart" means, and how it is made convex, is in `problems.convexify`.
"""

from sato.scp.agent import STILL, TIGHT, Plan, Planner, revise
from sato.scp.bargaining import bargain
from sato.scp.orders import settle_orders
from sato.scp.roundabout import come_to_terms
from sato.scp.run import by_messages, exchanged, settle

__all__ = [
    "STILL",
    "TIGHT",
    "Plan",
    "Planner",
    "bargain",
    "by_messages",
    "come_to_terms",
    "exchanged",
    "revise",
    "settle",
    "settle_orders",
]
