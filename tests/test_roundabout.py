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
    paid,
    parked,
    problem,
    strangers,
)

from problems.convexify import apart
from sato.network import Network, turns
from sato.scp import bargain, settle_orders
from sato.scp.orders import Settled, bent
from sato.scp.roundabout import BENDS, can_go_round, come_to_terms, keep_clear, round_about


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
    assert found.solves == sum(p.solves for p in found.planners.values()) == 5
    assert found.exchanges == 5 + 1 + 1  # a turn each, to hear who is clear, and to flood it


def test_whose_turn_comes_later_knows_what_others_have_planned_in_theirs():
    # If all answered what they had been told at first, these six would never be clear.
    planners = circle(6, 1.5)
    found = round_about(planners, everybody(planners), -1.0)
    assert (found.planners.keys(), found.solves) == (planners.keys(), 6)


def test_who_meets_somebody_after_a_round_has_another_turn():
    # Bent by so little, the first come too close in the first round and find a way in a later one.
    planners = circle(6, 1.5)
    found = round_about(planners, everybody(planners), 0.1)
    assert found.planners.keys() == planners.keys()
    assert found.exchanges % (6 + 2) == 0 and found.exchanges > 6 + 2
    assert found.solves == sum(p.solves for p in found.planners.values()) > 6
    assert continuous_separation(found.planners) >= RADIUS


def test_terms_are_orders_and_then_roundabouts_with_bargains_and_cheaper_in_one_point(monkeypatch):
    planners = circle(5, 1.5)
    network = everybody(planners)
    settled = settle_orders(planners, network, 2)
    ordered = bargain(settled.planners, network, 2)
    begun = round_about(planners, network, -1.0)
    dealt = bargain(begun.planners, network, 2)
    monkeypatch.setattr("sato.scp.roundabout.BENDS", [-1.0])
    terms = come_to_terms(planners, network, 2, 2)
    assert paid(terms.planners) == paid(dealt.planners)
    assert paid(terms.planners)[:2] == (0, 0)
    assert continuous_separation(terms.planners) >= RADIUS
    assert paid(terms.planners)[2] < 0.95 * paid(ordered.planners)[2]
    parts = settled, ordered, begun, dealt
    assert terms.solves == sum(part.solves for part in parts)
    assert terms.exchanges == sum(part.exchanges for part in parts) + 2  # floods of what all pay


def test_both_hands_are_tried_near_and_far(monkeypatch):
    tried = []

    def nowhere(planners, network, bend):
        tried.append(bend)
        return Settled({}, 0, 0)

    monkeypatch.setattr("sato.scp.roundabout.round_about", nowhere)
    planners = circle(5, 1.5)
    come_to_terms(planners, everybody(planners), 1, 1)
    assert sorted(tried) == [-2.0, -1.0, 1.0, 2.0]


def test_whoever_pays_nothing_has_no_roundabout_with_strangers_who_do(monkeypatch):
    monkeypatch.setattr("sato.scp.roundabout.BENDS", BENDS[:1])
    dear = circle(3, 1.5)
    transfer, horizon = problem()
    cheap = {
        3 + i: agent(3 + i, [9.0, 2.0 * i], [11.0, 2.0 * i], transfer, horizon) for i in (0, 1)
    }
    both = come_to_terms(dear | cheap, strangers(3, 2), 1, 1)
    assert both.solves == come_to_terms(dear, everybody(dear), 1, 1).solves
    assert all(both.planners[i].flight is p.flight for i, p in cheap.items())


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
    assert terms.exchanges == settled.exchanges + ordered.exchanges + sweeps  # what all pay
    for i, p in ordered.planners.items():
        np.testing.assert_array_equal(p.flight.u, terms.planners[i].flight.u)


