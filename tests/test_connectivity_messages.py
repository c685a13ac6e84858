"""Messages: flooded rows of the adjacency matrix, period, delay and loss."""

from collections import deque
from functools import partial

import numpy as np
import pytest
from connectivity_cast import fly, posed
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.sparse.csgraph import shortest_path
from scipy.stats import binom

from dynamics.vehicle import rotate_by_yaw
from problems.interaction_graph import (
    Camera,
    algebraic_connectivity,
    interaction_graph,
    lambda2_gradient,
    laplacian,
    spectral_slope,
)
from sato.connectivity.controller import act_on_rows, negative_slope
from sato.connectivity.messages import exchange_messages, merge_rows
from sato.connectivity.mission import AgentLoss, Connectivity
from sato.connectivity.settings import Potential, Repulsion
from sato.connectivity.state import AdjacencyRows, Knowledge
from sato.network.link import Link
from sato.network.outages import PairOutages

STEP = 0.005  # [s]
GENTLE = Potential(strength=1e-15, of="lambda2")  # nobody gets anywhere


def chain(rng, agents=8):
    """Draw a connected graph of large diameter."""
    while True:
        position = np.cumsum(rng.uniform([3, -2, -1], [6, 2, 1], (agents, 3)), axis=0)
        yaw = rng.uniform(-np.pi, np.pi, agents)
        weight = interaction_graph(position, yaw, Camera()).weights
        way = shortest_path(weight > 0, unweighted=True)
        if 4 <= way.max() < np.inf and algebraic_connectivity(weight).lambda2 > 0.02:
            return position, yaw, weight, way


def rested(position, yaw, believed, duration, **settings):
    """Fly robots whose commands are negligible but computed."""
    weak = {"potential": GENTLE, "repulsion": Repulsion(strength=0.0)}
    return fly(posed(position, yaw, believed, duration=duration, **weak, **settings))


def test_flooding_finds_lambda2_after_as_many_rounds_as_the_diameter(rng):
    for _ in range(5):
        position, yaw, weight, way = chain(rng)
        wide = int(way.max())
        frames = rested(position, yaw, rng.uniform(-3, 3, (8, 8)), wide * 0.02)
        for rounds, frame in enumerate(frames):
            # News travels an edge a round, neither faster nor slower; edges are known at once.
            assert np.array_equal(frame.known_agents, way <= max(rounds, 1))
        true = np.linalg.eigvalsh(laplacian(weight))[1]
        assert frames[wide].lambda2_estimate == pytest.approx(np.full(8, true), abs=1e-12)


@pytest.mark.parametrize("estimator", ["flood", "exact"])
def test_a_second_after_a_loss_the_rest_act_as_a_smaller_swarm(rng, estimator):
    position, yaw, _, _ = chain(rng)
    death = {"losses": (AgentLoss(7, 0.6),), "estimator": estimator}
    frames = rested(position, yaw, yaw - yaw[:, None], 1.6, **death)
    before, late, last = frames[29], frames[60], frames[80]
    assert before.known_agents[:7, 7].any() and not last.known_agents[:7, 7].any()
    # Whose row is not yet too old still has a part in λ₂ where rows are passed on.
    assert late.known_agents[:7, 7].any() == (estimator == "flood")
    rest = lambda2_gradient(position[:7], yaw[:7], Camera())
    lambda2 = algebraic_connectivity(
        interaction_graph(position[:7], yaw[:7], Camera()).weights
    ).lambda2
    assert last.lambda2_estimate[:7] == pytest.approx(np.full(7, lambda2), rel=1e-6)
    action = np.column_stack([rest.position, rest.yaw]) * negative_slope(float(lambda2), GENTLE)
    did = np.column_stack([rotate_by_yaw(last.velocity_command[:7], yaw[:7]), last.yaw_rate[:7]])
    assert did == pytest.approx(action, rel=1e-5, abs=1e-5 * np.abs(action).max())


TALES = st.lists(
    st.tuples(st.integers(0, 4), st.integers(0, 4), st.booleans()), min_size=1, max_size=60
)


@given(TALES)
def test_relayed_rows_never_become_older(tales):
    # Rows say who computed them and when, so that any mixture would show.
    known = AdjacencyRows(np.zeros((5, 5, 5)), np.full((5, 5), -np.inf))
    for time, (a, b, computes) in enumerate(tales):
        if computes:
            known.weight[a, a], known.time[a, a] = 10 * time + a, time
            continue
        hears = np.zeros((5, 5), dtype=bool)
        hears[a, b] = True
        merged = merge_rows(known, known, hears)
        assert np.array_equal(merged.time[a], np.maximum(known.time[a], known.time[b]))
        known = merged
    held = known.time > -np.inf
    told = np.broadcast_to(np.where(held, 10 * known.time + np.arange(5), 0)[..., None], (5, 5, 5))
    assert np.array_equal(known.weight, told)


