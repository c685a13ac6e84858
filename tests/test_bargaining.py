"""Bargains in pairs: who has a turn, what it never costs, and what it saves."""

import numpy as np
import pytest
from swarm_cast import (
    RADIUS,
    agent,
    circle,
    continuous_separation,
    crowd,
    everybody,
    heard,
    parked,
    problem,
)

from problems.central import Central
from sato.network import flood
from sato.scp import bargain, settle_orders
from sato.scp.bargaining import calendar, meet, partners
from sato.scp.orders import toll


def paid(planners):
    return tuple(np.sum([toll(agent) for agent in planners.values()], axis=0))


def settled(planners, orders=1):
    return settle_orders(planners, everybody(planners), orders).planners


@pytest.mark.parametrize("axes", [2, 3])
def test_no_sweep_makes_it_dearer_and_all_stay_apart_and_arrive(rng, axes):
    saved = 0.0
    for _ in range(3):
        now = settled(crowd(rng, 5, axes, box=3.5))
        for _ in range(3):
            after = bargain(now, everybody(now), 1).planners
            assert paid(after)[:2] <= paid(now)[:2]
            assert paid(after)[2] <= paid(now)[2] + 1e-8
            assert continuous_separation(after) >= RADIUS
            saved += paid(now)[2] - paid(after)[2]
            now = after
        for p in now.values():
            np.testing.assert_allclose(p.flight.x[-1], p.goal, atol=1e-6)
            np.testing.assert_array_equal(p.path, p.horizon.path(p.flight.x, p.flight.u))
            assert np.abs(p.flight.u).max() <= p.transfer.max_control * (1 + 1e-9)
            speed = np.linalg.norm(p.flight.x[:, axes:], axis=1).max()
            assert speed <= p.transfer.max_speed * (1 + 1e-8)
    assert saved > 0.01


def test_two_that_bargain_come_to_the_optimum_of_both_as_one_programme():
    planners = circle(2, 1.5)
    now = settled(planners)
    start, goal = (
        np.stack([side(p) for p in planners.values()])
        for side in (lambda p: p.flight.x[0], lambda p: p.goal)
    )
    central = Central(planners[0].transfer, planners[0].horizon)
    guess = tuple(np.stack([getattr(p.flight, part) for p in now.values()]) for part in "xu")
    best = central.solve(start, goal, [guess]).best.fuel
    before = sum(p.flight.fuel for p in now.values())
    after = sum(p.flight.fuel for p in bargain(now, everybody(now), 20).planners.values())
    assert before > 1.005 * best
    assert best * (1 - 1e-6) <= after <= 1.001 * best


def test_bargains_bring_those_who_meet_in_one_point_nearer_to_their_optimum():
    now = settled(circle(5, 1.5), orders=4)
    dealt = bargain(now, everybody(now), 6)
    assert paid(now)[:2] == paid(dealt.planners)[:2] == (0, 0)
    assert paid(dealt.planners)[2] < 0.9 * paid(now)[2]
    assert continuous_separation(dealt.planners) >= RADIUS


def test_whoever_pays_nothing_has_no_turn():
    transfer, horizon = problem()
    planners = {i: agent(i, [0.0, 0.7 * i], [2.0, 0.7 * i], transfer, horizon) for i in range(3)}
    now = settled(planners)
    dealt = bargain(now, everybody(now), 5)
    assert (dealt.exchanges, dealt.solves) == (2, 0)  # to hear who is near, and that nobody pays
    assert all(dealt.planners[i] is now[i] for i in now)


def test_no_sweeps_are_no_bargains(rng):
    now = settled(crowd(rng, 4))
    assert bargain(now, everybody(now), 0) == (now, 0, 0)


def test_networks_that_do_not_hear_each_other_bargain_for_themselves(rng):
    left, right = settled(crowd(rng, 4)), settled(crowd(rng, 3))
    moved = {4 + i: p._replace(rank=(*p.rank[:2], 4 + i)) for i, p in right.items()}
    hears = np.zeros((7, 7), dtype=bool)
    hears[:4, :4] = hears[4:, 4:] = True
    np.fill_diagonal(hears, False)
    together = bargain(left | moved, heard(hears), 2).planners
    for some, first in ((left, 0), (right, 4)):
        for i, p in bargain(some, everybody(some), 2).planners.items():
            np.testing.assert_array_equal(p.flight.u, together[first + i].flight.u)


def test_turns_are_what_each_makes_of_a_flood_of_who_is_near_whom(rng):
    now = settled(crowd(rng, 6, box=3.5))
    hears = rng.random((6, 6)) < 0.4
    network = heard(np.triu(hears, 1) | np.triu(hears, 1).T)
    told = [
        {i: partners(now[i], [now[int(j)].plan for j in network.neighbours[i]])} for i in range(6)
    ]
    turns = calendar(now, network, now)
    for known in flood(network, told, dict.__or__):
        pairs = [{a: b, b: a} for a in sorted(known) for b in known[a]]
        mine = {a for pair in pairs for a in pair}
        seen = [{a: b for a, b in turn.items() if a in mine} for turn in turns]
        assert [turn for turn in seen if turn] == pairs
        for pair in pairs:
            assert all(network.hears[a, b] for a, b in pair.items())


def test_only_the_two_whose_turn_it_is_act(rng):
    now = settled(crowd(rng, 5))
    parties = meet(now, everybody(now), {1: 3, 3: 1})
    assert parties.keys() == {1, 3}


def test_who_cannot_move_or_comes_too_close_has_nothing_to_offer(rng):
    now = settled(crowd(rng, 3))
    spoilt = (
        parked(0, now[0].flight.x[0, :2], now[0].transfer, now[0].horizon),
        now[0]._replace(failed=True),
        now[0]._replace(slack=0.1),
    )
    for other in spoilt:
        parties = meet(now | {0: other}, everybody(now), {0: 1, 1: 0})
        assert parties[0].offer is None
        assert parties[0].planner is other and parties[1].planner.flight is now[1].flight


def test_who_ends_elsewhere_is_taken_to_its_goal_though_it_costs_more():
    transfer, horizon = problem()
    ends = [([-1.5, 0.0], [1.5, 0.0]), ([0.1, -0.9], [0.1, 1.5])]
    now = settled({i: agent(i, *ends[i], transfer, horizon) for i in range(2)})
    still = transfer.flight(now[1].flight.x[0], np.zeros((len(transfer.steps), 2)))
    now[1] = now[1]._replace(flight=still, path=horizon.path(still.x, still.u), late=3.0)
    assert paid(now)[:2] == (0, 1)
    after = bargain(now, everybody(now), 1).planners
    assert paid(after)[:2] == (0, 0)
    assert paid(after)[2] > paid(now)[2]
    assert after[1].late == 0 and continuous_separation(after) >= RADIUS
