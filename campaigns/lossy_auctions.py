"""Auctions over a network that loses, delays and interrupts messages, one after another."""

from functools import partial
from typing import Any, no_type_check

import numpy as np
from auctions import TIE_BREAK, _draw_spaced_points
from numba import njit
from numpy import ndarray as Array
from scipy.spatial import cKDTree

from sato.auctions import CbaaAuction, VsdaaAuction, run_cbaa, run_vsdaa
from sato.network.channel import Channel
from sato.network.graph import CommunicationGraph
from sato.network.link import Link
from sato.network.synchronizer import Synchronizer

RADIUS, SEPARATION = 3.0, 0.8  # of starts, as in the scenario uiuc [m]
ROUND = 0.01  # [s]
TIME = 6  # for an auction, over its rounds without loss; more where messages are late
Outcome = tuple[Array, dict[str, Any]]  # target of each agent, −1 none; more columns


def assign_twice(
    rng: np.random.Generator,
    method: str,
    agents: int,
    degree: float,
    loss: float,
    late: int = 0,
    outage_share: float = 0.0,
    is_cut: bool = False,
) -> dict[str, Any]:
    """Assign targets, carry all agents elsewhere, and assign again; count duplicates each time.

    An agent that is not through with an auction in time keeps the target that it had. `through` is
    the share of the others.

    Args:
        rng: Generator.
        method: "synchronized", "as written" or "cbaa".
        agents: Number of agents.
        degree: Neighbors of an agent, but for those at the edge of the swarm.
        loss: Probability that a message is lost.
        late: Rounds by which one is late, at most; in CBAA, all are.
        outage_share: Share of the time in which a link is down, for up to 5 rounds.
        is_cut: Put an auction between the two for which there is not enough time.
    """
    failures = {"outage_share": outage_share, "outage": 5 * ROUND} if outage_share else {}
    link = Link(loss_probability=loss, late=late, round=ROUND, **failures)
    run = {
        "synchronized": _run_synchronized,
        "as written": _run_as_written,
        "cbaa": _run_cbaa,
    }[method]
    side = RADIUS * np.sqrt(np.pi * agents / degree)
    goal = _draw_spaced_points(rng, agents + (0 if method == "cbaa" else 10), 0.9, side)
    held, found, counts, shares = np.full(agents, -1), dict[str, Any](), list[int](), list[float]()
    for each in [run, partial(run, is_cut=True), run] if is_cut else [run, run]:
        start, graph = _draw_start(rng, agents, side)
        new, found = each(rng, start, goal, graph, link)
        held = np.where(new >= 0, new, held)
        counts.append(_count_duplicates(held))
        shares.append((new >= 0).mean())
    counted = {"duplicates": counts[-2], "through": shares[-2]}
    counted |= {"duplicates_next": counts[-1], "through_next": shares[-1]}
    return counted | found


def _draw_start(
    rng: np.random.Generator, agents: int, side: float
) -> tuple[Array, CommunicationGraph]:
    """Draw positions until all are connected."""
    while True:
        start = _draw_spaced_points(rng, agents, SEPARATION, side)
        graph = CommunicationGraph.from_positions(start, RADIUS, np.full(agents, True))
        if graph.component.max() == 0:
            return start, graph


def _count_duplicates(held: Array) -> int:
    claimed = held[held >= 0]
    return len(claimed) - len(np.unique(claimed))


def _make_vsdaa(start: Array, goal: Array, graph: CommunicationGraph) -> VsdaaAuction:
    """Make an auction at the cost of `sato run`, |Δx| + |Δy| + w d²."""
    move, count = goal - start[:, None], np.full(len(start), len(start))
    cost = np.abs(move).sum(axis=2) + TIE_BREAK * (move**2).sum(axis=2)
    spacing = cKDTree(goal).query(goal, k=2)[0][:, 1].min()
    return VsdaaAuction(cost, graph, count, 0.5 * TIE_BREAK * spacing**2)


