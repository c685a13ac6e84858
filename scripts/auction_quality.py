"""Cost of one auction against the central optimum: python scripts/auction_quality.py."""

import numpy as np

from problems.assignment import solve_assignment
from sato.auctions import VsdaaAuction, run_vsdaa
from sato.network.graph import CommunicationGraph


def main() -> None:
    """Run the auction and print its cost and the optimum."""
    rng = np.random.default_rng(0)
    agents, epsilon = 123, 1e-2
    start, goal = rng.random((agents, 2)), rng.random((160, 2))
    cost = np.linalg.norm(start[:, None] - goal, axis=2)

    network = CommunicationGraph.from_positions(start, radius=0.2, alive=np.full(agents, True))
    auction = run_vsdaa(
        VsdaaAuction(cost, network, target_count=np.full(agents, agents), epsilon=epsilon)
    )

    paid = cost[np.arange(agents), auction.target_index].sum()
    best = cost[np.arange(agents), solve_assignment(cost[:, :agents])].sum()
    print(
        f"{agents} agents, {len(set(auction.target_index))} targets, "
        f"{auction.target_count.max()} believed"
    )
    print(
        f"{auction.bid_count} bids in {auction.round_count} rounds, "
        f"D = {network.diameter.max()} hops"
    )
    print(
        f"cost {paid:.4f}, optimum {best:.4f}: {paid - best:.4f} more, Nε = {agents * epsilon:.2f}"
    )


if __name__ == "__main__":
    main()
