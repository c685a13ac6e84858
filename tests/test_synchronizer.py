"""Synchronous rounds over a network that loses and delays messages."""

import numpy as np
import pytest
from graphs import complete, line, random_graph
from hypothesis import given, settings
from hypothesis import strategies as st
from lossy import Limited, enter_rounds, relay
from messages import Hello, bid_by_messages

from sato.auctions.bidder import VsdaaBidder, WinningBids
from sato.auctions.vsdaa import VsdaaAuction
from sato.network.channel import NEVER, Channel
from sato.network.flooding import Census, CensusMessage
from sato.network.link import Link
from sato.network.synchronizer import Synchronizer
from sato.network.synchronous_agent import Packet, SynchronousAgent

LAW = settings(deadline=None, derandomize=True, max_examples=30)
ROUNDS = 400  # of the network


def draw_link(rng):
    """Link with or without each fault."""
    share = rng.choice([0.0, 0.3, 0.6])
    failures = {"outage_share": share, "outage": 0.5, "round": 0.1} if share else {}
    loss, late = rng.choice([0.0, 0.2, 0.4]), int(rng.integers(0, 4))
    return Link(loss_probability=loss, late=late, **failures)


def go_through(channel, stages, discovery_rounds, entered, stops):
    """Let agents go through synchronous rounds; return all of them after each network round."""

    def begin(i):
        own = SynchronousAgent(i, 0, stages[i], discovery_rounds, ROUNDS)
        return own, own.packet

    def act(own, inbox):
        after = own.update(inbox)
        return after, after.packet

    return list(relay(channel, ROUNDS, entered, stops, begin, act))


def censuses(graph):
    return [Census(CensusMessage(frozenset([Hello(i)]))) for i in range(len(graph.alive))]


def lossless(graph, stages, rounds):
    """The same agents in rounds in which all hear all neighbors."""
    for _ in range(rounds):
        sent = [stage.message for stage in stages]
        stages = [own.update([sent[j] for j in graph.neighbors[i]]) for i, own in enumerate(stages)]
    return stages


@LAW
@given(st.integers(1, 9), st.integers(0, 2**32 - 1))
def test_messages_get_through_rounds_when_the_synchronizer_does(agents, seed):
    rng = np.random.default_rng(seed)
    link = draw_link(rng)
    graph = random_graph(rng, agents, 0.4)
    entered = rng.integers(0, 4, agents)
    window = link.silent_rounds + 3
    stops = np.full(agents, NEVER)
    if rng.random() < 0.3:  # one falls silent after it has been heard
        stops[rng.integers(agents)] = rng.integers(window + 4, window + 60)
    channel = Channel(link, graph, rng)
    ends = np.minimum(stops, ROUNDS)
    synchronizer, count = Synchronizer(channel, ends), 3 * graph.diameter + 1
    history = go_through(channel, censuses(graph), window, entered, stops)
    found = enter_rounds(history, range(agents), int(count.max()))
    assert np.array_equal(found[:, 0], entered)
    for v in range(1, found.shape[1]):
        through = synchronizer.advance(entered + window, np.minimum(v, count) - 1)
        is_asked = v <= count
        assert np.array_equal(found[is_asked, v], through[is_asked])


@LAW
@given(st.integers(0, 2**32 - 1))
def test_census_over_losses_equals_that_of_lossless_rounds(seed):
    rng = np.random.default_rng(seed)
    link = draw_link(rng)
    graph = random_graph(rng, 7, 0.4)
    channel = Channel(link, graph, rng)
    never, now = np.full(7, NEVER), np.zeros(7, dtype=int)
    *_, last = go_through(channel, censuses(graph), link.silent_rounds, now, never)
    for i, agent in last.items():
        assert agent.is_finished and agent.round == 3 * graph.diameter[i] + 1
        heard = {hello.agent for hello in agent.stage.message.reports}
        assert heard == set(np.flatnonzero(graph.component == graph.component[i]).tolist())
        assert agent.stage.message.max_eccentricity == graph.diameter[i]


