"""Who goes where: prices, claims and clocks, as each agent knows them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from dynamics import ClohessyWiltshire, DoubleIntegrator
from dynamics.trajectory_geometry import min_distance
from problems.assignment import solve_assignment
from problems.auction_cost import (
    compute_distances,
    compute_energies,
    compute_transfer_costs,
    solve_transfer,
    unreachable_cost,
)
from problems.transfer import TransferProblem
from sato.network.graph import CommunicationGraph
from sato.network.rounds import flood
from sato.reconfiguration.mission import Leg, Reconfiguration
from sato.reconfiguration.assignment import assign_targets, compute_epsilon, share_claims
from sato.reconfiguration.auction_costs import CostTable, compute_bid_costs
from sato.reconfiguration.state import AgentMemory
from sato.reconfiguration.state import DecisionContext


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
    network = CommunicationGraph.from_positions(
        mission.start[:, : mission.model.axes], mission.comm_radius, alive
    )
    return DecisionContext(
        mission, mission.legs[0], network, mission.start, step, step * mission.step
    )


def no_plans(mission):
    return np.full(len(mission.start), np.inf)


def first_decision(mission, believed=None):
    N = len(mission.start)
    minds = AgentMemory.initial(np.full(N, believed or N))
    return assign_targets(moment_of(mission), minds, no_plans(mission))


def offer(cost, reachable=None):
    reachable = np.ones(cost.shape, dtype=bool) if reachable is None else reachable
    return CostTable(cost, reachable, np.ones(cost.shape, dtype=bool))


@pytest.mark.parametrize("speed", [np.inf, 0.32])
def test_the_assignment_is_within_n_epsilon_of_the_optimum_of_the_exact_cost(rng, speed):
    # Also where the speed limit makes some prices lower bounds at first.
    mission = mission_of(cloud(rng, 12), cloud(rng, 15), max_speed=speed)
    decision = first_decision(mission)
    leg, targets = mission.legs[0], decision.memory.target_index
    steps = moment_of(mission).remaining_model(0)
    transfer = TransferProblem(steps, mission.max_control, speed)
    fuel, reachable, exact = compute_transfer_costs(transfer, mission.initial_states, leg.targets)
    for i, j in np.argwhere(~exact):
        flight = solve_transfer(transfer, mission.initial_states[i], leg.targets[j])
        reachable[i, j] = flight is not None
        fuel[i, j] = flight.fuel if flight else unreachable_cost(steps, mission.max_control)
    cost = 10.0 * fuel + 0.2 * compute_distances(steps, mission.initial_states, leg.targets) ** 2
    cost = cost[:, :12]
    epsilon = 0.1 * min_distance(leg.targets[:, :2]) ** 2
    best = cost[np.arange(12), solve_assignment(cost)].sum()
    assert reachable[np.arange(12), targets].all()
    assert len(set(targets)) == 12
    assert cost[np.arange(12), targets].sum() <= best + 12 * epsilon + 1e-9
    assert (decision.solve_count > 0) == np.isfinite(speed)


def test_the_distance_cost_minimises_distance(rng):
    start, targets = cloud(rng, 10), cloud(rng, 10)
    mission = mission_of(start, targets, cost="distance", tie_break=0.0, epsilon=1e-4)
    decision = first_decision(mission)
    d = np.linalg.norm(start[:, None] - targets[None], axis=2)
    total = d[np.arange(10), decision.memory.target_index].sum()
    assert total <= d[np.arange(10), solve_assignment(d)].sum() + 10 * 1e-4


def test_in_orbit_the_tie_break_is_the_control_energy(rng):
    model = ClohessyWiltshire(1.1e-3)
    start = at_rest(cloud(rng, 6, 3) * 100)
    targets = at_rest(cloud(rng, 6, 3) * 100)
    mission = mission_of(
        start[:, :3], targets[:, :3], model=model, step=60.0, max_control=0.05,
        tie_break=1e3, epsilon=1e-2, comm_radius=1e5, collision_radius=1.0,
    )  # fmt: skip
    decision = first_decision(mission)
    cost = compute_energies(moment_of(mission).remaining_model(0), start, targets)
    assert decision.memory.target_index.tolist() == solve_assignment(cost).tolist()


def test_claims_and_clocks_are_shared_as_by_flooding(rng):
    N = 9
    alive = np.ones(N, dtype=bool)
    alive[4] = False
    network = CommunicationGraph.from_positions(cloud(rng, N), 3.5, alive)
    minds = replace(
        AgentMemory.initial(np.full(N, N)),
        claimed_target=rng.integers(-1, N, (N, N)),
        clock=rng.integers(0, 20, N),
    )
    # What is known of an agent at a moment is one thing: the claim is a function of its time.
    heard = rng.integers(-1, 4, (N, N))
    minds = replace(
        minds,
        claim_step=heard,
        claimed_target=np.where(heard < 0, -1, (heard * 7 + np.arange(N)) % N),
    )
    shared = share_claims(minds, network)

    def newest(a, b):
        return tuple(max(x, y) for x, y in zip(a, b, strict=True))

    books = [
        tuple(zip(h.tolist(), c.tolist(), strict=True))
        for h, c in zip(minds.claim_step, minds.claimed_target, strict=True)
    ]
    live = np.flatnonzero(alive).tolist()
    flooded = flood(network, {i: books[i] for i in live}, newest)
    for i in live:
        assert tuple(zip(shared.claim_step[i], shared.claimed_target[i], strict=True)) == flooded[i]
    clocks = flood(network, {i: int(minds.clock[i]) for i in live}, min)
    assert shared.clock[alive].tolist() == [clocks[i] for i in live]


def test_what_an_absent_agent_claims_is_left_while_others_are_free():
    network = CommunicationGraph(np.zeros((2, 2), dtype=bool), np.ones(2, dtype=bool))
    minds = AgentMemory.initial(np.full(2, 3))
    minds = replace(
        minds,
        claimed_target=np.array([[-1, 1], [-1, -1]]),
        claim_step=np.array([[-1, 5], [-1, -1]]),
        target_index=np.array([0, -1]),
    )
    cost = np.array([[3.0, 1.0, 2.0], [3.0, 1.0, 2.0]])
    bid = compute_bid_costs(offer(cost), minds, network)
    np.testing.assert_allclose(bid[0], [3.0 - 0.02 * 2, 1.0 + 2.0, 2.0])
    np.testing.assert_allclose(bid[1], cost[1])


def test_what_is_out_of_reach_costs_more_than_all_that_is_not():
    network = CommunicationGraph(np.zeros((2, 2), dtype=bool), np.ones(2, dtype=bool))
    minds = AgentMemory.initial(np.full(2, 3))
    cost = np.array([[3.0, 0.5, 0.2], [0.0, 0.0, 0.0]])
    reachable = np.array([[True, True, False], [True, False, False]])
    bid = compute_bid_costs(offer(cost, reachable), minds, network)
    np.testing.assert_allclose(bid, [[3.0, 0.5, 0.2 + 3.0 + 2.5], [0.0, 1.0, 1.0]])


def test_a_claim_of_somebody_present_does_not_count():
    network = CommunicationGraph(~np.eye(2, dtype=bool), np.ones(2, dtype=bool))
    minds = replace(
        AgentMemory.initial(np.full(2, 2)),
        claimed_target=np.array([[-1, 1], [0, -1]]),
        claim_step=np.array([[-1, 5], [5, -1]]),
    )
    cost = np.array([[3.0, 1.0], [3.0, 1.0]])
    np.testing.assert_array_equal(compute_bid_costs(offer(cost), minds, network), cost)


def test_the_first_auction_resets_nothing_and_a_change_of_bidders_resets_all_who_hear(rng):
    mission = mission_of(cloud(rng, 6), cloud(rng, 6))
    first = first_decision(mission)
    assert not first.was_reset.any()
    later = replace(first.memory, clock=np.full(6, 5))
    again = assign_targets(moment_of(mission, 5), later, no_plans(mission))
    assert not again.was_reset.any() and (again.memory.clock == 5).all()
    assert again.memory.target_index.tolist() == first.memory.target_index.tolist()
    fewer = np.arange(6) != 2
    after = assign_targets(moment_of(mission, 5, fewer), later, no_plans(mission))
    assert after.was_reset.tolist() == fewer.tolist()
    assert (after.memory.clock[fewer] == 0).all()
    assert after.memory.bidder_count[0] == 5


def test_a_reset_stays_in_the_network_that_it_concerns(rng):
    far = np.concatenate([cloud(rng, 4), cloud(rng, 4) + 500.0])
    mission = mission_of(far, np.concatenate([cloud(rng, 4), cloud(rng, 4) + 500.0]))
    first = first_decision(mission)
    later = replace(first.memory, clock=np.full(8, 5))
    after = assign_targets(moment_of(mission, 5, np.arange(8) != 1), later, no_plans(mission))
    assert np.flatnonzero(after.was_reset).tolist() == [0, 2, 3]
    assert after.memory.clock[4:].tolist() == [5] * 4


def test_meeting_somebody_with_longer_to_go_is_a_reset(rng):
    mission = mission_of(cloud(rng, 4), cloud(rng, 4))
    first = first_decision(mission)
    later = replace(first.memory, clock=np.array([5, 5, 5, 2]))
    after = assign_targets(moment_of(mission, 5), later, no_plans(mission))
    assert np.flatnonzero(after.was_reset).tolist() == [0, 1, 2]
    assert (after.memory.clock == 2).all()


def test_a_target_out_of_reach_in_the_time_left_puts_the_clock_back():
    mission = mission_of(np.array([[0.0, 0.0]]), np.array([[4.0, 0.0]]))
    first = first_decision(mission)
    late = replace(first.memory, clock=np.array([17]))
    decision = assign_targets(moment_of(mission, 17), late, no_plans(mission))
    assert decision.was_reset.tolist() == [True] and decision.memory.clock.tolist() == [0]
    # A plan that leads there is proof that it is in reach.
    assert not assign_targets(moment_of(mission, 17), late, np.array([0.3])).was_reset.any()


def test_nobody_is_given_a_target_out_of_reach_while_all_could_have_one_within(rng):
    hard = 0
    for _ in range(150):
        mission = mission_of(cloud(rng, 4), cloud(rng, 4))
        mission = replace(mission, legs=(replace(mission.legs[0], steps=11),))
        transfer = TransferProblem(moment_of(mission).remaining_model(0), 0.2)
        reachable = compute_transfer_costs(
            transfer, mission.initial_states, mission.legs[0].targets
        ).is_reachable
        if reachable.all() or (maximum_bipartite_matching(csr_array(reachable)) < 0).any():
            continue
        hard += 1
        assert reachable[np.arange(4), first_decision(mission).memory.target_index].all()
    assert hard > 10


def test_a_holder_keeps_its_target_from_an_older_claim_and_yields_to_a_newer_one():
    network = CommunicationGraph(np.zeros((2, 2), dtype=bool), np.ones(2, dtype=bool))
    minds = AgentMemory.initial(np.full(2, 2))
    cost = np.array([[1.0, 3.0], [1.0, 3.0]])
    for said, dearer in ((4, 0.0), (12, 2.0)):
        known = replace(
            minds,
            claimed_target=np.array([[0, 0], [-1, -1]]),
            claim_step=np.array([[8, said], [-1, -1]]),
        )
        bid = compute_bid_costs(offer(cost), known, network)
        np.testing.assert_allclose(bid[0], [1.0 + dearer, 3.0])


def test_the_increment_is_known_from_the_mission_alone(rng):
    mission = mission_of(cloud(rng, 3), np.array([[0.0, 0.0], [3.0, 4.0], [9.0, 0.0]]))
    leg = mission.legs[0]
    assert compute_epsilon(mission, leg) == pytest.approx(0.5 * 0.2 * 25)
    assert compute_epsilon(replace(mission, tie_break=0.0), leg) == pytest.approx(
        0.01 * np.hypot(9, 4)
    )
    assert compute_epsilon(replace(mission, epsilon=0.3), leg) == 0.3


def test_other_norms_are_priced_by_their_own_statement(rng):
    mission = mission_of(cloud(rng, 3), cloud(rng, 3), fuel_norm=2, control_norm=2, tie_break=0.0)
    targets = first_decision(replace(mission, epsilon=1e-6)).memory.target_index
    transfer = TransferProblem(moment_of(mission).remaining_model(0), 0.2, np.inf, 2, 2)
    goals = mission.legs[0].targets
    cost = np.array(
        [[transfer.solve(x, goal).fuel for goal in goals] for x in mission.initial_states]
    )
    assert targets.tolist() == solve_assignment(cost).tolist()


def test_m_grows_to_the_number_of_bidders_and_all_agree(rng):
    mission = mission_of(cloud(rng, 8), cloud(rng, 12))
    few = first_decision(mission, believed=3)
    many = first_decision(mission, believed=11)
    assert few.memory.target_count.tolist() == [8] * 8 and few.memory.target_index.max() < 8
    assert many.memory.target_count.tolist() == [11] * 8
    assert few.memory.bidder_count.tolist() == many.memory.bidder_count.tolist() == [8] * 8
