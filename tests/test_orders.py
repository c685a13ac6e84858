"""Several orders of priority: what is kept, who decides it, and what it saves."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from swarm_cast import (
    RADIUS,
    agent,
    continuous_separation,
    crowd,
    everybody,
    heard,
    parked,
    problem,
)

from sato.network import Network, flood
from sato.scp import settle, settle_orders
from sato.scp.orders import Toll, to_the_right, toll, totals


def paid(planners):
    return tuple(np.sum([toll(agent) for agent in planners.values()], axis=0))


def round_a_circle(count, radius, turn=0.03):
    """Agents that all change sides of a circle: every pair meets in the middle."""
    transfer, horizon = problem(2, horizon_steps=12)
    angle = 2 * np.pi * np.arange(count) / count
    start = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    goal = -radius * np.stack([np.cos(angle + turn), np.sin(angle + turn)], axis=1)
    return {i: agent(i, start[i], goal[i], transfer, horizon) for i in range(count)}


@given(
    links=st.lists(st.booleans(), min_size=21, max_size=21),
    dead=st.sets(st.integers(0, 6), max_size=3),
    seed=st.integers(0, 99),
)
def test_totals_are_what_each_adds_up_from_a_flood_of_its_network(links, dead, seed):
    alive = np.array([i not in dead for i in range(7)])
    hears = np.zeros((7, 7), dtype=bool)
    hears[np.triu_indices(7, 1)] = links
    hears = (hears | hears.T) & alive & alive[:, None]
    network = Network(hears, alive)
    draw = np.random.default_rng(seed)
    tolls = {
        i: Toll(*draw.integers(0, 2, 2).astype(float), draw.random())
        for i in np.flatnonzero(alive).tolist()
    }
    told = [{i: tolls[i]} if i in tolls else {} for i in range(7)]
    for i, known in enumerate(flood(network, told, dict.__or__)):
        if i in tolls:
            added = np.sum([known[j] for j in sorted(known)], axis=0)
            np.testing.assert_allclose(totals(tolls, network)[i], added, rtol=1e-12)


def test_all_of_a_network_agree_to_the_last_bit(rng):
    network = heard(~np.eye(9, dtype=bool))
    tolls = {i: Toll(0.0, 0.0, rng.random()) for i in rng.permutation(9).tolist()}
    assert len(set(totals(tolls, network).values())) == 1


def test_one_order_is_method_2_itself(rng):
    planners = crowd(rng, 5)
    once, exchanges = settle(planners, everybody(planners))
    found = settle_orders(planners, everybody(planners), 1)
    assert found.exchanges == exchanges
    assert found.solves == sum(p.solves for p in once.values())
    for i, p in once.items():
        np.testing.assert_array_equal(p.flight.u, found.planners[i].flight.u)


@pytest.mark.parametrize("axes", [2, 3])
def test_more_orders_never_cost_more_and_keep_the_distance(rng, axes):
    saved = 0.0
    for _ in range(3):
        planners = crowd(rng, 5, axes, box=3.5)
        tried = [
            settle_orders(planners, everybody(planners), orders).planners for orders in (1, 2, 4)
        ]
        costs = [paid(after) for after in tried]
        assert costs == sorted(costs, reverse=True)
        assert tried[-1].keys() == planners.keys()
        assert all(p.settled for p in tried[-1].values())
        if not costs[-1][0]:
            assert continuous_separation(tried[-1]) >= RADIUS
        saved += costs[0][2] - costs[-1][2]
    assert saved > 0


def test_networks_that_do_not_hear_each_other_choose_for_themselves(rng):
    left, right = crowd(rng, 4), crowd(rng, 3)
    both = left | {4 + i: p._replace(rank=(True, 0.0, 4 + i)) for i, p in right.items()}
    hears = np.zeros((7, 7), dtype=bool)
    hears[:4, :4] = hears[4:, 4:] = True
    np.fill_diagonal(hears, False)
    together = settle_orders(both, heard(hears), 4).planners
    alone = settle_orders(left, everybody(left), 4).planners
    for i, p in alone.items():
        np.testing.assert_array_equal(p.flight.u, together[i].flight.u)


def test_who_flies_straight_to_its_goal_has_nothing_to_settle_anew():
    transfer, horizon = problem()
    planners = {i: agent(i, [0.0, 4.0 * i], [2.0, 4.0 * i], transfer, horizon) for i in range(3)}
    once, exchanges = settle(planners, everybody(planners))
    found = settle_orders(planners, everybody(planners), 9)
    assert (found.exchanges, found.solves) == (exchanges, 0)
    assert all(found.planners[i].flight is once[i].flight for i in once)


def test_who_cannot_move_stays_and_all_settle_around_it(rng):
    planners = crowd(rng, 4)
    still = planners[0]
    planners[0] = parked(0, still.flight.x[0, :2], still.transfer, still.horizon)
    after = settle_orders(planners, everybody(planners), 4).planners
    assert after[0].flight is planners[0].flight
    assert all(p.settled for p in after.values())


def test_where_all_meet_in_one_point_one_order_fails_and_several_find_a_way():
    planners = round_a_circle(6, 1.5)
    once = settle_orders(planners, everybody(planners), 1).planners
    after = settle_orders(planners, everybody(planners), 6).planners
    assert paid(once)[1] > 0
    assert paid(after)[:2] == (0, 0)
    assert continuous_separation(after) >= RADIUS


@settings(max_examples=20, deadline=None)
@given(angle=st.floats(0, 2 * np.pi), length=st.floats(1.0, 3.0))
def test_keeping_to_the_right_begins_and_ends_on_the_way_and_is_r_aside_in_the_middle(
    angle, length
):
    transfer, horizon = problem()
    way = length * np.array([np.cos(angle), np.sin(angle)])
    straight = agent(0, np.zeros(2), way, transfer, horizon)
    bent = to_the_right(straight)
    aside = (bent.path - straight.path) @ (np.array([way[1], -way[0]]) / length)
    assert abs(aside[0, 0]) < 1e-12 > abs(aside[-1, -1])
    assert np.all(aside > -1e-12)
    np.testing.assert_allclose(aside.max(), RADIUS, rtol=0.01)
    np.testing.assert_allclose(bent.path[1:, 0], bent.path[:-1, -1], atol=1e-12)


def test_in_space_nobody_keeps_to_the_right(rng):
    planners = crowd(rng, 2, axes=3)
    assert to_the_right(planners[0]) is planners[0]


def test_a_horizon_that_ends_early_does_not_matter(rng):
    planners = crowd(rng, 4)
    short = problem(horizon_steps=4)[1]
    seen = {
        i: p._replace(horizon=short, path=short.path(p.flight.x, p.flight.u))
        for i, p in planners.items()
    }
    after = settle_orders(seen, everybody(seen), 3).planners
    assert all(p.settled for p in after.values())
