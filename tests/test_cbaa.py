"""CBAA: the kernel against the definition, laws, and other solvers."""

from collections import deque
from typing import Any, NamedTuple

import numpy as np
import pytest
from graphs import complete, line
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linear_sum_assignment

from sato.auctions.bidder import CbaaBidder, WinningBids
from sato.auctions.cbaa import (
    NO_OUTAGES,
    UNLIMITED_ROUNDS,
    CbaaAuction,
    init_state,
    run_cbaa,
    run_rounds,
)
from sato.network.graph import CommunicationGraph
from sato.network.rounds import run_round

LAW = settings(deadline=None, derandomize=True, max_examples=80)


def run_by_messages(auction: CbaaAuction):
    """Run the definition: yield every live agent after every round."""
    score, graph, rng, loss = auction.score, auction.graph, auction.rng, auction.loss
    agents, points = score.shape
    live = np.flatnonzero(graph.alive).tolist()
    now = {i: CbaaBidder(i, score[i], len(live), WinningBids.empty(points)) for i in live}
    sent = {i: agent.bids for i, agent in now.items()}
    on_their_way = deque([sent] * (auction.delay + 1), maxlen=auction.delay + 1)
    for number in range(auction.rounds or UNLIMITED_ROUNDS):
        updated = {}
        for i in [i for i in live if not now[i].is_finished]:
            lost = rng.random(agents) < loss if loss > 0 else np.zeros(agents, dtype=bool)
            if auction.outages is not None:
                lost |= auction.outages[number, i]
            messages = {j: bids for j, bids in on_their_way[0].items() if not lost[j]}
            updated |= run_round(graph, {i: now[i]}, CbaaBidder.update, messages)
        if not updated:
            return
        now = now | updated
        on_their_way.append({i: agent.bids for i, agent in now.items()})
        yield now


class Case(NamedTuple):
    """Arguments of an auction."""

    score: np.ndarray
    graph: CommunicationGraph
    link: dict[str, Any]
    seed: int

    @property
    def live(self) -> np.ndarray:
        return np.flatnonzero(self.graph.alive)

    @property
    def auction(self) -> CbaaAuction:
        """Auction with a generator that draws the same losses each time."""
        rng = np.random.default_rng(self.seed)
        return CbaaAuction(self.score, self.graph, **self.link, rng=rng)


def connected(
    rng: np.random.Generator, agents: int, share: float, dead: int = 0
) -> CommunicationGraph:
    """Random tree of the live agents, with random further edges."""
    live = rng.permutation(agents)[dead:]
    adjacency = np.zeros((agents, agents), dtype=bool)
    for k in range(1, len(live)):
        adjacency[live[k], live[rng.integers(k)]] = True
    more = np.triu(rng.random((agents, agents)) < share, 1)
    more &= np.isin(np.arange(agents), live) & np.isin(np.arange(agents), live)[:, None]
    return CommunicationGraph(
        adjacency | adjacency.T | more | more.T, np.isin(np.arange(agents), live)
    )


def scores(rng: np.random.Generator, kind: str, agents: int, points: int) -> np.ndarray:
    if kind == "ties":
        return rng.integers(1, 4, (agents, points)).astype(float)
    if kind == "equal order":  # all agents prefer the same points in the same order
        return np.tile(np.arange(points, 0, -1.0), (agents, 1))
    apart = rng.random((agents, 1, 3)) - rng.random((points, 3))
    return 1 / ((apart**2).sum(axis=2) + 1e-8)


@st.composite
def cases(draw: st.DrawFn, most: int = 8, lossy: bool = True) -> Case:
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    agents = draw(st.integers(1, most))
    dead = draw(st.integers(0, agents - 1)) if draw(st.booleans()) else 0
    graph = connected(rng, agents, draw(st.sampled_from([0.0, 0.2, 1.0])), dead)
    points = agents - dead + draw(st.sampled_from([0, 0, 0, 2]))
    score = scores(rng, draw(st.sampled_from(["distance", "ties", "equal order"])), agents, points)
    link = {"delay": draw(st.integers(0, 3))}
    if lossy and draw(st.booleans()):
        loss, after = draw(st.sampled_from([0.1, 0.5])), draw(st.integers(1, 300))
        link |= {"loss": loss, "rounds": after}
        if draw(st.booleans()):
            link["outages"] = rng.random((after, agents, agents)) < 0.4
    return Case(score, graph, link, seed)


