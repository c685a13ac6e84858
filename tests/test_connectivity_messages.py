"""What robots tell each other: rows of the adjacency that travel, and messages on their way."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from scipy.sparse.csgraph import shortest_path
from scipy.stats import binom

from problems.graph import Sight, connectivity, gradient, graph, laplacian
from sato.connectivity import ConnectivityFlight, Death, fly
from sato.connectivity.flood import feel_edges, relay
from sato.connectivity.log import rotated
from sato.connectivity.mail import Link, talk
from sato.connectivity.potential import Potential, Repulsion, steepness
from sato.connectivity.state import resting
from sato.connectivity.stick import Homing

GENTLE = Potential(strength=1e-15)  # nobody gets anywhere


def chain(rng, agents=8):
    """Robots that hang together by a long way round."""
    while True:
        position = np.cumsum(rng.uniform([3, -2, -1], [6, 2, 1], (agents, 3)), axis=0)
        yaw = rng.uniform(-np.pi, np.pi, agents)
        weight = graph(position, yaw, Sight()).weight
        way = shortest_path(weight > 0, unweighted=True)
        if 4 <= way.max() < np.inf and connectivity(weight).lambda2 > 0.02:
            return position, yaw, weight, way


def rested(position, yaw, believed, duration, **settings):
    """Frames of robots that do next to nothing, but reckon what they would do."""
    mission = ConnectivityFlight(
        position, yaw, believed, Homing(np.zeros((0, 3))), duration,
        potential=GENTLE, repulsion=Repulsion(strength=0.0), **settings,
    )  # fmt: skip
    return list(fly(mission, np.random.default_rng(0)))


def test_after_as_many_rounds_as_the_graph_is_wide_everybody_knows_lambda2(rng):
    for _ in range(5):
        position, yaw, weight, way = chain(rng)
        wide = int(way.max())
        frames = rested(position, yaw, rng.uniform(-3, 3, (8, 8)), wide * 0.02)
        for rounds, frame in enumerate(frames):
            # News travels an edge a round, neither faster nor slower; edges are known at once.
            assert np.array_equal(frame.counts, way <= max(rounds, 1))
        true = np.linalg.eigvalsh(laplacian(weight))[1]
        assert frames[wide].lambda2_estimate == pytest.approx(np.full(8, true), abs=1e-12)


@pytest.mark.parametrize("estimator", ["flood", "exact"])
def test_a_second_after_a_robot_died_the_rest_act_as_if_it_had_never_been(rng, estimator):
    position, yaw, _, _ = chain(rng)
    death = {"deaths": (Death(7, 0.6),), "estimator": estimator}
    frames = rested(position, yaw, yaw - yaw[:, None], 1.6, **death)
    before, late, last = frames[29], frames[60], frames[80]
    assert before.counts[:7, 7].any() and not last.counts[:7, 7].any()
    # Whose row is not yet too old still has a part in λ₂ where rows are passed on.
    assert late.counts[:7, 7].any() == (estimator == "flood")
    rest = gradient(position[:7], yaw[:7], Sight())
    lambda2 = connectivity(graph(position[:7], yaw[:7], Sight()).weight).lambda2
    assert last.lambda2_estimate[:7] == pytest.approx(np.full(7, lambda2), rel=1e-6)
    action = np.column_stack([rest.position, rest.yaw]) * steepness(float(lambda2), GENTLE)
    did = np.column_stack([rotated(last.command[:7, :3], yaw[:7]), last.command[:7, 3]])
    assert did == pytest.approx(action, rel=1e-5, abs=1e-5 * np.abs(action).max())


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
def test_what_a_robot_feels_of_its_edges_is_what_lambda2_feels(agents, seed):
    rng = np.random.default_rng(seed)
    weight = np.triu(rng.uniform(0.05, 1, (agents, agents)), 1)
    weight += weight.T
    whole, vectors = connectivity(weight), np.linalg.eigh(laplacian(weight))[1].T[1:2].copy()
    assume(whole.lambda3 - whole.lambda2 > 1e-4)
    # Two robots do not count, and nobody feels them.
    known, felt = np.delete(np.arange(agents + 2), [1, 3]), np.zeros(agents + 2)
    for at, me in enumerate(known):
        feel_edges(vectors, known, me, felt)
        assert felt[known] == pytest.approx(whole.felt[at], abs=1e-12)
        assert not felt[[1, 3]].any()


@given(st.integers(3, 20), st.integers(0, 2**32 - 1))
def test_of_a_multiple_eigenvalue_all_edges_feel_alike_whatever_the_basis(agents, seed):
    # v₂ … v_n are any orthonormal basis of what is orthogonal to 1: Σ (v_i − v_j)² = 2.
    rng = np.random.default_rng(seed)
    beside = np.column_stack([np.ones(agents), rng.standard_normal((agents, agents - 1))])
    basis = np.linalg.qr(beside)[0].T[1:].copy()
    known, felt = np.arange(agents), np.zeros(agents)
    feel_edges(basis, known, 0, felt)
    assert felt == pytest.approx(np.append(0, np.full(agents - 1, 2 / (agents - 1))), abs=1e-12)


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
