"""Consensus-based auction algorithm, CBAA: one point for every agent [Choi2009].

`update_bidder` defines what one agent does in a round. `run_by_messages` plays it for all
agents, with messages that may be late or lost; `run_cbaa` computes the same with the compiled
rounds of `cbaa_kernel`.
"""

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from numpy import ndarray as Array

from sato.auctions.bids import WinningBids, find_newer_bids, merge_bids
from sato.auctions.cbaa_kernel import init_state, run_kernel
from sato.network.graph import CommunicationGraph
from sato.network.rounds import run_round

UNLIMITED_ROUNDS = 2**62  # rounds


class CbaaBidder(NamedTuple):
    """Memory of one agent in an auction."""

    agent_id: int
    score: Float[Array, " points"]  # value of each point to the agent
    agent_count: int  # number of live agents
    bids: WinningBids  # its last message
    point: int = -1  # the point of its last bid


@dataclass(frozen=True, eq=False)
class CbaaAuction:
    """Assignment of a point to every agent by messages between neighbors [Lusk2020, sec. IV-B].

    The result equals the greedy choice: the largest of all scores, then the largest that shares
    neither agent nor point with it, and so on; of equal ones the smaller agent, then the smaller
    point. Hence at least half of the best total score [Choi2009], and only the order of the
    scores matters. With D the diameter of the graph, all agents know it by round
    (delay + 1) n D + 1, which listens (delay + 1) n D times; each stops by itself.

    Messages that are lost or late only cost time: every round sends all that an agent knows.
    But an agent that knows the end must go on sending it, since others may not have heard, and
    no message can tell it when to stop: then all go on for `rounds`. Agents that know the end
    by then never claim each other's points. Claims of others may still be wrong;
    `CbaaResult.is_conflict_free` and `CbaaResult.has_consensus` tell.

    Raises:
        ValueError: The shapes do not match, a score is not positive and finite, the graph is not
            connected, or messages can be lost and `rounds` or `rng` is missing.
    """

    score: Float[Array, "agents points"]  # value of each point to each agent
    graph: CommunicationGraph  # while the auction lasts
    rounds: int | None = None  # largest number of rounds; None: until all agents know the end
    loss: float = 0.0  # probability that a message is lost
    delay: int = 0  # rounds by which each message comes later than in the next round
    rng: np.random.Generator | None = None  # draws the lost messages

    def __post_init__(self) -> None:
        """Refuse an auction that cannot end."""
        (agents, points), alive = self.score.shape, self.graph.alive
        if agents != len(alive) or not 0 < np.count_nonzero(alive) <= points:
            raise ValueError(
                f"scores of {points} points for {agents} agents, a graph of {len(alive)} of which "
                f"{np.count_nonzero(alive)} are alive: there must be a row for every agent of the "
                "graph, and a point for each that is alive"
            )
        wrong = np.argwhere(alive[:, None] & ~((self.score > 0) & np.isfinite(self.score)))
        if len(wrong):
            i, j = wrong[0]
            raise ValueError(
                f"the score of point {j} for agent {i} is {self.score[i, j]}: scores must be "
                "positive and finite; with 1 / d², add a small number to d²"
            )
        _validate_connected(self.graph)
        loss, rounds = self.loss, self.rounds
        if not (0 <= loss < 1 and self.delay >= 0 and (rounds is None or rounds > 0)):
            raise ValueError(
                f"a loss of {loss}, a delay of {self.delay} rounds, at most {rounds} rounds: "
                "the loss must be in [0, 1), the delay no less than 0, the rounds positive"
            )
        if loss > 0 and (self.rng is None or rounds is None):
            raise ValueError(
                "where messages can be lost, an agent that knows the end cannot know whether the "
                "others do: give the number of rounds after which all stop, and the generator rng "
                "that draws the losses"
            )


@dataclass(frozen=True, eq=False)
class CbaaResult:
    """Result of an auction, with the bids that prove it."""

    point: Int[Array, " agents"]  # claimed by each agent; −1 where not alive
    finished_round: Int[Array, " agents"]  # round in which it knew that this is final; 0 for never
    price: Float[Array, "agents points"]  # as each agent knows it
    winner: Int[Array, "agents points"]
    round_count: int
    message_count: int  # messages sent, each to one neighbor

    @property
    def is_conflict_free(self) -> bool:
        """True where no two agents claim the same point."""
        claimed = self.point[self.point >= 0]
        return len(np.unique(claimed)) == len(claimed)

    @property
    def has_consensus(self) -> bool:
        """True where all agents know the same bids, which give each the point it claims."""
        live = np.flatnonzero(self.point >= 0)
        price, winner = self.price[live], self.winner[live]
        same = np.all(price == price[:1]) and np.all(winner == winner[:1])
        return bool(same and np.all(winner[np.arange(len(live)), self.point[live]] == live))