def greedy(score: np.ndarray, live: np.ndarray) -> np.ndarray:
    """Greedy choice of the largest score, by sorting the whole table."""
    point, free = np.full(len(score), -1), np.full(score.shape[1], True)
    pairs = [(-score[i, j], i, j) for i in live for j in range(score.shape[1])]
    for _, i, j in sorted(pairs):
        if point[i] < 0 and free[j]:
            point[i], free[j] = j, False
    return point


# Laws


@settings(LAW, max_examples=120)
@given(case=cases())
def test_kernel_equals_the_definition_bit_for_bit(case):
    swarm = init_state(case.score, case.graph, case.link["delay"])
    rng, played = np.random.default_rng(case.seed), 0
    for now in run_by_messages(case.auction):
        run_rounds(swarm, 1, case.link.get("loss", 0.0), rng, case.link.get("outages", NO_OUTAGES))
        played += 1
        for i in case.live:
            assert now[i].bids.price.tobytes() == swarm.price[i].tobytes()
            assert now[i].bids.winner.tobytes() == swarm.winner[i].tobytes()
            assert (now[i].point, now[i].is_finished) == (swarm.point[i], not swarm.is_running[i])
    assert run_cbaa(case.auction).round_count == played


@settings(LAW, max_examples=150)
@given(case=cases(most=16, lossy=False))
def test_result_is_the_greedy_choice_within_the_round_bound(case):
    result = run_cbaa(CbaaAuction(case.score, case.graph, **case.link))
    assert result.point.tolist() == greedy(case.score, case.live).tolist()
    assert result.is_conflict_free
    assert result.has_consensus
    waits = (case.link["delay"] + 1) * len(case.live) * int(case.graph.diameter.max())
    assert result.round_count <= waits + 1
    assert result.finished_round[case.live].max() == result.round_count
    assert np.all(result.point[~case.graph.alive] == -1)


@LAW
@given(case=cases())
def test_no_agent_bids_once_one_has_finished(case):
    final = greedy(case.score, case.live)
    known, tables = False, set()
    for now in run_by_messages(case.auction):
        if known := known or any(now[i].is_finished for i in case.live):
            assert [now[i].point for i in case.live] == final[case.live].tolist()
        tables |= {now[i].bids.winner.tobytes() for i in case.live if now[i].is_finished}
    assert len(tables) <= 1
    result = run_cbaa(case.auction)
    sure = np.flatnonzero(result.finished_round)
    assert result.point[sure].tolist() == final[sure].tolist()


@LAW
@given(case=cases())
def test_result_tells_conflicts_and_consensus_of_the_last_round(case):
    result = run_cbaa(case.auction)
    *_, last = run_by_messages(case.auction)
    claimed = [last[i].point for i in case.live]
    tables = {last[i].bids.price.tobytes() + last[i].bids.winner.tobytes() for i in case.live}
    held = all(last[i].bids.winner[last[i].point] == i for i in case.live)
    assert result.point[case.live].tolist() == claimed
    assert result.is_conflict_free == (len(set(claimed)) == len(claimed))
    assert result.has_consensus == (len(tables) == 1 and held)
    assert result.is_conflict_free or not result.has_consensus


@pytest.mark.parametrize("loss", [0.2, 0.6, 0.9])
@pytest.mark.parametrize("delay", [0, 2])
def test_lost_messages_delay_the_same_result(rng, loss, delay):
    graph, score = connected(rng, 20, 0.1), scores(rng, "distance", 20, 20)
    calm = run_cbaa(CbaaAuction(score, graph))
    rough = run_cbaa(CbaaAuction(score, graph, rounds=2000, loss=loss, delay=delay, rng=rng))
    assert rough.has_consensus
    assert rough.point.tolist() == calm.point.tolist()
    assert rough.round_count > calm.round_count


@LAW
@given(case=cases(lossy=False))
def test_monotone_map_of_scores_keeps_the_result(case):
    one = run_cbaa(CbaaAuction(case.score, case.graph))
    other = run_cbaa(CbaaAuction(np.log1p(case.score) ** 3, case.graph))
    assert one.point.tolist() == other.point.tolist()
    assert one.round_count == other.round_count


