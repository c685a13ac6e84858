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

from problems.convexify import are_hulls_separated
from sato.scp.negotiation import negotiate
from sato.scp.priority_orders import ConflictResolution, offset_right, try_priority_orders
from sato.scp.resolve import OFFSETS, resolve_conflicts
from sato.scp.roundabout import can_use_roundabout, solve_roundabout, update_in_turn


def spin(planners):
    """By how much each turns about the middle of the circle on its way: positive to the left."""
    found = []
    for p in planners.values():
        place, speed = p.nominal.x[:, :2], p.nominal.x[:, 2:]
        found.append(np.sum(place[:, 0] * speed[:, 1] - place[:, 1] * speed[:, 0]))
    return np.array(found)


@pytest.mark.parametrize(("bend", "hand"), [(1.0, 1), (2.0, 1), (-1.0, -1), (-2.0, -1)])
def test_at_a_roundabout_all_go_round_the_same_way_stay_apart_and_arrive(bend, hand):
    planners = circle(5, 1.5)
    found = solve_roundabout(planners, everybody(planners), bend)
    assert found.planners.keys() == planners.keys()
    assert np.all(hand * spin(found.planners) > 0)
    assert continuous_separation(found.planners) >= RADIUS
    for p in found.planners.values():
        np.testing.assert_allclose(p.nominal.x[-1], p.target_state, atol=1e-6)
        np.testing.assert_array_equal(
            p.control_points, p.horizon.control_points(p.nominal.x, p.nominal.u)
        )
        assert np.abs(p.nominal.u).max() <= p.transfer.max_control * (1 + 1e-9)
    assert found.solve_count == sum(p.solve_count for p in found.planners.values()) == 5
    assert found.round_count == 5 + 1 + 1  # a turn each, to hear who is clear, and to flood it


def test_whose_turn_comes_later_knows_what_others_have_planned_in_theirs():
    # If all answered what they had been told at first, these six would never be clear.
    planners = circle(6, 1.5)
    found = solve_roundabout(planners, everybody(planners), -1.0)
    assert (found.planners.keys(), found.solve_count) == (planners.keys(), 6)


def test_who_meets_somebody_after_a_round_has_another_turn():
    # Bent by so little, the first come too close in the first round and find a way in a later one.
    planners = circle(6, 1.5)
    found = solve_roundabout(planners, everybody(planners), 0.1)
    assert found.planners.keys() == planners.keys()
    assert found.round_count % (6 + 2) == 0 and found.round_count > 6 + 2
    assert found.solve_count == sum(p.solve_count for p in found.planners.values()) > 6
    assert continuous_separation(found.planners) >= RADIUS


def test_terms_are_orders_and_then_roundabouts_with_bargains_and_cheaper_in_one_point(monkeypatch):
    planners = circle(5, 1.5)
    network = everybody(planners)
    settled = try_priority_orders(planners, network, 2)
    ordered = negotiate(settled.planners, network, 2)
    begun = solve_roundabout(planners, network, -1.0)
    dealt = negotiate(begun.planners, network, 2)
    monkeypatch.setattr("sato.scp.resolve.OFFSETS", [-1.0])
    terms = resolve_conflicts(planners, network, 2, 2)
    assert paid(terms.planners) == paid(dealt.planners)
    assert paid(terms.planners)[:2] == (0, 0)
    assert continuous_separation(terms.planners) >= RADIUS
    assert paid(terms.planners)[2] < 0.95 * paid(ordered.planners)[2]
    parts = settled, ordered, begun, dealt
    assert terms.solve_count == sum(part.solve_count for part in parts)
    assert (
        terms.round_count == sum(part.round_count for part in parts) + 2
    )  # floods of what all pay


def test_both_hands_are_tried_near_and_far(monkeypatch):
    tried = []

    def nowhere(planners, network, bend):
        tried.append(bend)
        return ConflictResolution({}, 0, 0)

    monkeypatch.setattr("sato.scp.resolve.solve_roundabout", nowhere)
    planners = circle(5, 1.5)
    resolve_conflicts(planners, everybody(planners), 1, 1)
    assert sorted(tried) == [-2.0, -1.0, 1.0, 2.0]