def update_bidder(agent: CbaaBidder, inbox: list[WinningBids]) -> CbaaBidder:
    """Merge the messages and bid where the agent holds no point [Lusk2020, sec. IV-B].

    It bids its own score on the point of the largest score among those where it beats the
    standing bid; of two equal scores the smaller agent wins. There is always such a point: no
    agent holds two (see `is_finished`), so an agent that holds none knows one without a winner.
    The printed loop listens at the end of a round, here the agent does so at the start of the
    next: the same sequence.
    """
    bids = agent.bids
    for received in inbox:
        bids = merge_bids(bids, received)
    if agent.point >= 0 and bids.winner[agent.point] == agent.agent_id:
        return agent._replace(bids=bids)
    return _place_bid(agent, bids)


def is_finished(agent: CbaaBidder) -> bool:
    """Return True once the agent knows a winner for as many points as there are agents.

    That alone proves that the auction is over. No quiet rounds are needed and no diameter, and
    it holds as well where messages are lost, late or out of order. Call the bids that an agent
    knows its table:

    1. Only c places bids of c, and tables are sent whole. So a table with a bid of c contains,
       entry by entry, no less than the table of c right after that bid.
    2. No table has two points of one agent c. It bid on the second only when another's bid
       on the first was in its table, and by 1 that came along.
    3. Let B be a table in which every agent holds a point, and suppose that some agent bids
       after its bid in B. Let b be the first to do so, and j its point in B: it was outbid
       there by some c. That was not the bid of c in B, which is on another point. Nor a
       later one, for b is the first. Nor an earlier one: by 1, B would have it in place of
       b's. So no agent ever bids again, and by 1 all bids ever placed are in B or outbid in it.

    Hence all such tables are the same, and final. On a graph of diameter D every agent has
    it in round n D + 1 at the latest, which listens n D times [Choi2009]: the largest score
    of all is bid at once and known to all D rounds later, then the largest of the rest.
    """
    return agent.bids.winner_count == agent.agent_count


def _place_bid(agent: CbaaBidder, known: WinningBids) -> CbaaBidder:
    own = WinningBids(agent.score, np.full_like(known.winner, agent.agent_id))
    wins = find_newer_bids(known, own)
    point = int(np.argmax(np.where(wins, agent.score, 0.0)))
    price, winner = known.price.copy(), known.winner.copy()
    price[point], winner[point] = agent.score[point], agent.agent_id
    return agent._replace(bids=WinningBids(price, winner), point=point)


def run_by_messages(auction: CbaaAuction) -> Iterator[dict[int, CbaaBidder]]:
    """Run the definition: yield every live agent after every round."""
    score, graph, rng, loss = auction.score, auction.graph, auction.rng, auction.loss
    agents, points = score.shape
    live = np.flatnonzero(graph.alive).tolist()
    now = {i: CbaaBidder(i, score[i], len(live), WinningBids.empty(points)) for i in live}
    messages = {i: agent.bids for i, agent in now.items()}
    on_their_way = deque([messages] * (auction.delay + 1), maxlen=auction.delay + 1)
    for _ in range(auction.rounds or UNLIMITED_ROUNDS):
        updated: dict[int, CbaaBidder] = {}
        for i in live:
            if not is_finished(now[i]):
                messages = on_their_way[0]
                if rng is not None and loss > 0:
                    lost = np.asarray(rng.random(agents) < loss)
                    messages = {j: bids for j, bids in messages.items() if not lost[j]}
                updated |= run_round(graph, {i: now[i]}, update_bidder, messages)
        if not updated:
            return
        now = now | updated
        on_their_way.append({i: agent.bids for i, agent in now.items()})
        yield now


def run_cbaa(auction: CbaaAuction) -> CbaaResult:
    """Run the auction with the compiled rounds."""
    state = init_state(auction.score, auction.graph, auction.delay)
    # Without losses nothing is drawn from the generator, whichever it is.
    rng = auction.rng or np.random.default_rng(0)
    run_kernel(state, auction.rounds or UNLIMITED_ROUNDS, auction.loss, rng)
    played = int(state.round[0])
    sending = np.where(state.finished_round > 0, state.finished_round, played)
    if auction.loss > 0:
        sending = np.full(len(auction.score), auction.rounds)
    return CbaaResult(
        point=state.point,
        finished_round=state.finished_round,
        price=state.price,
        winner=state.winner,
        round_count=played,
        message_count=int(sending @ auction.graph.adjacency.sum(axis=1)),
    )


def _validate_connected(graph: CommunicationGraph) -> None:
    # Cheaper than `graph.component`, which takes as long as the auction itself.
    reached = np.arange(len(graph.alive)) == np.argmax(graph.alive)
    while np.any(news := graph.adjacency[reached].any(axis=0) & ~reached):
        reached |= news
    if np.any(apart := graph.alive & ~reached):
        lost, *_ = np.flatnonzero(apart)
        raise ValueError(
            f"no message gets from agent {np.argmax(graph.alive)} to agent {lost}: the components "
            "of a graph that is not connected would assign the same points; connect it"
        )