def test_scores_have_no_effect_h_hops_away_before_round_h_plus_1(rng):
    score, graph = scores(rng, "distance", 10, 10), line(10)
    changed = score.copy()
    changed[0, np.argmax(score[0])] *= 2
    for delay in (0, 1):
        for after in range(1, 22):
            one, other = (
                run_cbaa(CbaaAuction(s, graph, rounds=after, delay=delay)) for s in (score, changed)
            )
            differ = np.any(one.price != other.price, axis=1)
            assert not differ[(after - 1) // (delay + 1) + 1 :].any()
            assert differ[0]


# Second opinions


@settings(LAW, max_examples=120)
@given(case=cases(most=20, lossy=False))
def test_total_score_is_at_least_half_of_the_optimum(case):
    result, live = run_cbaa(CbaaAuction(case.score, case.graph)), case.live
    best = case.score[live][linear_sum_assignment(case.score[live], maximize=True)].sum()
    total = case.score[live, result.point[live]].sum()
    assert 0.5 * best <= total * (1 + 1e-12)
    assert total <= best * (1 + 1e-12)


def test_half_of_the_optimum_is_a_tight_bound():
    score = np.array([[1.001, 1.0], [1.0, 0.001]])
    result = run_cbaa(CbaaAuction(score, complete(2)))
    assert result.point.tolist() == [0, 1]
    assert score[[0, 1], result.point].sum() / 2.0 == pytest.approx(0.501)


# Published numbers


@pytest.mark.parametrize("agents", [2, 5, 30])
def test_equal_preferences_take_as_many_rounds_as_the_bound(rng, agents):
    # n d iterations [Lusk2020, sec. IV-B]; the first round has nothing to listen to.
    result = run_cbaa(CbaaAuction(scores(rng, "equal order", agents, agents), complete(agents)))
    assert result.round_count == agents * 1 + 1
    assert result.point.tolist() == list(range(agents))


# Small cases and refusals


def test_lone_agent_finishes_in_one_round():
    result = run_cbaa(CbaaAuction(np.array([[1.0, 3.0, 2.0]]), complete(1)))
    assert (result.point.tolist(), result.round_count) == ([1], 1)
    assert result.has_consensus


@pytest.mark.parametrize(
    ("score", "points"),
    [(np.tile([4.0, 3, 2, 1], (4, 1)), [0, 0, 0, 0]), (np.eye(3) + 1, [0, 1, 2])],
)
def test_first_round_bids_on_the_largest_scores_without_consensus(score, points):
    agents = len(points)
    result = run_cbaa(CbaaAuction(score, complete(agents), rounds=1))
    assert result.point.tolist() == points and not result.has_consensus
    assert result.is_conflict_free == (len(set(points)) == agents)
    assert run_cbaa(CbaaAuction(score, complete(agents))).has_consensus


TWO_PAIRS = CommunicationGraph(np.kron(np.eye(2), 1 - np.eye(2)).astype(bool), np.full(4, True))
LOSSY = {"loss": 0.1, "rounds": 9, "rng": np.random.default_rng(0)}


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"score": np.ones((4, 4)), "graph": TWO_PAIRS}, "no message gets from agent 0 to agent 2"),
        ({"score": np.diag([0.0, 1, 1]) + 0}, "the score of point 0 for agent 0 is 0.0"),
        (
            {"score": np.full((3, 3), np.inf)},
            r"score: must be an array of real numbers .* with inf at \[0, 0\]",
        ),
        ({"score": np.full((3, 3), np.nan)}, "the score of point 0 for agent 0 is nan"),
        ({"score": np.ones((3, 2))}, "each agent needs a row"),
        ({"score": np.ones((4, 4))}, "graph.agents: must be 4 as of the others, got 3"),
        ({"loss": 1.0}, "loss: must be a finite number at least 0 and below 1, got 1.0"),
        ({"loss": -0.1}, "got -0.1"),
        ({"delay": -1}, "delay: must be an integer at least 0"),
        ({"rounds": 0}, "rounds: must be an integer above 0"),
        ({"rounds": None}, "give the number of rounds after which all stop"),
        ({"rng": None}, "give the number of rounds after which all stop"),
    ],
)
def test_invalid_auction_is_refused_with_a_reason(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        CbaaAuction(**{"score": np.ones((3, 3)), "graph": complete(3)} | LOSSY | change)
