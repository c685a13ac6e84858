"""Variable-swarm distributed auction algorithm, VSDAA [Morgan2016, Method 1].

In a round an agent merges the bids that it hears (lines 27-29), and bids where it holds no target
(8-25). Of two bids on a target the larger |price| is the newer; a negative price was a bid on a
target that is for sale again, and wins over an equal one; of two equal bids that of the smaller
agent stands. An agent stops once it has bid and then heard nothing new for 2 D rounds (line 7), D
the diameter of its component. No agent bids after that. Proof: let the agent's bids be B since
round s. All agents know B from round s + D on. Every bid made before is in B, or the agent would
have heard it by round s + 2 D. So at s + D all know B and nothing else. An agent that is outbid in
B would bid in the next round, and the first agent would hear that too, in time.

The rounds of all agents are compiled. What an agent knows only grows, in the order of bids, and
news travels one hop a round. So the bids known to agent i after round r are the merge of all bids
that an agent a placed in a round t with t + hops(a, i) ≤ r. No tables are passed around: an agent
merges what has arrived when it acts, which is while it holds no target or one that is for sale
again, and when a bid on its target arrives; and all merge at a pause and at the end. Tests compare
the rounds with those of `VsdaaBidder`, one agent with its memory and inbox.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Annotated, NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Int, Num
from numpy import ndarray as Array

from dynamics.doors import MAY_BE_NAN, checked
from dynamics.inputs import InputError
from problems.kernels import compiled
from sato.network.graph import FAR, CommunicationGraph

NO_WINNER = -1  # winner of a target without a standing bid
ANONYMOUS = 0  # winner of every standing bid where bids carry no number
MIN_ROOM = 100_000  # for bids in the log
CACHE_LINE = 8  # numbers
FIRST_SLACK = 0.5  # of ε, by which the first bid of an opening may be dearer than another
DONE, RUNNING, LOG_FULL = 0, 1, 2  # outcomes of `_advance`; −1 − i: agent i found no target


class OutOfTargets(RuntimeError):
    """Failure of an auction: all targets are taken, and an agent has none."""

    def __init__(self, agent: int, round: int, targets: int) -> None:
        """Keep the agent, the round in which it found out, and the number of targets."""
        found = f"agent {agent} found all {targets} targets taken in round {round}"
        reason = "its component has more agents than there are targets"
        super().__init__(f"{found}: {reason}; define more targets")
        self.agent, self.round, self.targets = agent, round, targets


@checked
@dataclass(frozen=True, eq=False, init=False)
class VsdaaAuction:
    """Assignment of a target to every agent by messages between neighbors [Morgan2016, Method 1].

    In a component of N agents the total cost is within N ε of the optimum over the first
    max(N, m) targets, where m is the largest `target_count` of its agents. Components know
    nothing of each other, so two of them may choose the same target. Without `bidder_ids` it is
    the printed method, which may assign one target to two agents.

    The graph may be given by its adjacency matrix, or None where it is complete, and m by one
    number for all.

    Raises:
        ValueError: The shapes do not match, a cost is not finite, m is not in 1 … M, or ε is
            too small to show in prices of this size.
    """

    cost: Num[Array, "agents targets"]  # finite, also where a target is out of reach
    graph: CommunicationGraph  # while the auction lasts
    target_count: Int[Array, " agents"]  # m of each agent, the number of targets it would bid on
    epsilon: float  # bid increment ε, in the unit of the cost
    bidder_ids: bool = True  # True where bids carry the bidder's number, which breaks ties
    opening: "Opening | None" = None  # None: without prices

    def __init__(
        self,
        cost: Annotated[Float[Array, "agents targets"], MAY_BE_NAN],
        graph: CommunicationGraph | Bool[Array, "agents agents"] | None,
        target_count: Int[Array, " agents"] | int,
        epsilon: float,
        bidder_ids: bool = True,
        opening: "Opening | None" = None,
    ) -> None:
        agents = len(cost)
        if not isinstance(graph, CommunicationGraph):
            hears = ~np.eye(agents, dtype=bool) if graph is None else graph
            graph = CommunicationGraph(hears, np.ones(agents, dtype=bool))
        count = np.full(agents, target_count) if isinstance(target_count, int) else target_count
        real = np.asarray(cost, dtype=float)  # of any numbers
        self.__dict__.update(cost=real, graph=graph, target_count=count, epsilon=epsilon)
        self.__dict__.update(bidder_ids=bidder_ids, opening=opening)
        self._check()

    def _check(self) -> None:
        """Refuse an auction that cannot end."""
        cost, alive, target_count = self.cost, self.graph.alive, self.target_count
        agents, targets = cost.shape
        if not np.all(np.isfinite(cost[alive])):
            i, j = next((i, j) for i, j in np.argwhere(~np.isfinite(cost)) if alive[i])
            reason = f"the cost of target {j} for agent {i} is {cost[i, j]}"
            raise ValueError(f"{reason}: give an unreachable target a large finite cost")
        wrong = np.flatnonzero(alive & ((target_count < 1) | (target_count > targets)))
        if len(wrong):
            reason = f"agent {wrong[0]} bids on {target_count[wrong[0]]} targets"
            raise ValueError(f"{reason}: must be from 1 to the {targets} that are defined")
        if self.opening is not None:
            price, first = self.opening
            if price.max(initial=0.0) > 0 or not ((first >= -1) & (first < targets)).all():
                text = f"must have prices of at most 0, and targets from -1 to {targets - 1}"
                raise InputError("opening", text)
        # Prices may climb to agents × the largest cost, and each bid must still be seen there.
        least = 4 * float(np.spacing(agents * np.abs(cost[alive]).max(initial=1e-300)))
        if not least < self.epsilon < np.inf:
            reason = f"the bid increment is {self.epsilon}: it must be finite and above {least:.1e}"
            raise ValueError(f"{reason}, below which prices of this size cannot show it")


@checked
class Opening(NamedTuple):
    """Beginning of an auction: what each agent knows without a bid."""

    price: Float[Array, "agents targets"]  # of targets that are for sale, at most 0
    target_index: Int[Array, " agents"]  # first bid, see `FIRST_SLACK`; −1 none

    @property
    def array_sizes(self) -> dict[str, int]:
        """Sizes of the axes of arrays, by name."""
        return dict(zip(("agents", "targets"), self.price.shape, strict=True))

    @classmethod
    def empty(cls, agents: int, targets: int) -> "Opening":
        """Make an opening without prices."""
        return cls(np.zeros((agents, targets)), np.full(agents, -1))

    def without(self, agents: Bool[Array, " agents"]) -> "Opening":
        """Drop what some agents know."""
        price, target_index = np.where(agents[:, None], 0.0, self.price), self.target_index
        return Opening(price, np.where(agents, -1, target_index))


class VsdaaResult(NamedTuple):
    """Result of an auction."""

    target_index: Int[Array, " agents"]  # −1 where not alive
    target_count: Int[Array, " agents"]  # m, the number of targets bid on
    bidder_count: Int[Array, " agents"]  # bidders that the agent has heard of
    round_count: int  # from the first bid until the last agent stopped, after 4 D + 1 for D and m
    bid_count: int
    last_bid_round: int
    stop_round: Int[Array, " agents"]  # in which each agent stopped
    price: Float[Array, "agents targets"]  # signed, as each agent knows it
    message_count: Int[Array, " agents"]  # rounds after which the agent has news to tell
    entry_count: Int[Array, " agents"]  # prices that have changed, over all of these


@checked
def run_vsdaa(auction: VsdaaAuction) -> VsdaaResult:
    """Run the auction with the compiled rounds.

    Raises:
        OutOfTargets: A component has more agents than there are targets.
    """
    state = init_state(auction.cost, auction.graph, auction.target_count, auction.opening)
    dropped: list[BidLog] = []
    for _ in run_kernel(state, auction.epsilon, auction.bidder_ids, dropped):
        pass
    stopped = np.where(auction.graph.alive, state.last_news_round + state.patience, 0)
    return VsdaaResult(
        target_index=state.target_index,
        target_count=state.target_count,
        bidder_count=np.count_nonzero(state.winner != NO_WINNER, axis=1),
        round_count=int(stopped.max(initial=0)),
        bid_count=int(state.bid_count.sum()),
        last_bid_round=int(state.last_bid_round.max(initial=0)),
        stop_round=stopped,
        price=state.price,
        **_count_news(state, dropped),
    )


def _count_news(state: "VsdaaState", logs: Sequence["BidLog"]) -> dict[str, Int[Array, " agents"]]:
    """Count the changes of each agent's prices, and the rounds after which there are any.

    A bid changes what an agent knows if it arrives before every newer one on its target.
    """
    columns = [np.concatenate(parts) for parts in list(zip(*logs, strict=True))[:5]]
    _, _, target, winner, price = columns
    order = np.lexsort((winner, -np.abs(price), target))  # of each target the newest first
    agent, round, target, winner, price = (column[order] for column in columns)
    is_other, is_same = np.ones((2, len(agent)), dtype=bool)
    is_other[1:] = target[1:] != target[:-1]
    is_same[1:] = (price[1:] == price[:-1]) & (winner[1:] == winner[:-1]) & ~is_other[1:]
    counts = np.zeros((2, len(state.alive)), dtype=np.int64)
    told = np.full(int(round.max(initial=0)) + int(state.most_hops[0]) + 1, -1, dtype=np.int32)
    _count_changes(state.hops, told, agent, round, is_other, is_same, *counts)
    return {"message_count": counts[0], "entry_count": counts[1]}


@compiled()
@no_type_check
def _count_changes(hops, told, agent, round, is_other, is_same, messages, entries):
    for i in range(len(hops)):
        own, k, first, changes, rounds = hops[i], 0, FAR, 0, 0
        while k < len(agent):
            first = FAR if is_other[k] else first
            at = round[k] + own[agent[k]]
            k += 1
            while k < len(agent) and is_same[k]:
                at = min(at, round[k] + own[agent[k]])
                k += 1
            if at < first:
                first = at
                changes += 1
                rounds += told[at] != i
                told[at] = i
        entries[i], messages[i] = changes, rounds


class VsdaaState(NamedTuple):
    """Memory of all agents in an auction, changed in place from round to round."""

    cost: Float[Array, "agents targets"]
    alive: Bool[Array, " agents"]
    hops: Int[Array, "agents agents"]  # FAR between components
    most_hops: Int[Array, " 1"]  # between two agents of a component
    patience: Int[Array, " agents"]
    price: Float[Array, "agents targets"]
    winner: Int[Array, "agents targets"]
    price_count: Int[Array, " agents"]  # nonzero prices that each agent knows
    winner_count: Int[Array, " agents"]  # standing bids that each agent knows
    target_count: Int[Array, " agents"]
    target_index: Int[Array, " agents"]
    first_target: Int[Array, " agents"]  # of the opening
    sent_price: Float[Array, " agents"]  # price of the agent's target in its last message
    last_news_round: Int[Array, " agents"]  # round of the last bid or news
    last_bid_round: Int[Array, " agents"]
    bid_count: Int[Array, " agents"]
    merged_round: Int[Array, " agents"]  # up to which an agent has merged what arrived
    merged_bid: Int[Array, " agents"]  # first bid in the log that it may not have merged
    has_news: Bool[Array, " agents"]  # True where a bid on the agent's target arrives
    first_holder: Int[Array, " targets"]  # of the agents that hold a target, −1 none
    next_holder: Int[Array, " agents"]  # of the same target, −1 none
    arrival: Int[Array, " targets"]  # scratch: round in which news of a target arrived, −1 none
    changed: Int[Array, " targets"]  # scratch: targets of which there are news
    round: Int[Array, " 1"]
    turn: Int[Array, " 1"]  # agent that acts next in this round; −1 between rounds


class BidLog(NamedTuple):
    """Bids that some agent may not have merged, in the order in which they were placed."""

    agent: Int[Array, " room"]  # by which the bid was placed
    round: Int[Array, " room"]
    target: Int[Array, " room"]
    winner: Int[Array, " room"]
    price: Float[Array, " room"]
    arrived: Int[Array, " room"]  # scratch: bids that an agent merges
    size: Int[Array, " 2"]  # first bid on its way, number of bids

    @classmethod
    def empty(cls, room: int) -> "BidLog":
        """Allocate a log for so many bids."""
        agent, round, target, winner, arrived = (np.empty(room, dtype=np.int32) for _ in range(5))
        size = np.zeros(2, dtype=np.int64)
        return cls(agent, round, target, winner, np.empty(room), arrived, size)

    def select(self, end: int) -> "BidLog":
        """Return a copy of the first bids."""
        return BidLog(*(part[:end].copy() for part in self))._replace(size=np.array([0, end]))


def init_state(
    cost: Array, graph: CommunicationGraph, target_count: Array, opening: Opening | None = None
) -> VsdaaState:
    """Initialize all agents, with the largest m of their component."""
    agents, targets = cost.shape
    ints = [np.zeros(agents, dtype=np.int64) for _ in range(6)]
    opening = opening or Opening.empty(agents, targets)
    return VsdaaState(
        cost=np.ascontiguousarray(cost, dtype=np.float64),
        alive=graph.alive,
        hops=graph.hops,
        most_hops=graph.diameter.max(initial=0, keepdims=True),
        patience=2 * graph.diameter,
        price=np.array(opening.price, dtype=np.float64),
        winner=np.full((agents, targets), NO_WINNER, dtype=np.int32),
        price_count=np.count_nonzero(opening.price, axis=1),
        winner_count=ints[0],
        target_count=graph.component_max(np.asarray(target_count, dtype=np.int64)),
        target_index=np.full(agents, -1),
        first_target=np.asarray(opening.target_index, dtype=np.int64),
        sent_price=np.zeros(agents),
        last_news_round=ints[1],
        last_bid_round=ints[2],
        bid_count=ints[3],
        merged_round=ints[4],
        merged_bid=ints[5],
        has_news=np.zeros(agents, dtype=bool),
        first_holder=np.full(targets, -1),
        next_holder=np.full(agents, -1),
        arrival=np.full(targets, -1),
        changed=np.zeros(targets, dtype=np.int64),
        round=np.zeros(1, dtype=np.int64),
        turn=np.full(1, -1),
    )


def run_kernel(
    state: VsdaaState, epsilon: float, bidder_ids: bool, dropped: list[BidLog], stride: int = 2**62
) -> Iterator[None]:
    """Run all rounds in which something happens, pausing after every `stride` of them.

    All bids are appended to `dropped`, a log after another.
    """
    targets = state.cost.shape[1]
    log = BidLog.empty(MIN_ROOM + 2 * targets)
    while True:
        before, last_round = int(state.round[0]), int(state.round[0]) + stride
        rules = last_round, float(epsilon), bidder_ids
        while (outcome := _advance(*rules, state, log)) == LOG_FULL:
            dropped.append(log.select(int(log.size[0])))
            log = _make_room(state, log)
        if outcome < 0:
            raise OutOfTargets(-1 - outcome, int(state.round[0]), targets)
        if state.round[0] > before:
            yield
        if outcome == DONE:
            dropped.append(log.select(int(log.size[1])))
            return


def _make_room(state: VsdaaState, log: BidLog) -> BidLog:
    """Drop the bids that have reached all agents, and double the log where that is not enough.

    All agents have merged them, as `_advance` does for all before it returns.
    """
    first, end = log.size
    room = len(log.agent)
    wider = BidLog.empty(room if 2 * (end - first) < room else 2 * room)
    for new, old in zip(wider[:5], log[:5], strict=True):
        new[: end - first] = old[first:end]
    wider.size[1] = end - first
    state.merged_bid[:] = np.maximum(state.merged_bid - first, 0)
    return wider


@compiled()
@no_type_check
def _advance(last_round, epsilon, bidder_ids, s, log):
    agents, targets = s.cost.shape
    # Local names, since numba counts references to every array of a tuple that is passed on.
    alive, target, sent, has_news = s.alive, s.target_index, s.sent_price, s.has_news
    outcome = RUNNING
    while outcome == RUNNING and (s.turn[0] >= 0 or s.round[0] < last_round):
        if s.turn[0] < 0:
            s.round[0], s.turn[0] = s.round[0] + 1, 0
            _announce(s, log)
        is_active = False
        for i in range(s.turn[0], agents):
            if alive[i] and (has_news[i] or target[i] < 0 or sent[i] < 0):
                if log.size[1] + targets + 1 > len(log.agent):
                    s.turn[0], outcome = i, LOG_FULL
                    break
                has_news[i] = False
                _merge(i, s, log)
                j = target[i]
                is_outbid = j < 0 or (
                    s.winner[i, j] != i if bidder_ids else abs(s.price[i, j]) > sent[i]
                )
                if is_outbid and not _place_bid(i, epsilon, bidder_ids, s, log):
                    return -1 - i
                sent[i] = s.price[i, target[i]]
        if outcome == LOG_FULL:
            break
        s.turn[0] = -1
        for i in range(agents):
            is_active = is_active or sent[i] < 0
        if log.size[0] == log.size[1] and not is_active:
            outcome = DONE
    for i in range(agents):
        _merge(i, s, log)
    return outcome


@compiled()
@no_type_check
def _announce(s, log):
    # A bid placed d rounds ago arrives d hops away from its bidder: there it is news for those
    # that hold its target.
    round = s.round[0]
    while log.size[0] < log.size[1] and round - log.round[log.size[0]] > s.most_hops[0]:
        log.size[0] += 1
    for k in range(log.size[0], log.size[1]):
        i, d = s.first_holder[log.target[k]], round - log.round[k]
        while i >= 0:
            s.has_news[i] = s.has_news[i] or s.hops[i, log.agent[k]] == d
            i = s.next_holder[i]


@compiled()
@no_type_check
def _merge(i, s, log):
    # What has arrived since the last time. News of a target are of the round in which the bid
    # that stands now arrived first.
    round, merged, count, number = s.round[0], s.merged_round[i], 0, 0
    price, winner, hops, arrival, changed = s.price[i], s.winner[i], s.hops[i], s.arrival, s.changed
    agents, rounds, arrived = log.agent, log.round, log.arrived
    for k in range(log.size[1] - 1, s.merged_bid[i] - 1, -1):  # newest first: few change a price
        at = rounds[k] + hops[agents[k]]
        arrived[number] = k
        number += merged < at <= round  # without a branch, which would be hard to predict
    if number > len(price) // CACHE_LINE:
        _read_in_order(price, winner)  # so that the bids, in any order, find them in the cache
    for k in arrived[:number]:
        j, p = log.target[k], log.price[k]
        size, own = abs(p), abs(price[j])
        if size < own:
            continue
        at, w = rounds[k] + hops[agents[k]], log.winner[k]
        if size > own or (size == own and w < winner[j]):
            s.price_count[i] += price[j] == 0
            s.winner_count[i] += int(w >= 0) - int(winner[j] >= 0)
            price[j], winner[j] = p, w
            if arrival[j] < 0:
                changed[count] = j
                count += 1
            arrival[j] = at
        elif arrival[j] > at and p == price[j] and w == winner[j]:
            arrival[j] = at
    for c in range(count):
        s.last_news_round[i] = max(s.last_news_round[i], arrival[changed[c]])
        arrival[changed[c]] = -1
    s.target_count[i] = max(s.target_count[i], s.price_count[i])
    s.merged_round[i] = round
    s.merged_bid[i] = max(s.merged_bid[i], log.size[0])


@compiled()
@no_type_check
def _read_in_order(price, winner):
    total = 0.0
    for j in range(0, len(price), CACHE_LINE):
        total += price[j] + winner[j]
    return total


@compiled()
@no_type_check
def _place_bid(i, epsilon, bidder_ids, s, log):
    # Lines 10-25; False if there are not enough targets.
    price, winner, cost = s.price[i], s.winner[i], s.cost[i]
    k, m = log.size[1], max(s.target_count[i], s.price_count[i])
    if s.winner_count[i] >= m:
        m = s.winner_count[i] + 1
        if m > len(price):
            return False
        for j in range(m):
            s.price_count[i] += price[j] == 0
            s.winner_count[i] -= winner[j] >= 0
            price[j], winner[j] = -(abs(price[j]) + epsilon), NO_WINNER
            log.agent[k], log.round[k], log.target[k] = i, s.round[0], j
            log.price[k], log.winner[k] = price[j], NO_WINNER
            k += 1
    best, v, w = 0, np.inf, np.inf
    for j in range(m):
        total = cost[j] + abs(price[j])
        if total < v:
            best, v, w = j, total, v
        elif total < w:
            w = total
    if m == 1:
        w = v
    first = s.first_target[i]
    if s.target_index[i] < 0 and 0 <= first != best:
        total = cost[first] + abs(price[first])
        if total <= v + FIRST_SLACK * epsilon:
            best, v, w = first, total, v
    s.price_count[i] += price[best] == 0
    s.winner_count[i] += winner[best] < 0
    price[best] = abs(price[best]) + (w - v + epsilon)
    winner[best] = i if bidder_ids else ANONYMOUS
    log.agent[k], log.round[k], log.target[k] = i, s.round[0], best
    log.price[k], log.winner[k] = price[best], winner[best]
    log.size[1] = k + 1
    _drop_target(i, s)
    s.next_holder[i], s.first_holder[best], s.target_index[i] = s.first_holder[best], i, best
    s.target_count[i] = m
    s.last_news_round[i] = s.last_bid_round[i] = s.round[0]
    s.bid_count[i] += 1
    return True


@compiled()
@no_type_check
def _drop_target(i, s):
    # Takes an agent from the list of those that hold its target.
    before, at = s.target_index[i], -1
    if before >= 0:
        other = s.first_holder[before]
        while other != i:
            at, other = other, s.next_holder[other]
        if at < 0:
            s.first_holder[before] = s.next_holder[i]
        else:
            s.next_holder[at] = s.next_holder[i]