def test_who_has_a_plan_of_before_or_cannot_arrive_lets_nobody_of_its_network_go_round():
    planners = circle(4, 1.5)
    network = everybody(planners)
    before = round_about(planners, network, 1.0).planners
    transfer, horizon = problem()
    stuck = parked(0, planners[0].flight.x[0, :2], transfer, horizon)
    kept, lost = as_before(planners, before)[0], stuck._replace(goal=stuck.goal + 1e-5)
    assert all(map(can_go_round, planners.values())) and can_go_round(stuck)
    for one in (kept, lost):
        assert not can_go_round(one)
        some = planners | {0: one}
        settled = settle_orders(some, network, 1)
        ordered = bargain(settled.planners, network, 1)
        assert come_to_terms(some, network, 1, 1).solves == settled.solves + ordered.solves


def test_networks_that_do_not_hear_each_other_go_round_for_themselves():
    left, right = circle(4, 1.5), circle(3, 1.5)
    both = left | {4 + i: p._replace(rank=(*p.rank[:2], 4 + i)) for i, p in right.items()}
    together = round_about(both, strangers(4, 3), 1.0).planners
    for some, first in ((left, 0), (right, 4)):
        for i, p in round_about(some, everybody(some), 1.0).planners.items():
            np.testing.assert_array_equal(p.flight.u, together[first + i].flight.u)


def test_one_of_every_network_has_its_turn_at_a_time_and_each_once():
    hears = np.zeros((6, 6), dtype=bool)
    hears[0, 3] = hears[3, 0] = hears[1, 4] = hears[4, 1] = hears[4, 5] = hears[5, 4] = True
    network = Network(hears, np.arange(6) != 2)
    parties = [(i,) for i in (5, 4, 3, 1, 0)]
    assert turns(network, parties) == [[(0,), (1,)], [(3,), (4,)], [(5,)]]


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


def test_in_its_turn_one_gives_up_its_arrival_and_then_distance_only_where_there_is_no_way():
    transfer, horizon = problem()
    me = bent(agent(2, [-1.0, 0.0], [1.0, 0.0], transfer, horizon), 1.0)
    places = {"on the way": [0.0, 0.0], "at the goal": [1.0, 0.2], "at the start": [-0.6, 0.1]}
    after, keeps = {}, {}
    for name, place in places.items():
        other = parked(0, np.array(place), transfer, horizon).plan
        after[name] = keep_clear(me, (other,))
        keeps[name] = bool(apart(after[name].path - other.path, RADIUS).all())
    assert [p.solves for p in after.values()] == [1, 2, 2]
    assert [p.arrives(p.flight) for p in after.values()] == [True, False, True]
    assert list(keeps.values()) == [True, True, False]
    straight = horizon.path(me.free.x, me.free.u)
    assert np.abs(after["at the start"].path - straight).max() > 0.1


def test_who_is_alone_or_finds_nothing_at_all_tells_what_it_flies(monkeypatch):
    planners = {i: bent(p, 1.0) for i, p in circle(2, 1.5).items()}
    alone = keep_clear(planners[0], ())
    monkeypatch.setattr("sato.scp.roundabout.past", lambda *_: None)
    without = keep_clear(planners[0], (planners[1].plan,))
    for p in (alone, without):
        np.testing.assert_array_equal(p.path, p.horizon.path(p.flight.x, p.flight.u))
    assert without.solves == 2
    assert round_about(circle(2, 1.5), everybody(planners), 1.0).planners == {}


def test_where_somebody_finds_no_way_nobody_of_its_network_goes_round():
    transfer, horizon = problem()
    me = agent(2, [-1.0, 0.0], [0.0, 0.0], transfer, horizon)
    walls = {i: parked(i, np.array([0.1 * i, 0.0]), transfer, horizon) for i in range(2)}
    far = {3 + i: p._replace(rank=(True, 0.0, 3 + i)) for i, p in circle(3, 1.5).items()}
    found = round_about(walls | {2: me} | far, strangers(3, 3), 1.0)
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