def _run_synchronized(
    rng: np.random.Generator,
    start: Array,
    goal: Array,
    graph: CommunicationGraph,
    link: Link,
    is_cut: bool = False,
) -> Outcome:
    """Run VSDAA in synchronous rounds: the diameter, m, bids, and D rounds to hear of the end.

    A cut auction ends when half of the agents are through.
    """
    result, diameter = run_vsdaa(_make_vsdaa(start, goal, graph)), int(graph.diameter[0])
    rounds = (3 * diameter + 1) + diameter + result.round_count + diameter
    limit, agents = TIME * (2 if link.late else 1) * rounds, len(start)
    synchronizer = Synchronizer(Channel(link, graph, rng), np.full(agents, limit))
    heard, count = np.full(agents, link.silent_rounds), np.full(agents, rounds - 1)
    through = synchronizer.advance(heard, count)
    in_time = through < limit
    if is_cut:
        in_time &= through <= np.median(through)
    more = {"rounds": rounds, "rounds_over_lossless": through.max() / rounds}
    return np.where(in_time, result.target_index, -1), more


def _run_as_written(
    rng: np.random.Generator, start: Array, goal: Array, graph: CommunicationGraph, link: Link
) -> Outcome:
    """Run VSDAA as if no message could be lost: bid on what has arrived, stop after 2 D rounds."""
    auction, patience = _make_vsdaa(start, goal, graph), 2 * int(graph.diameter[0])
    own = auction.cost, graph.adjacency, auction.epsilon, patience
    held, rounds = _bid_on_arrivals(*own, link.loss_probability, rng)
    return held, {"rounds": rounds}


@njit(cache=True)
@no_type_check
def _bid_on_arrivals(cost, adjacency, epsilon, patience, loss, rng):
    # What `VsdaaBidder` does on the messages that arrive; one that has stopped repeats its last.
    # A message that has been merged before changes nothing, and is left out.
    agents, targets = cost.shape
    price, winner = np.zeros((agents, targets)), np.full((agents, targets), -1)
    target, m = np.full(agents, -1), np.full(agents, agents)
    quiet, version = np.zeros(agents, np.int64), np.zeros(agents, np.int64)
    seen, rounds = np.zeros((agents, agents), np.int64), 0
    is_running = np.full(agents, True)
    while is_running.any():
        rounds += 1
        sent_price, sent_winner, sent_version = price.copy(), winner.copy(), version.copy()
        for i in range(agents):
            if not is_running[i]:
                continue
            is_new = False
            for a in np.flatnonzero(adjacency[i]):
                if rng.random() < loss or sent_version[a] <= seen[i, a]:
                    continue
                seen[i, a] = sent_version[a]
                for j in range(targets):
                    size, known = abs(sent_price[a, j]), abs(price[i, j])
                    if size > known or (size == known and sent_winner[a, j] < winner[i, j]):
                        price[i, j], winner[i, j] = sent_price[a, j], sent_winner[a, j]
                        is_new = True
            is_outbid = target[i] < 0 or winner[i, target[i]] != i
            if is_outbid or is_new:
                m[i] = max(m[i], np.count_nonzero(price[i]))
                version[i], quiet[i] = version[i] + 1, 0
            else:
                quiet[i] += 1
            if is_outbid:
                target[i], m[i] = _place_bid(i, cost[i], epsilon, price[i], winner[i], m[i])
            is_running[i] = quiet[i] < patience
    return target, rounds


@njit(cache=True)
@no_type_check
def _place_bid(i, cost, epsilon, price, winner, m):
    held = np.count_nonzero(winner >= 0)
    if held >= m:
        m = held + 1
        price[:m], winner[:m] = -(np.abs(price[:m]) + epsilon), -1
    total = cost[:m] + np.abs(price[:m])
    best = np.argmin(total)
    least, total[best] = total[best], np.inf
    second = total.min() if m > 1 else least
    price[best], winner[best] = abs(price[best]) + second - least + epsilon, i
    return best, m


def _run_cbaa(
    rng: np.random.Generator,
    start: Array,
    goal: Array,
    graph: CommunicationGraph,
    link: Link,
    is_cut: bool = False,
) -> Outcome:
    """Run CBAA; an agent stops by itself, and a cut auction when it would without loss."""
    apart = goal - start[:, None]
    score = 1 / ((apart**2).sum(axis=2) + 1e-8)
    rounds = run_cbaa(CbaaAuction(score, graph)).round_count
    most, more = rounds * (1 if is_cut else TIME), {"loss": link.loss_probability, "rng": rng}
    result = run_cbaa(CbaaAuction(score, graph, rounds=most, delay=link.late, **more))
    knew = result.finished_round
    found = {"rounds": rounds, "rounds_over_lossless": knew.max() / rounds}
    return np.where(knew > 0, result.point, -1), found
