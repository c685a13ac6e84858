"""Roundabouts: who comes to one, on which hand, and what it saves."""

from dataclasses import replace

import numpy as np
import pytest
from swarm_cast import (
    RADIUS,
    agent,
    as_before,
    circle,
    continuous_separation,
    crowd,
    everybody,
    heard,
    paid,
    parked,
    problem,
)

from problems.convexify import apart
from sato.network import Network
from sato.scp import bargain, come_to_terms, settle_orders
from sato.scp.orders import bent
from sato.scp.roundabout import keep_clear, round_about, turns


def spin(planners):
    """By how much each turns about the middle of the circle on its way: positive to the left."""
    found = []
    for p in planners.values():
        place, speed = p.flight.x[:, :2], p.flight.x[:, 2:]
        found.append(np.sum(place[:, 0] * speed[:, 1] - place[:, 1] * speed[:, 0]))
    return np.array(found)


@pytest.mark.parametrize(("bend", "hand"), [(1.0, 1), (2.0, 1), (-1.0, -1), (-2.0, -1)])
def test_at_a_roundabout_all_go_round_the_same_way_stay_apart_and_arrive(bend, hand):
    planners = circle(5, 1.5)
    found = round_about(planners, everybody(planners), bend)
    assert found.planners.keys() == planners.keys()
    assert np.all(hand * spin(found.planners) > 0)
    assert continuous_separation(found.planners) >= RADIUS
    for p in found.planners.values():
        np.testing.assert_allclose(p.flight.x[-1], p.goal, atol=1e-6)
        np.testing.assert_array_equal(p.path, p.horizon.path(p.flight.x, p.flight.u))
        assert np.abs(p.flight.u).max() <= p.transfer.max_control * (1 + 1e-9)
    assert found.solves == sum(p.solves for p in found.planners.values()) >= 5
    assert found.exchanges >= 5 + 2  # a turn each, all hear whether they are clear, one flood


def test_terms_cost_less_than_orders_and_bargains_where_all_meet_in_one_point():
    planners = circle(5, 1.5)
    network = everybody(planners)
    ordered = bargain(settle_orders(planners, network, 2).planners, network, 2)
    terms = come_to_terms(planners, network, 2, 2)
    assert paid(terms.planners)[:2] == (0, 0)
    assert paid(terms.planners)[2] < 0.95 * paid(ordered.planners)[2]
    assert continuous_separation(terms.planners) >= RADIUS
    assert terms.solves > ordered.solves and terms.exchanges > ordered.exchanges


def test_terms_never_cost_more_than_orders_and_bargains(rng):
    for _ in range(2):
        planners = crowd(rng, 4, box=3.0)
        network = everybody(planners)
        ordered = bargain(settle_orders(planners, network, 2).planners, network, 2)
        terms = come_to_terms(planners, network, 2, 2)
        assert paid(terms.planners) <= paid(ordered.planners)
        assert continuous_separation(terms.planners) >= RADIUS


@pytest.mark.parametrize("axes", [2, 3])
def test_without_sweeps_or_in_space_there_are_no_roundabouts(rng, axes):
    planners = crowd(rng, 4, axes)
    network, sweeps = everybody(planners), axes - 2
    settled = settle_orders(planners, network, 2)
    ordered = bargain(settled.planners, network, sweeps)
    terms = come_to_terms(planners, network, 2, sweeps)
    assert terms.solves == settled.solves + ordered.solves
    for i, p in ordered.planners.items():
        np.testing.assert_array_equal(p.flight.u, terms.planners[i].flight.u)


def test_who_begins_with_a_plan_of_before_does_not_go_about_anew(rng):
    planners = circle(4, 1.5)
    begun = as_before(planners, round_about(planners, everybody(planners), 1.0).planners)
    assert round_about(begun, everybody(begun), -1.0) == ({}, 0, 0)


def test_networks_that_do_not_hear_each_other_go_round_for_themselves():
    left, right = circle(4, 1.5), circle(3, 1.5)
    both = left | {4 + i: p._replace(rank=(*p.rank[:2], 4 + i)) for i, p in right.items()}
    hears = np.zeros((7, 7), dtype=bool)
    hears[:4, :4] = hears[4:, 4:] = True
    np.fill_diagonal(hears, False)
    together = round_about(both, heard(hears), 1.0).planners
    for some, first in ((left, 0), (right, 4)):
        for i, p in round_about(some, everybody(some), 1.0).planners.items():
            np.testing.assert_array_equal(p.flight.u, together[first + i].flight.u)


def test_one_of_every_network_has_its_turn_at_a_time_and_each_once():
    hears = np.zeros((6, 6), dtype=bool)
    hears[0, 3] = hears[3, 0] = hears[1, 4] = hears[4, 1] = hears[4, 5] = hears[5, 4] = True
    network = Network(hears, np.arange(6) != 2)
    planners = {i: p for i, p in circle(6, 1.5).items() if i != 2}
    assert turns(planners, network) == [[0, 1], [3, 4], [5]]


def test_in_its_turn_one_keeps_clear_of_all_whom_it_hears_whoever_goes_first():
    planners = {i: bent(p, 0.3) for i, p in circle(4, 1.5).items()}
    told = tuple(planners[i].plan for i in (1, 2, 3))
    first = planners[0]._replace(rank=(True, -99.0, 0))
    after, same = keep_clear(planners[0], told), keep_clear(first, told)
    np.testing.assert_array_equal(after.path, same.path)
    assert all(apart(after.path - plan.path, RADIUS).all() for plan in told)
    assert not all(apart(planners[0].path - plan.path, RADIUS).all() for plan in told)


def test_in_its_turn_one_linearises_about_its_own_flight_and_is_not_sloped():
    planners = circle(3, 1.5)
    asked = []

    def about(flight):
        asked.append(flight)
        return replace(planners[0].transfer, slope=0.5)

    curved = planners[0]._replace(about=about)
    told = (planners[1].plan,)
    after = keep_clear(curved, told)
    assert asked == [planners[0].flight]
    assert after.transfer.slope == 0.5
    np.testing.assert_array_equal(after.path, keep_clear(planners[0], told).path)


def test_where_somebody_finds_no_way_nobody_of_its_network_goes_round():
    transfer, horizon = problem()
    me = agent(2, [-1.0, 0.0], [0.0, 0.0], transfer, horizon)
    walls = {i: parked(i, np.array([0.1 * i, 0.0]), transfer, horizon) for i in range(2)}
    far = {3 + i: p._replace(rank=(True, 0.0, 3 + i)) for i, p in circle(3, 1.5).items()}
    hears = np.zeros((6, 6), dtype=bool)
    hears[:3, :3] = hears[3:, 3:] = True
    np.fill_diagonal(hears, False)
    found = round_about(walls | {2: me} | far, heard(hears), 1.0)
    assert found.planners.keys() == far.keys()
    assert found.solves > sum(p.solves for p in found.planners.values())


def test_who_cannot_move_stays_and_all_go_round_it():
    planners = circle(4, 1.5)
    place = np.array([0.0, 0.0])
    still = parked(4, place, planners[0].transfer, planners[0].horizon)
    found = round_about(planners | {4: still}, everybody(planners | {4: still}), 1.0).planners
    assert found.keys() == {0, 1, 2, 3, 4}
    np.testing.assert_array_equal(found[4].path, still.path)
    for i in range(4):
        assert apart(found[i].path - still.path, RADIUS).all()
