"""VSDAA for a swarm: by messages, which is the definition, or compiled, which is fast."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from sato.auctions.bids import NO_WINNER, WinningBids
from sato.auctions.vsdaa import VsdaaBidder, is_finished, update_bidder
from sato.auctions.vsdaa_kernel import init_state, run_kernel
from sato.network.graph import CommunicationGraph, flood, learn_diameter, run_rounds


class VsdaaResult(NamedTuple):
    """How an auction ended."""

    target_index: Int[Array, " agents"]  # −1 for who is not alive
    target_count: Int[Array, " agents"]  # m, the number of targets bid on
    bidder_count: Int[Array, " agents"]  # holders in the agent's own book: the bidders it heard of
    round_count: (
        int  # until the last agent stopped, from the first bid; learning D and m took 4 D + 1
    )
    bid_count: int
    last_bid_round: int
    price: Float[Array, "agents targets"]  # signed, as in the agents' books


def run_by_messages(
    cost: Float[Array, "agents targets"],
    network: CommunicationGraph,
    target_count: Int[Array, " agents"],
    epsilon: float,
    *,
    bidder_ids: bool = True,
) -> Iterator[list[VsdaaBidder]]:
    """Run the definition itself: every agent after every round. See `vsdaa`.

    Agents first learn the diameter of their component, then agree on the largest m, then bid.
    """
    _validate(cost, network, target_count, epsilon)
    diameter = learn_diameter(network)
    agreed = flood(network, target_count.tolist(), max)
    empty = WinningBids.empty(cost.shape[1])
    bidders = [
        VsdaaBidder(i, cost[i], epsilon, bidder_ids, 2 * int(diameter[i]), agreed[i], empty)
        for i in range(len(cost))
    ]
    return run_rounds(network, bidders, update_bidder, lambda agent: agent.bids, is_finished)


def run_vsdaa(
    cost: Float[Array, "agents targets"],
    network: CommunicationGraph,
    target_count: Int[Array, " agents"],
    epsilon: float,
    *,
    bidder_ids: bool = True,
) -> VsdaaResult:
    """Give every agent its own target, by talking to neighbours only [Morgan2016, Method 1].

    In a component of N agents the total cost is within N ε of the optimum over the first
    max(N, m) targets, where m is the largest number that one of them believes in. Components
    know nothing of each other, so they may choose the same targets.

    Args:
        cost: What each target costs each agent; finite, also where it is out of reach.
        network: Who hears whom while the auction lasts.
        believed: m of each agent, the number of targets it would bid on.
        epsilon: Bid increment, on the scale of the cost.
        ids: Bids carry the bidder's number, which decides between equal bids. False runs
            the printed method, which may give one target to two agents.

    Raises:
        ValueError: The input is not of this kind.
        OutOfTargets: A component has more agents than there are targets.
    """
    _validate(cost, network, target_count, epsilon)
    swarm = init_state(cost, network, target_count)
    for _ in run_kernel(swarm, epsilon, bidder_ids):
        pass
    ends = np.where(network.alive, swarm.last_news_round + swarm.patience, 0)
    return VsdaaResult(
        target_index=swarm.target_index,
        target_count=swarm.target_count,
        bidder_count=np.count_nonzero(swarm.winner != NO_WINNER, axis=1),
        round_count=int(ends.max(initial=0)),
        bid_count=int(swarm.bid_count.sum()),
        last_bid_round=int(swarm.last_bid_round.max(initial=0)),
        price=swarm.price,
    )


def _validate(cost: Array, network: CommunicationGraph, believed: Array, epsilon: float) -> None:
    agents, targets = cost.shape
    alive = network.alive
    if agents != len(alive) or agents != len(believed):
        raise ValueError(
            f"costs for {agents} agents, a network of {len(alive)}, m of {len(believed)}: "
            "there must be a row and an m for every agent of the network"
        )
    if not np.all(np.isfinite(cost[alive])):
        i, j = next((i, j) for i, j in np.argwhere(~np.isfinite(cost)) if alive[i])
        raise ValueError(
            f"the cost of target {j} for agent {i} is {cost[i, j]}: "
            "give an unreachable target a large finite cost"
        )
    wrong = np.flatnonzero(alive & ((believed < 1) | (believed > targets)))
    if len(wrong):
        raise ValueError(
            f"agent {wrong[0]} believes in {believed[wrong[0]]} targets: "
            f"from 1 to the {targets} that are defined would do"
        )
    # Prices may climb to agents × the largest cost, and each bid must still be seen there.
    least = 4 * float(np.spacing(agents * np.abs(cost[alive]).max(initial=1e-300)))
    if not least < epsilon < np.inf:
        raise ValueError(
            f"the bid increment is {epsilon}: it must be finite and above {least:.1e}, "
            "below which prices of this size cannot show it"
        )