def test_whoever_pays_nothing_has_no_roundabout_with_strangers_who_do(monkeypatch):
    monkeypatch.setattr("sato.scp.resolve.OFFSETS", OFFSETS[:1])
    dear = circle(3, 1.5)
    transfer, horizon = problem()
    cheap = {
        3 + i: agent(3 + i, [9.0, 2.0 * i], [11.0, 2.0 * i], transfer, horizon) for i in (0, 1)
    }
    both = resolve_conflicts(dear | cheap, strangers(3, 2), 1, 1)
    assert both.solve_count == resolve_conflicts(dear, everybody(dear), 1, 1).solve_count
    assert all(both.planners[i].nominal is p.nominal for i, p in cheap.items())


def test_terms_never_cost_more_than_orders_and_bargains(rng):
    for _ in range(2):
        planners = crowd(rng, 4, box=3.0)
        network = everybody(planners)
        ordered = negotiate(try_priority_orders(planners, network, 2).planners, network, 2)
        terms = resolve_conflicts(planners, network, 2, 2)
        assert paid(terms.planners) <= paid(ordered.planners)
        assert continuous_separation(terms.planners) >= RADIUS


@pytest.mark.parametrize("axes", [2, 3])
def test_without_sweeps_or_in_space_there_are_no_roundabouts(rng, axes):
    planners = crowd(rng, 4, axes)
    network, sweeps = everybody(planners), axes - 2
    settled = try_priority_orders(planners, network, 2)
    ordered = negotiate(settled.planners, network, sweeps)
    terms = resolve_conflicts(planners, network, 2, sweeps)
    assert terms.solve_count == settled.solve_count + ordered.solve_count
    assert terms.round_count == settled.round_count + ordered.round_count + sweeps  # what all pay
    for i, p in ordered.planners.items():
        np.testing.assert_array_equal(p.nominal.u, terms.planners[i].nominal.u)


def test_who_has_a_plan_of_before_or_cannot_arrive_lets_nobody_of_its_network_go_round():
    planners = circle(4, 1.5)
    network = everybody(planners)
    before = solve_roundabout(planners, network, 1.0).planners
    transfer, horizon = problem()
    stuck = parked(0, planners[0].nominal.x[0, :2], transfer, horizon)
    kept, lost = (
        as_before(planners, before)[0],
        stuck._replace(target_state=stuck.target_state + 1e-5),
    )
    assert all(map(can_use_roundabout, planners.values())) and can_use_roundabout(stuck)
    for one in (kept, lost):
        assert not can_use_roundabout(one)
        some = planners | {0: one}
        settled = try_priority_orders(some, network, 1)
        ordered = negotiate(settled.planners, network, 1)
        assert (
            resolve_conflicts(some, network, 1, 1).solve_count
            == settled.solve_count + ordered.solve_count
        )


def test_networks_that_do_not_hear_each_other_go_round_for_themselves():
    left, right = circle(4, 1.5), circle(3, 1.5)
    both = left | {4 + i: p._replace(priority=(*p.priority[:2], 4 + i)) for i, p in right.items()}
    together = solve_roundabout(both, strangers(4, 3), 1.0).planners
    for some, first in ((left, 0), (right, 4)):
        for i, p in solve_roundabout(some, everybody(some), 1.0).planners.items():
            np.testing.assert_array_equal(p.nominal.u, together[first + i].nominal.u)