@given(st.integers(3, 9), st.integers(0, 2**32 - 1))
def test_local_action_agrees_with_the_central_one(agents, seed):
    rng = np.random.default_rng(seed)
    weight = np.triu(rng.uniform(0.05, 1, (agents, agents)), 1)
    weight += weight.T
    whole = algebraic_connectivity(weight)
    assume(whole.lambda3 - whole.lambda2 > 1e-4)
    # Two robots do not count, and nobody feels them, whatever their rows say.
    known, rows = np.delete(np.arange(agents + 2), [1, 3]), rng.uniform(size=[agents + 2] * 3)
    rows[np.ix_(np.arange(agents + 2), known, known)] = weight
    time = np.ones((agents + 2, agents + 2))
    time[:, [1, 3]] = 0.0
    slope = partial(negative_slope, potential=Potential())
    _, central = spectral_slope(weight, slope, np.ones(agents, dtype=bool))
    alone = slope(whole.lambda2) * whole.weight_gradient
    for of, expected in (("lambda2", alone), ("spectrum", central)):
        lambda2, felt = act_on_rows(AdjacencyRows(rows, time), 0.5, Potential(of=of))
        assert lambda2 == pytest.approx(np.full(agents + 2, whole.lambda2), abs=1e-12)
        accuracy = 1e-9 * np.abs(expected).max()
        assert felt[np.ix_(known, known)] == pytest.approx(expected, abs=accuracy)
        assert not felt[:, [1, 3]].any()


class Listening:
    """Agents that all see each other, but for some pairs."""

    def __init__(self, agents, link, hidden=()):
        away = np.where(np.eye(agents)[..., None] == 1, np.nan, np.ones((agents, agents, 3)))
        for pair in hidden:
            away[pair] = np.nan
        self.mission = Connectivity(agents=agents, link=link, step=STEP)
        start = Knowledge.at_start(np.zeros((agents, agents)), np.random.default_rng(0))
        measured = start.measurements._replace(relative_position=away)
        self.known, self.messages = start._replace(measurements=measured), deque()

    def exchange(self, number, rng, outages=None):
        """Exchange messages, with a velocity that says their number."""
        said = np.full((len(self.known.inbox.time), 3), float(number))
        told = self.known.measurements._replace(velocity=said, yaw_rate=-said[:, 0])
        known = self.known._replace(measurements=told)
        exchange_messages(known, self.messages, self.mission, number, rng, outages)


def test_outages_of_links_keep_messages_out_in_both_directions():
    link, rounds, agents = Link(outage=4 * STEP, outage_share=0.5), 3000, 5
    rng, team = np.random.default_rng(1), Listening(agents, link)
    outages, heard = PairOutages(team.mission.timed_link, agents, rng), []
    for number in range(rounds):
        team.exchange(number, rng, outages)
        heard.append(team.known.inbox.is_new.copy())
    heard = np.array(heard)
    assert np.array_equal(heard, heard.transpose(0, 2, 1))
    i, j = np.triu_indices(agents, 1)
    assert heard[:, i, j].mean() == pytest.approx(0.5, abs=0.04)
    silent = np.diff(np.flatnonzero(heard[:, 0, 1])).max() - 1
    assert silent == 4 == team.mission.timed_link.outage_rounds


@given(st.integers(1, 5), st.integers(0, 6))
def test_messages_arrive_with_the_given_period_and_delay(every, late):
    rng, team = np.random.default_rng(0), Listening(3, Link(every, late))
    for number in range(40):
        team.exchange(number, rng)
        told = (number // every - late) * every
        for i, j in ((0, 1), (2, 0)):
            if told < 0:
                assert team.known.inbox.time[i, j] == -np.inf
            else:
                assert team.known.inbox.time[i, j] == pytest.approx(told * STEP, abs=1e-12)
                assert team.known.inbox.twist[i, j] == pytest.approx([told, told, told, -told])


def test_message_loss_has_the_given_rate_and_needs_visibility(rng):
    link, rounds = Link(loss_probability=0.1), 400
    team = Listening(6, link, hidden=[(0, 1), (1, 0), (2, 3)])  # who is seen hears too
    heard = np.zeros((6, 6))
    for number in range(rounds):
        team.exchange(number, rng)
        heard += team.known.inbox.is_new & (team.known.inbox.time == number * STEP)
    assert not heard[0, 1] and not heard[1, 0] and not np.diag(heard).any()
    sees = team.known.measurements.visibility
    pairs = heard[sees | sees.T]
    low, high = binom.ppf([1e-6, 1 - 1e-6], rounds, 0.9)
    assert ((low <= pairs) & (pairs <= high)).all()
    low, high = binom.ppf([1e-3, 1 - 1e-3], rounds * len(pairs), 0.9)
    assert low <= pairs.sum() <= high
