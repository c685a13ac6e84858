"""Variable-swarm distributed auction algorithm, VSDAA [Morgan2016, Method 1].

`update_bidder` defines what one agent does in a round. `run_by_messages` plays it for all
agents; `run_vsdaa` computes the same with the compiled rounds of `vsdaa_kernel`.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from sato.auctions.bids import ANONYMOUS, NO_WINNER, OutOfTargets, WinningBids, merge_bids
from sato.auctions.vsdaa_kernel import init_state, run_kernel
from sato.network.graph import CommunicationGraph
from sato.network.rounds import flood, learn_diameter, run_rounds


class VsdaaBidder(NamedTuple):
    """Memory of one agent in an auction."""

    agent_id: int
    cost: Float[Array, " targets"]
    epsilon: float  # bid increment
    bidder_ids: bool  # True where bids carry the bidder's number
    patience: int  # quiet rounds after which it stops: 2 D
    target_count: int  # m
    bids: WinningBids  # its last message
    target_index: int = -1  # j, the target of its last bid
    quiet_rounds: int = 0  # rounds without news: the count of the printed method
    round: int = 0
    bid_count: int = 0


@dataclass(frozen=True, eq=False)
class VsdaaAuction:
    """Assignment of a target to every agent by messages between neighbors [Morgan2016, Method 1].

    In a component of N agents the total cost is within N ε of the optimum over the first
    max(N, m) targets, where m is the largest `target_count` of its agents. Components know
    nothing of each other, so two of them may choose the same target. Without `bidder_ids` it is
    the printed method, which may assign one target to two agents.

    Raises:
        ValueError: The shapes do not match, a cost is not finite, m is not in 1 … M, or ε is
            too small to show in prices of this size.
    """

    cost: Float[Array, "agents targets"]  # finite, also where a target is out of reach
    graph: CommunicationGraph  # while the auction lasts
    target_count: Int[Array, " agents"]  # m of each agent, the number of targets it would bid on
    epsilon: float  # bid increment ε, in the unit of the cost
    bidder_ids: bool = True  # True where bids carry the bidder's number, which breaks ties

    def __post_init__(self) -> None:
        """Refuse an auction that cannot end."""
        cost, alive, target_count = self.cost, self.graph.alive, self.target_count
        agents, targets = cost.shape
        if agents != len(alive) or agents != len(target_count):
            raise ValueError(
                f"costs for {agents} agents, a graph of {len(alive)}, m of {len(target_count)}: "
                "there must be a row and an m for every agent of the graph"
            )
        if not np.all(np.isfinite(cost[alive])):
            i, j = next((i, j) for i, j in np.argwhere(~np.isfinite(cost)) if alive[i])
            raise ValueError(
                f"the cost of target {j} for agent {i} is {cost[i, j]}: "
                "give an unreachable target a large finite cost"
            )
        wrong = np.flatnonzero(alive & ((target_count < 1) | (target_count > targets)))
        if len(wrong):
            raise ValueError(
                f"agent {wrong[0]} bids on {target_count[wrong[0]]} targets: "
                f"must be from 1 to the {targets} that are defined"
            )
        # Prices may climb to agents × the largest cost, and each bid must still be seen there.
        least = 4 * float(np.spacing(agents * np.abs(cost[alive]).max(initial=1e-300)))
        if not least < self.epsilon < np.inf:
            raise ValueError(
                f"the bid increment is {self.epsilon}: it must be finite and above {least:.1e}, "
                "below which prices of this size cannot show it"
            )


class VsdaaResult(NamedTuple):
    """Result of an auction."""

    target_index: Int[Array, " agents"]  # −1 where not alive
    target_count: Int[Array, " agents"]  # m, the number of targets bid on
    bidder_count: Int[Array, " agents"]  # bidders that the agent has heard of
    round_count: int  # from the first bid until the last agent stopped, after 4 D + 1 for D and m
    bid_count: int
    last_bid_round: int
    price: Float[Array, "agents targets"]  # signed, as each agent knows it


def update_bidder(agent: VsdaaBidder, inbox: list[WinningBids]) -> VsdaaBidder:
    """Merge the messages (lines 27-29) and bid where the agent holds no target (8-25).

    The printed loop listens at the end of a round, here the agent does so at the start of the
    next: the same sequence. Prices have the length M throughout, padded with zeros.

    With `bidder_ids` a bid stands as long as the agent knows itself as the winner. Without, it
    trusts the price alone (line 8), and of two equal bids both bidders believe to hold the target.

    Raises:
        OutOfTargets: The agent would add a target (line 11), and all M are in use.
    """
    bids = agent.bids
    for received in inbox:
        bids = merge_bids(bids, received)
    agent = agent._replace(round=agent.round + 1)
    if _is_outbid(agent, bids):
        return _place_bid(agent, bids)
    if np.array_equal(bids.price, agent.bids.price) and np.array_equal(
        bids.winner, agent.bids.winner
    ):
        return agent._replace(quiet_rounds=agent.quiet_rounds + 1)
    target_count = max(agent.target_count, int(np.count_nonzero(bids.price)))
    return agent._replace(bids=bids, target_count=target_count, quiet_rounds=0)


def is_finished(agent: VsdaaBidder) -> bool:
    """Return True once an agent has bid and then heard nothing new for 2 D rounds (line 7).

    No agent bids after that. Proof: let the agent's bids be B since round s. All agents know B
    from round s + D on. Every bid made before is in B, or the agent would have heard it by round
    s + 2 D. So at s + D all know B and nothing else. An agent that is outbid in B would bid in
    the next round, and the first agent would hear that too, in time.
    """
    return agent.target_index >= 0 and agent.quiet_rounds >= agent.patience


def _is_outbid(agent: VsdaaBidder, bids: WinningBids) -> bool:
    if agent.target_index < 0:
        return True
    if agent.bidder_ids:
        return bool(bids.winner[agent.target_index] != agent.agent_id)
    # Signed on purpose: a price negated at equal magnitude makes it bid a round later.
    return bool(abs(bids.price[agent.target_index]) > agent.bids.price[agent.target_index])


def _place_bid(agent: VsdaaBidder, known: WinningBids) -> VsdaaBidder:
    price, winner, epsilon = known.price.copy(), known.winner.copy(), agent.epsilon
    m = max(agent.target_count, int(np.count_nonzero(price)))
    if known.winner_count >= m:  # lines 10-12: one target more, and all are for sale again
        m = known.winner_count + 1
        if m > len(price):
            raise OutOfTargets(agent.agent_id, agent.round, len(price))
        price[:m] = -(np.abs(price[:m]) + epsilon)
        winner[:m] = NO_WINNER
    total = agent.cost[:m] + np.abs(price[:m])
    j = int(np.argmin(total))
    v = total[j]
    w = np.min(np.delete(total, j)) if m > 1 else v  # line 16 has no minimum for m = 1
    price[j] = abs(price[j]) + (w - v + epsilon)
    winner[j] = agent.agent_id if agent.bidder_ids else ANONYMOUS
    return agent._replace(
        bids=WinningBids(price, winner),
        target_count=m,
        target_index=j,
        quiet_rounds=0,
        bid_count=agent.bid_count + 1,
    )


def run_by_messages(auction: VsdaaAuction) -> Iterator[dict[int, VsdaaBidder]]:
    """Run the definition: yield every live agent after every round.

    Agents first learn the diameter of their component, then agree on the largest m, then bid.
    """
    cost, graph, target_count = auction.cost, auction.graph, auction.target_count
    diameter = learn_diameter(graph)
    live = np.flatnonzero(graph.alive).tolist()
    agreed = flood(graph, {i: int(target_count[i]) for i in live}, max)
    empty, rules = WinningBids.empty(cost.shape[1]), (auction.epsilon, auction.bidder_ids)
    bidders = {
        i: VsdaaBidder(i, cost[i], *rules, 2 * int(diameter[i]), agreed[i], empty) for i in live
    }
    return run_rounds(graph, bidders, update_bidder, lambda agent: agent.bids, is_finished)


def run_vsdaa(auction: VsdaaAuction) -> VsdaaResult:
    """Run the auction with the compiled rounds.

    Raises:
        OutOfTargets: A component has more agents than there are targets.
    """
    state = init_state(auction.cost, auction.graph, auction.target_count)
    for _ in run_kernel(state, auction.epsilon, auction.bidder_ids):
        pass
    stopped = np.where(auction.graph.alive, state.last_news_round + state.patience, 0)
    return VsdaaResult(
        target_index=state.target_index,
        target_count=state.target_count,
        bidder_count=np.count_nonzero(state.winner != NO_WINNER, axis=1),
        round_count=int(stopped.max(initial=0)),
        bid_count=int(state.bid_count.sum()),
        last_bid_round=int(state.last_bid_round.max(initial=0)),
        price=state.price,
    )
