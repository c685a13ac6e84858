"""Who hears whom, rounds of messages, and how agents learn their diameter."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sato.network.graph import CommunicationGraph
from sato.network.rounds import (
    DiameterEstimator,
    WaveMessage,
    flood,
    knows_diameter,
    learn_diameter,
    run_rounds,
    schedule_turns,
    update_diameter,
)

LAW = settings(deadline=None, derandomize=True)


@st.composite
def networks(draw: st.DrawFn, most: int = 12) -> CommunicationGraph:
    agents = draw(st.integers(1, most))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    alive = rng.random(agents) < draw(st.sampled_from([1.0, 0.8]))
    hears = np.triu(rng.random((agents, agents)) < draw(st.sampled_from([0.1, 0.2, 0.5])), 1)
    return CommunicationGraph((hears | hears.T) & alive & alive[:, None], alive)


def line(agents: int) -> CommunicationGraph:
    place = np.arange(agents)
    hears = np.abs(place - place[:, None]) == 1
    return CommunicationGraph(hears, np.ones(agents, dtype=bool))


def all_hops(network: CommunicationGraph) -> np.ndarray:
    # By powers of the adjacency: an opinion independent of any shortest-path code.
    agents = len(network.alive)
    hops = np.full((agents, agents), np.inf)
    reach = np.eye(agents, dtype=bool)
    for d in range(agents):
        hops[reach & np.isinf(hops)] = d
        reach = (reach.astype(int) @ (network.adjacency | np.eye(agents, dtype=bool))) > 0
    return hops


@LAW
@given(networks())
def test_learned_and_batched_diameter_agree_with_all_paths(network):
    hops = all_hops(network)
    expected = [
        int(
            max(
                hops[i, j]
                for i in np.flatnonzero(np.isfinite(hops[a]))
                for j in np.flatnonzero(np.isfinite(hops[a]))
            )
        )
        for a in range(len(hops))
    ]
    assert learn_diameter(network).tolist() == expected
    assert network.diameter.tolist() == expected
    assert np.array_equal(network.hops, hops)


@LAW
@given(networks())
def test_diameter_is_known_after_three_eccentricities(network):
    live = np.flatnonzero(network.alive).tolist()
    states = {i: DiameterEstimator(WaveMessage(frozenset([i]))) for i in live}
    history = list(
        run_rounds(network, states, update_diameter, lambda s: s.message, knows_diameter)
    )
    for i in live:
        e = int(
            np.max(all_hops(network)[i], where=network.component == network.component[i], initial=0)
        )
        assert history[-1][i].eccentricity == e
        assert history[-1][i].round == 3 * e + 1
        assert 3 * e + 1 <= 3 * network.diameter[i] + 1


@LAW
@given(networks())
def test_components_are_connected_by_paths(network):
    hops, component = all_hops(network), network.component
    for i in range(len(hops)):
        if not network.alive[i]:
            assert component[i] == -1
            continue
        together = (component == component[i]).tolist()
        assert together == np.isfinite(hops[i]).tolist()
    seen = [c for c in component.tolist() if c >= 0]
    assert list(dict.fromkeys(seen)) == list(range(len(set(seen))))  # by lowest member


@LAW
@given(networks(), st.integers(0, 2**32 - 1))
def test_flood_of_max_equals_component_max(network, seed):
    values = np.random.default_rng(seed).integers(1, 50, len(network.alive))
    largest = network.component_max(values)
    told = {i: int(values[i]) for i in np.flatnonzero(network.alive).tolist()}
    assert flood(network, told, max) == {i: largest[i] for i in told}


def test_news_travels_one_hop_a_round():
    network = line(6)
    states = {i: frozenset([i]) for i in range(6)}
    history = run_rounds(
        network,
        states,
        lambda mine, inbox: mine.union(*inbox),
        lambda mine: mine,
        lambda mine: len(mine) == 6,
    )
    for r, now in enumerate(history, start=1):
        for i in range(6):
            assert now[i] == {j for j in range(6) if abs(i - j) <= r}


def test_agent_hears_its_neighbors_alone_also_the_finished():
    network = line(4)
    inboxes = {i: [] for i in range(4)}

    def act(state: tuple[int, int], inbox: list[int]) -> tuple[int, int]:
        inboxes[state[0]].append(inbox)
        return state[0], state[1] - 1

    # Agent i finishes after i + 1 rounds and tells its number all the time.
    states = {i: (i, i + 1) for i in range(4)}
    assert len(list(run_rounds(network, states, act, lambda s: s[0], lambda s: s[1] == 0))) == 4
    assert inboxes == {0: [[1]], 1: [[0, 2]] * 2, 2: [[1, 3]] * 3, 3: [[2]] * 4}


def test_dead_agents_neither_act_nor_send():
    alive = np.array([True, False, True])
    network = CommunicationGraph.from_positions(np.array([[0.0], [1.0], [2.0]]), 1.5, alive)
    assert [n.tolist() for n in network.neighbors] == [[], [], []]
    assert network.component.tolist() == [0, -1, 1]
    assert flood(network, {0: 1, 2: 2}, max) == {0: 1, 2: 2}


def test_agents_exactly_one_radius_apart_are_neighbors():
    network = CommunicationGraph.from_positions(
        np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 9.1]]), 5.0, np.full(3, True)
    )
    assert [n.tolist() for n in network.neighbors] == [[1], [0], []]


def test_position_of_a_dead_agent_is_ignored():
    position = np.array([[0.0, 0.0], [np.nan, np.nan], [1.0, 0.0]])
    network = CommunicationGraph.from_positions(position, 2.0, np.array([True, False, True]))
    assert network.diameter.tolist() == [1, 0, 1]


def test_swarm_without_live_agents_has_no_components():
    network = CommunicationGraph.from_positions(np.zeros((2, 3)), 1.0, np.full(2, False))
    assert network.component.tolist() == [-1, -1]
    assert learn_diameter(network).tolist() == [0, 0]


def test_invalid_graph_is_refused():
    one_way = np.array([[False, True], [False, False]])
    with pytest.raises(ValueError, match="agent 0 hears agent 1 but not the other way round"):
        CommunicationGraph(one_way, np.full(2, True))
    with pytest.raises(ValueError, match="agent 1 is its own neighbor"):
        CommunicationGraph(np.diag([False, True]), np.full(2, True))
    with pytest.raises(ValueError, match="agent 1 is not alive but has neighbors"):
        CommunicationGraph(one_way | one_way.T, np.array([True, False]))
    with pytest.raises(ValueError, match="must be positive, got -1"):
        CommunicationGraph.from_positions(np.zeros((2, 2)), -1.0, np.full(2, True))


def test_each_group_has_one_turn_one_of_each_component_at_a_time():
    hears = np.zeros((6, 6), dtype=bool)
    hears[0, 3] = hears[3, 0] = hears[1, 4] = hears[4, 1] = hears[4, 5] = hears[5, 4] = True
    network = CommunicationGraph(hears, np.arange(6) != 2)
    parties = [(i,) for i in (5, 4, 3, 1, 0)]
    assert schedule_turns(network, parties) == [[(0,), (1,)], [(3,), (4,)], [(5,)]]
