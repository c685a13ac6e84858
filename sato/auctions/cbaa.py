"""Consensus-based auction algorithm, CBAA: one point for every agent [Choi2009].

What one agent does in a round [Lusk2020, sec. IV-B]: it merges the bids that it hears, and where
it holds no point, bids its own score on the point of the largest score among those where it beats
the standing bid; of two equal scores the smaller agent wins. There is always such a point: no
agent holds two (see 2 below), so an agent that holds none knows one without a winner. The printed
loop listens at the end of a round, here the agent does so at the start of the next: the same
sequence. It has finished once it knows a winner for as many points as there are agents.

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

The rounds of all agents are compiled: agent i reads and writes its own row of `CbaaState`, and
reads what its neighbors have sent. A message is merged only if it has changed since the receiver
last heard it: merging the same again changes nothing. Tests compare the rounds
with those of `CbaaBidder`, one agent with its memory and inbox.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple, no_type_check

import numpy as np
from annotated_types import Ge, Gt, Lt
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array

from dynamics.doors import MAY_BE_NAN, checked
from dynamics.inputs import InputError
from problems.kernels import compiled
from sato.auctions.vsdaa import NO_WINNER
from sato.network.graph import CommunicationGraph

UNLIMITED_ROUNDS = 2**62  # rounds
NO_OUTAGES = np.zeros((0, 0, 0), dtype=np.bool_)


@checked
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

    score: Annotated[Float[Array, "agents points"], MAY_BE_NAN]  # value of each point to each agent
    graph: CommunicationGraph  # while the auction lasts
    # Largest number of rounds; None: until all agents know the end.
    rounds: Annotated[int, Gt(0)] | None = None
    loss: Annotated[float, Ge(0), Lt(1)] = 0.0  # probability that a message is lost
    # Rounds by which each message comes later than in the next round.
    delay: Annotated[int, Ge(0), Lt(10_000)] = 0
    rng: np.random.Generator | None = None  # draws the lost messages
    # True for pairs between which messages are lost that would arrive in a round.
    outages: Bool[Array, "rounds agents agents"] | None = None

    def __post_init__(self) -> None:
        """Refuse an auction that cannot end."""
        (agents, points), alive = self.score.shape, self.graph.alive
        bidders = np.count_nonzero(alive)
        if agents != len(alive) or not 0 < bidders <= points:
            text = f"{points} points for {agents} agents, {bidders} of {len(alive)} in the graph"
            raise ValueError(f"{text} alive: each agent needs a row, and each live one a point")
        wrong = np.argwhere(alive[:, None] & ~((self.score > 0) & np.isfinite(self.score)))
        if len(wrong):
            i, j = wrong[0]
            text = f"the score of point {j} for agent {i} is {self.score[i, j]}"
            raise ValueError(f"{text}: must be positive and finite; with 1 / d², add to d²")
        apart = self.graph.component > 0
        if apart.any():
            text = f"no message gets from agent {np.argmax(alive)} to agent {np.argmax(apart)}"
            cure = "two components would assign the same points; connect the graph"
            raise ValueError(f"{text}: {cure}")
        loss, rounds = self.loss, self.rounds
        if self.outages is not None and rounds is not None and len(self.outages) < rounds:
            text = f"must be given for all {rounds} rounds, got {len(self.outages)}"
            raise InputError("outages", text)
        is_lossy = loss > 0 or self.outages is not None
        if is_lossy and (self.rng is None or rounds is None):
            text = "give the number of rounds after which all stop, and the generator rng"
            raise ValueError(f"with losses no agent knows whether the others have ended: {text}")


@dataclass(frozen=True, eq=False)
class CbaaResult:
    """Result of an auction, with the bids that prove it."""

    point: Int[Array, " agents"]  # claimed by each agent; −1 where not alive
    finished_round: Int[Array, " agents"]  # round in which it knew that this is final; 0 for never
    price: Float[Array, "agents points"]  # as each agent knows it
    winner: Int[Array, "agents points"]
    round_count: int

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


@checked
def run_cbaa(auction: CbaaAuction) -> CbaaResult:
    """Run the auction."""
    state = init_state(auction.score, auction.graph, auction.delay)
    # Without losses nothing is drawn from the generator, whichever it is.
    rng = auction.rng or np.random.default_rng(0)
    is_down = NO_OUTAGES if auction.outages is None else auction.outages
    run_rounds(state, auction.rounds or UNLIMITED_ROUNDS, auction.loss, rng, is_down)
    rounds = int(state.round[0])
    return CbaaResult(state.point, state.finished_round, state.price, state.winner, rounds)


class CbaaState(NamedTuple):
    """Memory of all agents in an auction, changed in place from round to round."""

    score: Float[Array, "agents points"]
    adjacency: Bool[Array, "agents agents"]
    price: Float[Array, "agents points"]
    winner: Int[Array, "agents points"]
    point: Int[Array, " agents"]
    winner_count: Int[Array, " agents"]  # standing bids that each agent knows
    version: Int[Array, " agents"]  # number of changes to what each agent knows
    seen_version: Int[Array, "agents agents"]  # version that [i] last heard from [j]
    sent_price: Float[Array, "slots agents points"]  # of round r in slot r mod (delay + 1)
    sent_winner: Int[Array, "slots agents points"]
    sent_version: Int[Array, "slots agents"]
    is_running: Bool[Array, " agents"]  # True while an agent does not know the end
    finished_round: Int[Array, " agents"]  # round in which it knew the end; 0 for not yet
    round: Int[Array, " 1"]


def init_state(
    score: Float[Array, "agents points"], graph: CommunicationGraph, delay: int
) -> CbaaState:
    """Initialize all agents, for messages that are `delay` rounds late."""
    agents, points = score.shape
    count, version, finished_round = np.zeros((3, agents), dtype=np.int64)
    return CbaaState(
        score=np.ascontiguousarray(score, dtype=np.float64),
        adjacency=np.ascontiguousarray(graph.adjacency),
        price=np.zeros((agents, points)),
        winner=np.full((agents, points), NO_WINNER),
        point=np.full(agents, -1),
        winner_count=count,
        version=version,
        seen_version=np.zeros((agents, agents), dtype=np.int64),
        sent_price=np.zeros((delay + 1, agents, points)),
        sent_winner=np.full((delay + 1, agents, points), NO_WINNER),
        sent_version=np.zeros((delay + 1, agents), dtype=np.int64),
        is_running=graph.alive.copy(),
        finished_round=finished_round,
        round=np.zeros(1, dtype=np.int64),
    )


@compiled()
@no_type_check
def run_rounds(s, rounds, loss, rng, is_down):
    """Run at most so many rounds more, until all agents know the end.

    The memory s of all agents, a `CbaaState`, is changed in place. Losses are drawn only where
    messages can be lost: once for each agent that does not know the end and each agent of the
    swarm, in order. Pairs may be down in a round; without rounds, none is.
    """
    agents = len(s.is_running)
    bidders = np.count_nonzero(s.is_running) + np.count_nonzero(s.finished_round)
    for _ in range(rounds):
        if not s.is_running.any():
            return
        s.round[0] += 1
        slot = s.round[0] % len(s.sent_version)  # holds the oldest messages on their way
        for i in range(agents):
            if s.is_running[i]:
                changed = _merge_inbox(i, slot, loss, rng, is_down, s)
                if s.point[i] < 0 or s.winner[i, s.point[i]] != i:
                    _place_bid(i, s)
                    changed = True
                s.version[i] += changed
                if s.winner_count[i] == bidders:
                    s.is_running[i], s.finished_round[i] = False, s.round[0]
        for i in range(agents):
            if s.sent_version[slot, i] < s.version[i]:
                s.sent_price[slot, i], s.sent_winner[slot, i] = s.price[i], s.winner[i]
                s.sent_version[slot, i] = s.version[i]


@compiled()
@no_type_check
def _merge_inbox(i, slot, loss, rng, is_down, s):
    # Merge the messages that arrive at agent i; True where that changed what it knows.
    price, winner, changed = s.price[i], s.winner[i], False
    for a in range(len(s.is_running)):
        lost = loss > 0 and rng.random() < loss
        lost |= len(is_down) > 0 and is_down[s.round[0] - 1, i, a]
        if lost or not s.adjacency[i, a] or s.sent_version[slot, a] <= s.seen_version[i, a]:
            continue
        s.seen_version[i, a] = s.sent_version[slot, a]
        sent_price, sent_winner = s.sent_price[slot, a], s.sent_winner[slot, a]
        for j in range(len(price)):
            if sent_price[j] > price[j] or (
                sent_price[j] == price[j] and sent_winner[j] < winner[j]
            ):
                s.winner_count[i] += price[j] == 0
                price[j], winner[j], changed = sent_price[j], sent_winner[j], True
    return changed


@compiled()
@no_type_check
def _place_bid(i, s):
    price, winner, score = s.price[i], s.winner[i], s.score[i]
    best, most = -1, 0.0
    for j in range(len(price)):
        wins = score[j] > price[j] or (score[j] == price[j] and i < winner[j])
        if wins and score[j] > most:
            best, most = j, score[j]
    s.winner_count[i] += price[best] == 0
    price[best], winner[best], s.point[i] = most, i, best
