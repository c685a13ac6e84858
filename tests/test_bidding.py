"""Who goes where: prices, claims and clocks, as each agent knows them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from dynamics import ClohessyWiltshire, DoubleIntegrator
from dynamics.path import least_distance
from problems.assignment import assign
from problems.auction_cost import distance, energy, exact
from problems.transfer import Transfer
from sato.network import Network, flood
from sato.reconfiguration import Leg, Reconfiguration
from sato.reconfiguration.bidding import decide, increment, share
from sato.reconfiguration.moment import Moment
from sato.reconfiguration.pricing import Minds, Offers, bid_costs


def at_rest(points):
    return np.concatenate([points, np.zeros_like(points)], axis=1)


def mission_of(start, targets, **changes):
    d = start.shape[1]
    given = {
        "model": DoubleIntegrator(d),
        "start": at_rest(start),
        "alive": np.ones(len(start), dtype=bool),
        "legs": (Leg(at_rest(targets), steps=20),),
        "step": 1.0,
        "comm_radius": 100.0,
        "collision_radius": 0.1,
        "max_control": 0.2,
    }
    return Reconfiguration(**{**given, **changes})


def cloud(rng, count, d=2):
    return rng.uniform(-5, 5, (count, d))


def moment_of(mission, step=0, alive=None):
    alive = mission.alive if alive is None else alive
    network = Network.within(mission.start[:, : mission.model.axes], mission.comm_radius, alive)
    return Moment(mission, mission.legs[0], network, mission.start, step, step * mission.step)


def no_plans(mission):
    return np.full(len(mission.start), np.inf)


def first_decision(mission, believed=None):
    N = len(mission.start)
    minds = Minds.fresh(np.full(N, believed or N))
    return decide(moment_of(mission), minds, no_plans(mission))


def offer(cost, reachable=None):
    reachable = np.ones(cost.shape, dtype=bool) if reachable is None else reachable
    return Offers(cost, reachable, np.ones(cost.shape, dtype=bool))


@pytest.mark.parametrize("speed", [np.inf, 0.32])
def test_the_assignment_is_within_n_epsilon_of_the_optimum_of_the_exact_cost(rng, speed):
    # Also where the speed limit makes some prices lower bounds at first.
    mission = mission_of(cloud(rng, 12), cloud(rng, 15), max_speed=speed)
    decision = first_decision(mission)
    leg, targets = mission.legs[0], decision.minds.target
    steps = moment_of(mission).steps_left(0)
    prices = exact(steps, mission.start, leg.targets, mission.max_control, speed)
    cost = 10.0 * prices.fuel + 0.2 * distance(steps, mission.start, leg.targets) ** 2
    cost = cost[:, :12]
    epsilon = 0.1 * least_distance(leg.targets[:, :2]) ** 2
    best = cost[np.arange(12), assign(cost)].sum()
    assert prices.reachable[np.arange(12), targets].all()
    assert len(set(targets)) == 12
    assert cost[np.arange(12), targets].sum() <= best + 12 * epsilon + 1e-9
    assert (decision.solves > 0) == np.isfinite(speed)


def test_the_distance_cost_minimises_distance(rng):
    start, targets = cloud(rng, 10), cloud(rng, 10)
    mission = mission_of(start, targets, cost="distance", tie_break=0.0, epsilon=1e-4)
    decision = first_decision(mission)
    d = np.linalg.norm(start[:, None] - targets[None], axis=2)
    total = d[np.arange(10), decision.minds.target].sum()
    assert total <= d[np.arange(10), assign(d)].sum() + 10 * 1e-4


def test_in_orbit_the_tie_break_is_the_control_energy(rng):
    model = ClohessyWiltshire(1.1e-3)
    start = at_rest(cloud(rng, 6, 3) * 100)
    targets = at_rest(cloud(rng, 6, 3) * 100)
    mission = mission_of(
        start[:, :3], targets[:, :3], model=model, step=60.0, max_control=0.05,
        tie_break=1e3, epsilon=1e-2, comm_radius=1e5, collision_radius=1.0,
    )  # fmt: skip
    decision = first_decision(mission)
    cost = energy(moment_of(mission).steps_left(0), start, targets)
    assert decision.minds.target.tolist() == assign(cost).tolist()


def test_claims_and_clocks_are_shared_as_by_flooding(rng):
    N = 9
    alive = np.ones(N, dtype=bool)
    alive[4] = False
    network = Network.within(cloud(rng, N), 3.5, alive)
    minds = replace(
        Minds.fresh(np.full(N, N)),
        claimed=rng.integers(-1, N, (N, N)),
        clock=rng.integers(0, 20, N),
    )
    # What is known of an agent at a moment is one thing: the claim is a function of its time.
    heard = rng.integers(-1, 4, (N, N))
    minds = replace(
        minds, heard=heard, claimed=np.where(heard < 0, -1, (heard * 7 + np.arange(N)) % N)
    )
    shared = share(minds, network)

    def newest(a, b):
        return tuple(max(x, y) for x, y in zip(a, b, strict=True))

    books = [
        tuple(zip(h.tolist(), c.tolist(), strict=True))
        for h, c in zip(minds.heard, minds.claimed, strict=True)
    ]
    flooded = flood(network, books, newest)
    for i in np.flatnonzero(alive):
        assert tuple(zip(shared.heard[i], shared.claimed[i], strict=True)) == flooded[i]
    clocks = flood(network, minds.clock.tolist(), min)
    assert shared.clock[alive].tolist() == [clocks[i] for i in np.flatnonzero(alive)]


def test_what_an_absent_agent_claims_is_left_while_others_are_free():
    network = Network(np.zeros((2, 2), dtype=bool), np.ones(2, dtype=bool))
    minds = Minds.fresh(np.full(2, 3))
    minds = replace(
        minds,
        claimed=np.array([[-1, 1], [-1, -1]]),
        heard=np.array([[-1, 5], [-1, -1]]),
        target=np.array([0, -1]),
    )
    cost = np.array([[3.0, 1.0, 2.0], [3.0, 1.0, 2.0]])
    bid = bid_costs(offer(cost), minds, network)
    np.testing.assert_allclose(bid[0], [3.0 - 0.02 * 2, 1.0 + 2.0, 2.0])
    np.testing.assert_allclose(bid[1], cost[1])


def test_what_is_out_of_reach_costs_more_than_all_that_is_not():
    network = Network(np.zeros((2, 2), dtype=bool), np.ones(2, dtype=bool))
    minds = Minds.fresh(np.full(2, 3))
    cost = np.array([[3.0, 0.5, 0.2], [0.0, 0.0, 0.0]])
    reachable = np.array([[True, True, False], [True, False, False]])
    bid = bid_costs(offer(cost, reachable), minds, network)
    np.testing.assert_allclose(bid, [[3.0, 0.5, 0.2 + 3.0 + 2.5], [0.0, 1.0, 1.0]])


def test_a_claim_of_somebody_present_does_not_count():
    network = Network(~np.eye(2, dtype=bool), np.ones(2, dtype=bool))
    minds = replace(
        Minds.fresh(np.full(2, 2)),
        claimed=np.array([[-1, 1], [0, -1]]),
        heard=np.array([[-1, 5], [5, -1]]),
    )
    cost = np.array([[3.0, 1.0], [3.0, 1.0]])
    np.testing.assert_array_equal(bid_costs(offer(cost), minds, network), cost)


def test_the_first_auction_resets_nothing_and_a_change_of_bidders_resets_all_who_hear(rng):
    mission = mission_of(cloud(rng, 6), cloud(rng, 6))
    first = first_decision(mission)
    assert not first.reset.any()
    later = replace(first.minds, clock=np.full(6, 5))
    again = decide(moment_of(mission, 5), later, no_plans(mission))
    assert not again.reset.any() and (again.minds.clock == 5).all()
    assert again.minds.target.tolist() == first.minds.target.tolist()
    fewer = np.arange(6) != 2
    after = decide(moment_of(mission, 5, fewer), later, no_plans(mission))
    assert after.reset.tolist() == fewer.tolist()
    assert (after.minds.clock[fewer] == 0).all()
    assert after.minds.bidders[0] == 5


def test_a_reset_stays_in_the_network_that_it_concerns(rng):
    far = np.concatenate([cloud(rng, 4), cloud(rng, 4) + 500.0])
    mission = mission_of(far, np.concatenate([cloud(rng, 4), cloud(rng, 4) + 500.0]))
    first = first_decision(mission)
    later = replace(first.minds, clock=np.full(8, 5))
    after = decide(moment_of(mission, 5, np.arange(8) != 1), later, no_plans(mission))
    assert np.flatnonzero(after.reset).tolist() == [0, 2, 3]
    assert after.minds.clock[4:].tolist() == [5] * 4


def test_meeting_somebody_with_longer_to_go_is_a_reset(rng):
    mission = mission_of(cloud(rng, 4), cloud(rng, 4))
    first = first_decision(mission)
    later = replace(first.minds, clock=np.array([5, 5, 5, 2]))
    after = decide(moment_of(mission, 5), later, no_plans(mission))
    assert np.flatnonzero(after.reset).tolist() == [0, 1, 2]
    assert (after.minds.clock == 2).all()


def test_a_target_out_of_reach_in_the_time_left_puts_the_clock_back():
    mission = mission_of(np.array([[0.0, 0.0]]), np.array([[4.0, 0.0]]))
    first = first_decision(mission)
    late = replace(first.minds, clock=np.array([17]))
    decision = decide(moment_of(mission, 17), late, no_plans(mission))
    assert decision.reset.tolist() == [True] and decision.minds.clock.tolist() == [0]
    # A plan that leads there is proof that it is in reach.
    assert not decide(moment_of(mission, 17), late, np.array([0.3])).reset.any()


def test_nobody_is_given_a_target_out_of_reach_while_all_could_have_one_within(rng):
    hard = 0
    for _ in range(150):
        mission = mission_of(cloud(rng, 4), cloud(rng, 4))
        mission = replace(mission, legs=(replace(mission.legs[0], steps=11),))
        steps = moment_of(mission).steps_left(0)
        reachable = exact(steps, mission.start, mission.legs[0].targets, 0.2).reachable
        if reachable.all() or (maximum_bipartite_matching(csr_array(reachable)) < 0).any():
            continue
        hard += 1
        assert reachable[np.arange(4), first_decision(mission).minds.target].all()
    assert hard > 10


def test_a_holder_keeps_its_target_from_an_older_claim_and_yields_to_a_newer_one():
    network = Network(np.zeros((2, 2), dtype=bool), np.ones(2, dtype=bool))
    minds = Minds.fresh(np.full(2, 2))
    cost = np.array([[1.0, 3.0], [1.0, 3.0]])
    for said, dearer in ((4, 0.0), (12, 2.0)):
        known = replace(
            minds, claimed=np.array([[0, 0], [-1, -1]]), heard=np.array([[8, said], [-1, -1]])
        )
        bid = bid_costs(offer(cost), known, network)
        np.testing.assert_allclose(bid[0], [1.0 + dearer, 3.0])


def test_the_increment_is_known_from_the_mission_alone(rng):
    mission = mission_of(cloud(rng, 3), np.array([[0.0, 0.0], [3.0, 4.0], [9.0, 0.0]]))
    leg = mission.legs[0]
    assert increment(mission, leg) == pytest.approx(0.5 * 0.2 * 25)
    assert increment(replace(mission, tie_break=0.0), leg) == pytest.approx(0.01 * np.hypot(9, 4))
    assert increment(replace(mission, epsilon=0.3), leg) == 0.3


def test_other_norms_are_priced_by_their_own_statement(rng):
    mission = mission_of(cloud(rng, 3), cloud(rng, 3), fuel_norm=2, control_norm=2, tie_break=0.0)
    targets = first_decision(replace(mission, epsilon=1e-6)).minds.target
    transfer = Transfer(moment_of(mission).steps_left(0), 0.2, np.inf, 2, 2)
    goals = mission.legs[0].targets
    cost = np.array([[transfer.solve(x, goal).fuel for goal in goals] for x in mission.start])
    assert targets.tolist() == assign(cost).tolist()


def test_m_grows_to_the_number_of_bidders_and_all_agree(rng):
    mission = mission_of(cloud(rng, 8), cloud(rng, 12))
    few = first_decision(mission, believed=3)
    many = first_decision(mission, believed=11)
    assert few.minds.believed.tolist() == [8] * 8 and few.minds.target.max() < 8
    assert many.minds.believed.tolist() == [11] * 8
    assert few.minds.bidders.tolist() == many.minds.bidders.tolist() == [8] * 8
