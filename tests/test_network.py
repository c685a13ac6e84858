"""Communication graphs, rounds of messages, and protocols built from them."""

import numpy as np
import pytest
from graphs import line, random_graph
from hypothesis import given, settings
from hypothesis import strategies as st
from messages import flood, learn_diameter, run_rounds

from sato.network.graph import FAR, CommunicationGraph
from sato.network.rounds import schedule_turns

LAW = settings(deadline=None, derandomize=True)


@st.composite
def networks(draw: st.DrawFn, most: int = 12) -> CommunicationGraph:
    agents = draw(st.integers(1, most))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    alive, share = draw(st.sampled_from([1.0, 0.8])), draw(st.sampled_from([0.1, 0.2, 0.5]))
    return random_graph(rng, agents, share, alive)


def all_hops(graph: CommunicationGraph) -> np.ndarray:
    # Powers of the adjacency, independent of any shortest-path code.
    agents = len(graph.alive)
    hops = np.full((agents, agents), np.inf)
    reach = np.eye(agents, dtype=bool)
    for d in range(agents):
        hops[reach & np.isinf(hops)] = d
        reach = (reach.astype(int) @ (graph.adjacency | np.eye(agents, dtype=bool))) > 0
    return hops


@LAW
@given(networks(), st.randoms(use_true_random=False))
def test_pairs_of_neighbors_are_those_of_the_adjacency_in_order(graph, random):
    agents = random.sample(range(len(graph.alive)), random.randint(0, len(graph.alive)))
    i, j = np.nonzero(np.triu(graph.adjacency[np.ix_(agents, agents)]))
    found = graph.pairs_among(agents)
    assert np.array_equal(found[0], i) and np.array_equal(found[1], j)


@LAW
@given(networks())
def test_diameter_is_learned_after_three_eccentricities(graph):
    hops = all_hops(graph)
    farthest = np.max(hops, axis=1, where=np.isfinite(hops), initial=0)
    diameter = [int(farthest[np.isfinite(row)].max()) for row in hops]
    assert np.array_equal(graph.hops, np.where(np.isinf(hops), FAR, hops))
    assert graph.diameter.tolist() == diameter
    history = list(learn_diameter(graph))
    for i in np.flatnonzero(graph.alive).tolist():
        agent, e = history[-1][i], int(farthest[i])
        assert (agent.eccentricity, agent.message.max_eccentricity) == (e, diameter[i])
        assert agent.round == 3 * e + 1 <= 3 * diameter[i] + 1


@LAW
@given(networks())
def test_components_are_connected_by_paths(graph):
    hops, component = all_hops(graph), graph.component
    for i in range(len(hops)):
        if not graph.alive[i]:
            assert component[i] == -1
            continue
        together = (component == component[i]).tolist()
        assert together == np.isfinite(hops[i]).tolist()
    seen = [c for c in component.tolist() if c >= 0]
    assert list(dict.fromkeys(seen)) == list(range(len(set(seen))))  # by lowest member


@LAW
@given(networks(), st.integers(0, 2**32 - 1))
def test_flood_of_max_equals_component_max(graph, seed):
    values = np.random.default_rng(seed).integers(1, 50, len(graph.alive))
    largest = graph.component_max(values)
    told = {i: int(values[i]) for i in np.flatnonzero(graph.alive).tolist()}
    assert flood(graph, told, max) == {i: largest[i] for i in told}


def test_news_travels_one_hop_a_round():
    graph = line(6)
    states = {i: frozenset([i]) for i in range(6)}
    history = run_rounds(
        graph,
        states,
        lambda mine, inbox: mine.union(*inbox),
        lambda mine: mine,
        lambda mine: len(mine) == 6,
    )
    for r, now in enumerate(history, start=1):
        for i in range(6):
            assert now[i] == {j for j in range(6) if abs(i - j) <= r}


def test_agent_hears_its_neighbors_alone_also_the_finished():
    graph = line(4)
    inboxes = {i: [] for i in range(4)}

    def act(state: tuple[int, int], inbox: list[int]) -> tuple[int, int]:
        inboxes[state[0]].append(inbox)
        return state[0], state[1] - 1

    # Agent i finishes after i + 1 rounds and sends its number in each.
    states = {i: (i, i + 1) for i in range(4)}
    assert len(list(run_rounds(graph, states, act, lambda s: s[0], lambda s: s[1] == 0))) == 4
    assert inboxes == {0: [[1]], 1: [[0, 2]] * 2, 2: [[1, 3]] * 3, 3: [[2]] * 4}


def test_dead_agents_neither_act_nor_send():
    alive = np.array([True, False, True])
    graph = CommunicationGraph.from_positions(np.array([[0.0], [1.0], [2.0]]), 1.5, alive)
    assert [n.tolist() for n in graph.neighbors] == [[], [], []]
    assert graph.component.tolist() == [0, -1, 1]
    assert flood(graph, {0: 1, 2: 2}, max) == {0: 1, 2: 2}


def test_agents_exactly_one_radius_apart_are_neighbors():
    graph = CommunicationGraph.from_positions(
        np.array([[0.0, 0.0], [3.0, 4.0], [3.0, 9.1]]), 5.0, np.full(3, True)
    )
    assert [n.tolist() for n in graph.neighbors] == [[1], [0], []]


def test_position_of_a_dead_agent_is_ignored():
    position = np.array([[0.0, 0.0], [np.nan, np.nan], [1.0, 0.0]])
    graph = CommunicationGraph.from_positions(position, 2.0, np.array([True, False, True]))
    assert graph.diameter.tolist() == [1, 0, 1]


def test_swarm_without_live_agents_has_no_components():
    graph = CommunicationGraph.from_positions(np.zeros((2, 3)), 1.0, np.full(2, False))
    assert graph.component.tolist() == [-1, -1]
    assert list(learn_diameter(graph)) == []


def test_invalid_graph_is_refused():
    one_way = np.array([[False, True], [False, False]])
    with pytest.raises(ValueError, match="agent 0 hears agent 1 but not the other way round"):
        CommunicationGraph(one_way, np.full(2, True))
    with pytest.raises(ValueError, match="agent 1 is its own neighbor"):
        CommunicationGraph(np.diag([False, True]), np.full(2, True))
    with pytest.raises(ValueError, match="agent 1 is not alive but has neighbors"):
        CommunicationGraph(one_way | one_way.T, np.array([True, False]))
    with pytest.raises(ValueError, match="radius: must be a number above 0, got -1"):
        CommunicationGraph.from_positions(np.zeros((2, 2)), -1.0, np.full(2, True))


def test_each_group_has_one_turn_one_of_each_component_at_a_time():
    adjacency = np.zeros((6, 6), dtype=bool)
    adjacency[0, 3] = adjacency[3, 0] = adjacency[1, 4] = adjacency[4, 1] = adjacency[
        4, 5
    ] = adjacency[5, 4] = True
    graph = CommunicationGraph(adjacency, np.arange(6) != 2)
    parties = [(i,) for i in (5, 4, 3, 1, 0)]
    assert schedule_turns(graph, parties) == [[(0,), (1,)], [(3,), (4,)], [(5,)]]
