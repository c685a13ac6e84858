"""One auction against the central optimum: python scripts/auction_quality.py."""

import numpy as np

from problems.assignment import assign
from sato.network import Network
from sato.vsdaa import vsdaa

rng = np.random.default_rng(0)
agents, epsilon = 123, 1e-2
start, goal = rng.random((agents, 2)), rng.random((160, 2))
cost = np.linalg.norm(start[:, None] - goal, axis=2)

network = Network.within(start, radius=0.2, alive=np.full(agents, True))
auction = vsdaa(cost, network, believed=np.full(agents, agents), epsilon=epsilon)

paid = cost[np.arange(agents), auction.target].sum()
best = cost[np.arange(agents), assign(cost[:, :agents])].sum()
print(f"{agents} agents, {len(set(auction.target))} targets, {auction.believed.max()} believed")
print(f"{auction.bids} bids in {auction.rounds} rounds, D = {network.diameter.max()} hops")
print(f"cost {paid:.4f}, optimum {best:.4f}: {paid - best:.4f} more, Nε = {agents * epsilon:.2f}")