def test_in_its_turn_one_keeps_clear_of_all_whom_it_hears_whoever_goes_first():
    planners = {i: offset_right(p, 0.3) for i, p in circle(4, 1.5).items()}
    told = tuple(planners[i].message for i in (1, 2, 3))
    first = planners[0]._replace(priority=(True, -99.0, 0))
    after, same = update_in_turn(planners[0], told), update_in_turn(first, told)
    np.testing.assert_array_equal(after.control_points, same.control_points)
    assert all(
        are_hulls_separated(after.control_points - plan.control_points, RADIUS).all()
        for plan in told
    )
    assert not all(
        are_hulls_separated(planners[0].control_points - plan.control_points, RADIUS).all()
        for plan in told
    )


def test_in_its_turn_one_linearises_about_its_own_flight_and_is_not_sloped():
    planners = circle(3, 1.5)
    asked = []

    def about(flight):
        asked.append(flight)
        return replace(planners[0].transfer, tie_break_rise=0.5)

    curved = planners[0]._replace(relinearize=about)
    told = (planners[1].message,)
    after = update_in_turn(curved, told)
    assert asked == [planners[0].nominal]
    assert after.transfer.tie_break_rise == 0.5
    np.testing.assert_array_equal(
        after.control_points, update_in_turn(planners[0], told).control_points
    )


def test_in_its_turn_one_gives_up_its_arrival_and_then_distance_only_where_there_is_no_way():
    transfer, horizon = problem()
    me = offset_right(agent(2, [-1.0, 0.0], [1.0, 0.0], transfer, horizon), 1.0)
    places = {"on the way": [0.0, 0.0], "at the goal": [1.0, 0.2], "at the start": [-0.6, 0.1]}
    after, keeps = {}, {}
    for name, place in places.items():
        other = parked(0, np.array(place), transfer, horizon).message
        after[name] = update_in_turn(me, (other,))
        keeps[name] = bool(
            are_hulls_separated(after[name].control_points - other.control_points, RADIUS).all()
        )
    assert [p.solve_count for p in after.values()] == [1, 2, 2]
    assert [p.reaches_target(p.nominal) for p in after.values()] == [True, False, True]
    assert list(keeps.values()) == [True, True, False]
    straight = horizon.control_points(me.solo.x, me.solo.u)
    assert np.abs(after["at the start"].control_points - straight).max() > 0.1


def test_who_is_alone_or_finds_nothing_at_all_tells_what_it_flies(monkeypatch):
    planners = {i: offset_right(p, 1.0) for i, p in circle(2, 1.5).items()}
    alone = update_in_turn(planners[0], ())
    monkeypatch.setattr("sato.scp.roundabout.solve_around", lambda *_: None)
    without = update_in_turn(planners[0], (planners[1].message,))
    for p in (alone, without):
        np.testing.assert_array_equal(
            p.control_points, p.horizon.control_points(p.nominal.x, p.nominal.u)
        )
    assert without.solve_count == 2
    assert solve_roundabout(circle(2, 1.5), everybody(planners), 1.0).planners == {}


def test_where_somebody_finds_no_way_nobody_of_its_network_goes_round():
    transfer, horizon = problem()
    me = agent(2, [-1.0, 0.0], [0.0, 0.0], transfer, horizon)
    walls = {i: parked(i, np.array([0.1 * i, 0.0]), transfer, horizon) for i in range(2)}
    far = {3 + i: p._replace(priority=(True, 0.0, 3 + i)) for i, p in circle(3, 1.5).items()}
    found = solve_roundabout(walls | {2: me} | far, strangers(3, 3), 1.0)
    assert found.planners.keys() == far.keys()
    assert found.solve_count > sum(p.solve_count for p in found.planners.values())


def test_who_cannot_move_stays_and_all_go_round_it():
    planners = circle(4, 1.5)
    place = np.array([0.0, 0.0])
    still = parked(4, place, planners[0].transfer, planners[0].horizon)
    found = solve_roundabout(planners | {4: still}, everybody(planners | {4: still}), 1.0).planners
    assert found.keys() == {0, 1, 2, 3, 4}
    np.testing.assert_array_equal(found[4].control_points, still.control_points)
    for i in range(4):
        assert are_hulls_separated(found[i].control_points - still.control_points, RADIUS).all()
