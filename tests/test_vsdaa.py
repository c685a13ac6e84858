"""VSDAA: the kernel against the definition, laws, and the optimal assignment."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from graphs import line, random_graph, ring
from hypothesis import given, settings
from hypothesis import strategies as st
from messages import bid_by_messages

from problems.assignment import solve_assignment
from sato.auctions import vsdaa
from sato.auctions.bidder import WinningBids
from sato.auctions.vsdaa import (
    NO_WINNER,
    Opening,
    OutOfTargets,
    VsdaaAuction,
    VsdaaState,
    init_state,
    run_kernel,
    run_vsdaa,
)
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.auction_opening import forecast_opening, has_dear_leftovers

LAW = settings(deadline=None, derandomize=True, max_examples=60)


def costs(rng: np.random.Generator, kind: str, agents: int, targets: int) -> np.ndarray:
    if kind == "ties":
        return rng.integers(0, 3, (agents, targets)).astype(float)
    if kind == "all equal":
        return np.ones((agents, targets))
    if kind == "grid":  # distances on a lattice: many ties
        start, goal = (rng.permutation(36)[:n] for n in (agents, targets))
        return np.hypot(start[:, None] // 6 - goal // 6, start[:, None] % 6 - goal % 6)
    if kind == "circle":
        angle = 2 * np.pi * np.arange(targets) / targets
        start = rng.normal(size=(agents, 1, 2))
        return np.linalg.norm(start - np.stack([np.cos(angle), np.sin(angle)], 1), axis=2)
    return rng.random((agents, targets)) + (10.0 if kind == "far" else 0.0)


@st.composite
def cases(draw: st.DrawFn, most: int = 9) -> VsdaaAuction:
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    agents, spare = draw(st.integers(1, most)), draw(st.integers(0, 4))
    shape = draw(st.sampled_from(["line", "ring", "dense", "sparse", "losses"]))
    if shape in ("line", "ring"):
        graph = {"line": line, "ring": ring}[shape](agents)
    else:
        graph = random_graph(
            rng, agents, 0.6 if shape == "dense" else 0.25, 0.7 if shape == "losses" else 1.0
        )
    kind = draw(st.sampled_from(["random", "far", "ties", "all equal", "grid", "circle"]))
    targets = agents + spare
    m = draw(st.integers(1, targets))
    target_count = rng.integers(1, m + 1, agents) if draw(st.booleans()) else np.full(agents, m)
    epsilon = draw(st.sampled_from([0.01, 0.03, 0.25, 1.0]))
    auction = VsdaaAuction(costs(rng, kind, agents, targets), graph, target_count, epsilon)
    return replace(auction, opening=open_anyhow(rng, auction)) if draw(st.booleans()) else auction


def open_anyhow(rng: np.random.Generator, auction: VsdaaAuction) -> Opening:
    """Draw prices of some of the targets, and first bids on any of them."""
    targets, m = auction.cost.shape[1], auction.graph.component_max(auction.target_count)
    price = -rng.choice([0.0, 0.1, 0.5, 2.0], targets) * (np.arange(targets) < m[:, None])
    return Opening(price, rng.integers(-1, np.maximum(m, 0)))


def kernel(case: VsdaaAuction, ids: bool, rounds: int) -> list[VsdaaState]:
    """State after each round; the last is repeated up to this number of rounds."""
    swarm, history = init_state(case.cost, case.graph, case.target_count, case.opening), []
    for _ in run_kernel(swarm, case.epsilon, ids, [], stride=1):
        history.append(VsdaaState(*(field.copy() for field in swarm)))
    return history + [history[-1]] * (rounds - len(history))


def definition(case: VsdaaAuction, ids: bool, rounds: int = 0) -> list:
    history = list(bid_by_messages(replace(case, bidder_ids=ids)))
    return history + [history[-1]] * (rounds - len(history))


def news(agents):
    return {i: agent.bids for i, agent in agents.items()}


@pytest.mark.parametrize("ids", [True, False])
@settings(LAW, max_examples=100)
@given(case=cases())
def test_kernel_equals_the_definition_bit_for_bit(ids, case):
    if not case.graph.alive.any():
        return
    try:
        agents = definition(case, ids)
    except OutOfTargets as expected:
        with pytest.raises(OutOfTargets) as found:
            run_vsdaa(replace(case, bidder_ids=ids))
        assert (found.value.agent, found.value.round) == (expected.agent, expected.round)
        return
    rounds = len(agents)
    swarms = kernel(case, ids, rounds)
    agents = definition(case, ids, len(swarms))
    for r, (now, swarm) in enumerate(zip(agents, swarms, strict=True), start=1):
        for i in np.flatnonzero(case.graph.alive):
            me = now[i]
            assert me.bids.price.tobytes() == swarm.price[i].tobytes()
            assert np.array_equal(me.bids.winner, swarm.winner[i])
            assert (me.target_count, me.target_index) == (
                swarm.target_count[i],
                swarm.target_index[i],
            )
            assert me.quiet_rounds == min(r - swarm.last_news_round[i], swarm.patience[i])
            assert me.bid_count == swarm.bid_count[i]
    auction, last = run_vsdaa(replace(case, bidder_ids=ids)), agents[-1]
    assert auction.round_count == rounds
    assert auction.target_index.tolist() == [
        last[i].target_index if i in last else NO_WINNER for i in range(len(case.cost))
    ]
    assert all(auction.bidder_count[i] == last[i].bids.winner_count for i in last)
    assert auction.bid_count == sum(agent.bid_count for agent in last.values())
    opening = case.opening or Opening.empty(*case.cost.shape)
    none = np.full(len(case.cost[0]), NO_WINNER)
    first = {i: WinningBids(opening.price[i], none) for i in last}
    tables = [first, *(news(a) for a in agents)]
    for i in last:
        changes = [
            int(((now[i].price != was[i].price) | (now[i].winner != was[i].winner)).sum())
            for was, now in pairwise(tables)
        ]
        assert auction.entry_count[i] == sum(changes)
        assert auction.message_count[i] == np.count_nonzero(changes)
    # Without a pause agents merge what arrives when they act alone.
    for i, me in last.items():
        assert auction.price[i].tobytes() == me.bids.price.tobytes()
        assert auction.target_count[i] == me.target_count


@settings(LAW, max_examples=100)
@given(cases())
def test_auctions_do_not_depend_on_the_room_for_bids(case):
    found = []
    for room in (0, 10**5):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(vsdaa, "MIN_ROOM", room)
            try:
                found.append(run_vsdaa(case))
            except OutOfTargets as error:
                found.append((error.agent, error.round))
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


def check_result(case: VsdaaAuction) -> None:
    """Check the result of the auction in each component."""
    cost, graph, target_count, epsilon = case.cost, case.graph, case.target_count, case.epsilon
    auction = run_vsdaa(case)
    for c in range(graph.component.max(initial=-1) + 1):
        members = np.flatnonzero(graph.component == c)
        n, target = len(members), auction.target_index[members]
        m = max(n, int(target_count[members].max()))
        assert len(set(target.tolist())) == n
        assert set(auction.target_count[members].tolist()) == {m}
        assert set(auction.bidder_count[members].tolist()) == {n}
        assert np.all(auction.price[members] == auction.price[members[0]])
        best = cost[members, solve_assignment(cost[members, :m])].sum()
        paid = cost[members, target].sum()
        assert best - 1e-9 <= paid
        if not has_dear_leftovers(auction.price[members[0]]):
            assert paid <= best + n * epsilon + 1e-9


@settings(LAW, max_examples=300)
@given(cases(most=14))
def test_components_agree_on_unique_targets_within_n_epsilon(case):
    check_result(case)


@pytest.mark.parametrize("share", [0.05, 0.1])
def test_sixty_agents_in_several_components_converge(rng, share):
    graph = random_graph(rng, 60, share, 0.9)
    check_result(VsdaaAuction(rng.random((60, 70)), graph, rng.integers(20, 71, 60), 1e-3))


@settings(LAW)
@given(cases(most=14))
def test_auction_with_its_own_forecast_ends_after_one_bid_each(case):
    graph = case.graph
    count = np.maximum(graph.component_max(case.target_count), graph.component_sizes)
    case = replace(case, target_count=count, opening=None)
    opening = forecast_opening(case)
    auction = run_vsdaa(replace(case, opening=opening))
    assert auction.target_index.tolist() == opening.target_index.tolist()
    assert auction.bid_count == graph.alive.sum()
    assert auction.round_count <= 1 + 3 * graph.diameter.max(initial=0)
    assert not has_dear_leftovers(auction.price[graph.alive]).any()
    check_result(replace(case, opening=opening))


def test_wrong_forecast_leaves_a_target_dear_that_was_not_taken():
    # In the forecast both agents compete for target 1, and then neither wants it.
    forecast = np.array([[9.0, 0, 1], [9, 0, 2]])
    case = VsdaaAuction(forecast, line(2), np.full(2, 3), 0.1)
    opening = forecast_opening(case)
    assert opening.price[0].tolist() == [0, -1, 0]
    case = replace(case, cost=np.array([[0.0, 9, 0.1], [0.1, 9, 0]]))
    auction = run_vsdaa(replace(case, opening=opening))
    assert auction.target_index.tolist() == [0, 2]
    assert has_dear_leftovers(auction.price).all()
    assert not has_dear_leftovers(run_vsdaa(case).price).any()


@pytest.mark.parametrize(("m", "target"), [(3, 1), (1, 0)])
def test_lone_agent_takes_its_cheapest_target_in_one_round(m, target):
    auction = run_vsdaa(VsdaaAuction(np.array([[3.0, 1.0, 2.0]]), line(1), np.array([m]), 0.1))
    assert auction.target_index.tolist() == [target]
    assert (auction.round_count, auction.bid_count, auction.bidder_count.tolist()) == (1, 1, [1])


@pytest.mark.parametrize("target_count", [3, 12])
def test_costs_have_no_effect_h_hops_away_before_round_h(rng, target_count):
    # The kernel suffices: it equals the definition bit for bit.
    cost = rng.random((10, 12))
    changed = cost.copy()
    changed[0] = rng.random(12)
    changed[0, np.argmin(cost[0, :target_count])] = 2.0  # so that it bids elsewhere at once
    graph, m = line(10), np.full(10, target_count)
    before, after = (kernel(VsdaaAuction(c, graph, m, 1e-2), True, 40) for c in (cost, changed))

    def differs(r: int, i: int) -> bool:
        # Index r is the state after r + 1 rounds; the first bid arrives a hop away in the second.
        (p, w), (q, v) = ((s[r].price[i], s[r].winner[i]) for s in (before, after))
        return p.tobytes() != q.tobytes() or w.tobytes() != v.tobytes()

    assert not any(differs(r, hops) for hops in range(10) for r in range(hops))
    assert differs(0, 0)
    assert any(differs(r, 9) for r in range(9, 40))


def test_tied_bids_without_ids_assign_one_target_to_several():
    # All bid the same on target 0 and, without ids, each believes to hold it.
    case = VsdaaAuction(np.ones((4, 6)), line(4), np.full(4, 1), 0.1)
    assert run_vsdaa(replace(case, bidder_ids=False)).target_index.tolist() == [0, 0, 0, 0]
    assert sorted(run_vsdaa(replace(case, bidder_ids=True)).target_index.tolist()) == [0, 1, 2, 3]


def test_printed_method_is_near_optimal_without_ties(rng):
    cost = rng.random((12, 15))
    auction = run_vsdaa(VsdaaAuction(cost, ring(12), np.full(12, 15), 1e-2, bidder_ids=False))
    paid, best = (
        cost[range(12), auction.target_index].sum(),
        cost[range(12), solve_assignment(cost)].sum(),
    )
    assert len(set(auction.target_index.tolist())) == 12
    assert best - 1e-9 <= paid <= best + 12 * 1e-2


def test_last_bid_round_is_within_the_bound_of_proposition_1(rng):
    # [Morgan2016, eq. 20]; the proof ignores growing m, so m starts at N.
    for agents in (3, 8, 20):
        cost, graph = rng.random((agents, agents)), ring(agents)
        auction = run_vsdaa(VsdaaAuction(cost, graph, np.full(agents, agents), 1e-2))
        steps = np.ceil((cost.max(axis=1) - cost.min(axis=1)) / 1e-2).max()
        assert auction.last_bid_round <= graph.diameter[0] * (agents - 1) * steps


def test_auction_ends_where_many_targets_are_out_of_reach(rng):
    # Out of reach is a large finite cost; here four agents compete for three that are in reach.
    cost = rng.random((6, 8))
    cost[:4, 3:] += 1e3
    check_result(VsdaaAuction(cost, line(6), np.full(6, 8), 1e-2))


@pytest.mark.parametrize("run", [run_vsdaa, lambda case: list(bid_by_messages(case))])
def test_more_agents_than_targets_raise_out_of_targets(rng, run):
    with pytest.raises(OutOfTargets, match="found all 3 targets taken") as found:
        run(VsdaaAuction(rng.random((5, 3)), line(5), np.full(5, 2), 0.1))
    assert found.value.targets == 3
    assert found.value.round > 1


def test_auction_without_live_agents_ends_at_once():
    graph = CommunicationGraph(np.zeros((2, 2), dtype=bool), np.full(2, False))
    auction = run_vsdaa(VsdaaAuction(np.full((2, 3), np.nan), graph, np.zeros(2, dtype=int), 0.1))
    assert auction.target_index.tolist() == [-1, -1]
    assert (auction.round_count, auction.bid_count) == (0, 0)


def test_dead_agents_need_no_costs(rng):
    alive = np.array([True, False, True])
    graph = CommunicationGraph.from_positions(np.array([[0.0], [1.0], [2.0]]), 3.0, alive)
    cost = rng.random((3, 3))
    cost[1] = np.nan
    auction = run_vsdaa(VsdaaAuction(cost, graph, np.array([2, 0, 2]), 1e-2))
    assert auction.target_index[1] == NO_WINNER
    assert len({*auction.target_index[alive].tolist()}) == 2


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"cost": np.array([[0.0, np.inf], [0, 0]])}, r"cost: must be .* with inf at \[0, 1\]"),
        (
            {"cost": np.zeros((3, 2)), "target_count": np.array([1, 1, 1])},
            "graph.agents: must be 3 as of the others, got 2",
        ),
        ({"target_count": np.array([1, 3])}, "agent 1 bids on 3 targets: must be from 1 to the 2"),
        ({"target_count": np.array([0, 1])}, "agent 0 bids on 0 targets"),
        ({"epsilon": 0.0}, "the bid increment is 0.0"),
        ({"epsilon": float("nan")}, "epsilon: must be a finite number, got nan"),
        ({"cost": np.full((2, 2), 1e15)}, "the bid increment is 0.1: it must be"),
    ],
)
def test_invalid_input_is_refused_with_a_cure(change, sentence):
    valid = VsdaaAuction(np.zeros((2, 2)), line(2), np.array([1, 1]), 0.1)
    with pytest.raises(ValueError, match=sentence):
        replace(valid, **change)