@LAW
@given(st.integers(0, 2**32 - 1))
def test_vsdaa_over_losses_equals_that_of_lossless_rounds(seed):
    rng = np.random.default_rng(seed)
    link = draw_link(rng)
    graph, cost = random_graph(rng, 5, 0.6), rng.random((5, 6))
    rules, empty = (0.05, True), WinningBids.empty(6)
    auction = VsdaaAuction(cost, graph, np.full(5, 5), rules[0])
    history = list(bid_by_messages(auction))
    stages = []
    for i in range(5):
        bidder = VsdaaBidder(i, cost[i], *rules, 2 * int(graph.diameter[i]), 5, empty)
        stages.append(Limited(bidder, lambda own: own.bids, len(history)))
    channel = Channel(link, graph, rng)
    never, now = np.full(5, NEVER), np.zeros(5, dtype=int)
    *_, last = go_through(channel, stages, link.silent_rounds, now, never)
    for i, agent in last.items():
        assert agent.is_finished
        expected, found = history[-1][i], agent.stage.agent
        assert found.target_index == expected.target_index
        assert found.bid_count == expected.bid_count
        assert all(map(np.array_equal, found.bids, expected.bids))


def test_repeated_late_and_foreign_packets_change_nothing(rng):
    graph = line(4)
    agents = [SynchronousAgent(i, 7, own, 1, ROUNDS) for i, own in enumerate(censuses(graph))]
    sent = [[own.packet] for own in agents]
    foreign = Packet(9, 7, 5, ("of no neighbor",)), Packet(1, 6, 0, ("of another instant",))
    for _ in range(14):
        inboxes = []
        for i in range(4):
            old = [packet for j in graph.neighbors[i] for packet in sent[j]]
            inboxes.append([old[n] for n in rng.permutation(2 * len(old)) % len(old)])
            inboxes[i] += foreign if i != 1 else foreign[:1]
        agents = [own.update(inbox) for own, inbox in zip(agents, inboxes, strict=True)]
        sent = [[*own, agent.packet] for own, agent in zip(sent, agents, strict=True)]
    expected = lossless(graph, censuses(graph), 10)
    assert all(agent.is_finished and agent.round == 10 for agent in agents)
    assert [agent.stage for agent in agents] == expected


def test_agent_out_of_time_keeps_its_stage():
    own, other = (SynchronousAgent(i, 0, s, 1, 3) for i, s in enumerate(censuses(complete(2))))
    own = own.update([other.packet])
    for _ in range(5):
        before, own = own, own.update([])
    assert own.has_expired and not own.is_finished
    assert (own.round, own.network_round) == (1, 3)
    other = other.update([Packet(0, 0, 0, (own.stage.message,))])
    assert own.update([other.packet]) == before == own


def test_link_that_always_loses_leaves_agents_alone():
    link, graph = Link(loss_probability=0.99999), complete(3)
    channel = Channel(link, graph, np.random.default_rng(1))
    never, now = np.full(3, NEVER), np.zeros(3, dtype=int)
    *_, last = go_through(channel, censuses(graph), 2, now, never)
    assert all(len(agent.stage.message.reports) == 1 for agent in last.values())


@pytest.mark.parametrize("late", [0, 2])
def test_lossless_rounds_take_one_round_of_the_network_more_a_round_late(late):
    graph, agents = line(5), 5
    channel = Channel(Link(late=late), graph, np.random.default_rng(1))
    end, begun = np.full(agents, ROUNDS), np.zeros(agents, dtype=int)
    through = Synchronizer(channel, end).advance(begun, np.full(agents, 12))
    assert (through >= 12).all() and (through <= 12 * (1 + late)).all()
    if not late:
        assert (through == 12).all()


@pytest.mark.parametrize(
    "faults", [{"loss_probability": 0.2, "late": 2}, {"outage": 0.4, "outage_share": 0.6}]
)
def test_agents_are_heard_within_the_silent_rounds(faults):
    link = Link(**faults, round=0.1)
    channel = Channel(link, complete(60), np.random.default_rng(3))
    channel.extend(300)
    for now in range(0, 300 - link.silent_rounds):
        heard = channel.by_round.T[:, now : now + link.silent_rounds].min(axis=1)
        assert (heard <= now + link.silent_rounds).all()


def test_silent_rounds_are_those_that_losses_and_failures_take_together():
    loss, both = {"loss_probability": 0.2}, {"outage": 0.5, "outage_share": 0.5, "round": 0.1}
    assert Link().silent_rounds == 1
    assert Link(**loss).silent_rounds == 13  # 0.2¹³ < 10⁻⁹ < 0.2¹²
    assert Link(**both).silent_rounds == 6  # a failure of five rounds, and one more
    link = Link(**loss, **both)
    channel = Channel(link, complete(150), np.random.default_rng(0))
    channel.extend(8)
    assert (channel.by_round.T == NEVER).mean() == pytest.approx(1 - 0.5 * 0.8, abs=0.01)
    assert link.silent_rounds > 13 + 6
