"""What robots tell each other: rows of the adjacency that travel, and messages on their way."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.sparse.csgraph import shortest_path
from scipy.stats import binom

from problems.graph import Sight, connectivity, graph, laplacian
from sato.connectivity import ConnectivityFlight
from sato.connectivity.flood import eigen, relay
from sato.connectivity.mail import Link, talk
from sato.connectivity.state import resting
from sato.connectivity.stick import Homing
from sato.connectivity.swarm import think


def chain(rng, agents=8):
    """Robots that hang together by a long way round."""
    while True:
        position = np.cumsum(rng.uniform([3, -2, -1], [6, 2, 1], (agents, 3)), axis=0)
        yaw = rng.uniform(-np.pi, np.pi, agents)
        weight = graph(position, yaw, Sight()).weight
        way = shortest_path(weight > 0, unweighted=True)
        if 4 <= way.max() < np.inf and connectivity(weight).lambda2 > 0.02:
            return position, yaw, weight, way


def at_rest(position, yaw, believed, estimator="flood"):
    """The team, and a state to think in while nobody moves."""
    mission = ConnectivityFlight(
        position, yaw, believed, Homing(np.zeros((0, 3))), estimator=estimator
    )
    rng = np.random.default_rng(0)
    return mission.team, resting(position, yaw, believed, 0, 0, rng), rng


def test_after_as_many_rounds_as_the_graph_is_wide_everybody_knows_lambda2(rng):
    for _ in range(5):
        position, yaw, weight, way = chain(rng)
        team, state, draws = at_rest(position, yaw, rng.uniform(-3, 3, (8, 8)))
        for number in range(int(way.max()) + 1):
            think(state, team, number, draws)
            # News travels an edge a round, neither faster nor slower.
            assert np.array_equal(state.mind.stamp > -np.inf, way <= number)
        true = np.linalg.eigvalsh(laplacian(weight))[1]
        assert state.mind.lambda2 == pytest.approx(np.full(8, true), abs=1e-12)


@pytest.mark.parametrize("estimator", ["flood", "exact", "power_pi"])
def test_a_second_after_a_robot_died_nobody_counts_it_in(rng, estimator):
    position, yaw, _, _ = chain(rng)
    team, state, draws = at_rest(position, yaw, yaw - yaw[:, None], estimator)
    mind, last = state.mind, 30
    for number in range(last + 1):
        think(state, team, number, draws)
    state.world.alive[3] = False
    live = np.arange(8) != 3
    for number in range(last + 1, last + 49):
        think(state, team, number, draws)
    if estimator == "flood":  # its last row is just not yet too old
        assert mind.felt[[2, 4], 3].any()
    for number in range(last + 49, last + 51):
        think(state, team, number, draws)
    assert not mind.weight[live, 3].any() and not mind.motion[live, 3].any()
    if estimator != "power_pi":  # whose iterate of a lost one rests, and meets no motion
        assert not mind.felt[live, 3].any()


def test_the_rest_reckons_with_the_rest_alone(rng):
    position, yaw, weight, _ = chain(rng)
    team, state, draws = at_rest(position, yaw, yaw - yaw[:, None])
    state.world.alive[7] = False
    for number in range(10):
        think(state, team, number, draws)
    rest = np.linalg.eigvalsh(laplacian(weight[:7, :7]))[1]
    assert state.mind.lambda2[:7] == pytest.approx(np.full(7, rest), abs=1e-12)


TALES = st.lists(
    st.tuples(st.integers(0, 4), st.integers(0, 4), st.booleans()), min_size=1, max_size=60
)


@given(TALES)
def test_a_row_never_goes_back_in_time_whoever_passes_it_on(tales):
    # Rows say who computed them and when, so that any mixture would show.
    rows, stamp = np.zeros((5, 5, 5)), np.full((5, 5), -np.inf)
    for time, (a, b, computes) in enumerate(tales):
        if computes:
            rows[a, a], stamp[a, a] = 10 * time + a, time
            continue
        before, heard = stamp[a].copy(), stamp[b].copy()
        relay(rows[a], stamp[a], rows[b], stamp[b])
        assert np.array_equal(stamp[a], np.maximum(before, heard))
    held = stamp > -np.inf
    told = np.broadcast_to(np.where(held, 10 * stamp + np.arange(5), 0)[..., None], rows.shape)
    assert np.array_equal(rows, told)


@given(st.integers(3, 9), st.integers(0, 2**32 - 1))
def test_what_a_robot_feels_is_what_lambda2_feels(agents, seed):
    rng = np.random.default_rng(seed)
    weight = np.triu(rng.uniform(0.05, 1, (agents, agents)), 1)
    weight += weight.T
    whole, felt = connectivity(weight), np.zeros(agents)
    assume(whole.lambda3 - whole.lambda2 > 1e-4)
    for i in range(agents):
        assert eigen(weight, np.zeros(agents), i, 0.0, felt) == pytest.approx(whole.lambda2)
        # Vectors of eigenvalues that are 1e-4 apart are good to some 1e-11.
        assert felt == pytest.approx(whole.felt[i], abs=1e-9)


@pytest.mark.parametrize("agents", [2, 3, 6, 20])
def test_of_a_multiple_eigenvalue_all_edges_feel_alike(agents):
    # With v₂ … v_n an orthonormal basis of what is orthogonal to 1, Σ (v_i − v_j)² = 2.
    weight, felt = 0.7 * (np.ones((agents, agents)) - np.eye(agents)), np.zeros(agents)
    assert eigen(weight, np.zeros(agents), 0, 0.0, felt) == pytest.approx(0.7 * agents)
    assert felt == pytest.approx(np.append(0, np.full(agents - 1, 2 / (agents - 1))))


def test_who_knows_of_nobody_does_not_know_lambda2():
    stamp, felt = np.array([0.0, -np.inf, 3.0]), np.ones(3)
    assert np.isnan(eigen(np.ones((3, 3)), stamp, 2, 2.0, felt))
    assert not felt.any()


def listening(agents, link):
    """A state in which everybody has everybody in sight."""
    zero = np.zeros((agents, agents))
    state = resting(
        np.zeros((agents, 3)), np.zeros(agents), zero, link.late, 0, np.random.default_rng(0)
    )
    state.senses.sees[:] = ~np.eye(agents, dtype=bool)
    return state


@given(st.integers(1, 5), st.integers(0, 6))
def test_messages_come_as_often_and_as_late_as_is_said(every, late):
    link, step, rng = Link(every, late), 0.02, np.random.default_rng(0)
    _, senses, mail, mind = listening(3, link)
    for number in range(40):
        senses.velocity[:], senses.rate[:] = number, -number
        talk(senses, mail, mind, link, True, number, step, rng)
        told = (number // every - late) * every
        for i, j in ((0, 1), (2, 0)):
            if told < 0:
                assert mail.when[i, j] == -np.inf
            else:
                assert mail.when[i, j] == pytest.approx(told * step, abs=1e-12)
                assert mail.his_motion[i, j] == pytest.approx([told, told, told, -told])


def test_as_many_messages_are_lost_as_is_said_and_none_between_strangers(rng):
    link, rounds = Link(loss=0.1), 400
    _, senses, mail, mind = listening(6, link)
    senses.sees[0, 1] = senses.sees[1, 0] = False
    senses.sees[2, 3] = False  # who is seen hears too
    heard = np.zeros((6, 6))
    for number in range(rounds):
        talk(senses, mail, mind, link, False, number, 1.0, rng)
        heard += mail.when == number
    assert not heard[0, 1] and not heard[1, 0] and not np.diag(heard).any()
    pairs = heard[(senses.sees | senses.sees.T)]
    low, high = binom.ppf([1e-6, 1 - 1e-6], rounds, 0.9)
    assert ((low <= pairs) & (pairs <= high)).all()
    low, high = binom.ppf([1e-3, 1 - 1e-3], rounds * len(pairs), 0.9)
    assert low <= pairs.sum() <= high
