"""Assignment in a reconfiguration: auction costs, claims and clocks of the agents."""

from dataclasses import replace

import numpy as np
import pytest
from graphs import complete, empty
from messages import flood
from reconfiguration_runs import at_rest, leg_to, make_mission
from scipy.sparse import csr_array
from scipy.sparse.csgraph import maximum_bipartite_matching

from dynamics import ClohessyWiltshire
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
from sato.auctions import run_vsdaa
from sato.network.graph import CommunicationGraph
from sato.reconfiguration import assignment
from sato.reconfiguration.assignment import assign_targets, share_claims
from sato.reconfiguration.bidding_rules import compute_bid_costs, compute_epsilon
from sato.reconfiguration.state import AgentMemory, DecisionContext
from sato.reconfiguration.target_costs import CostTable

LIMITS = {
    "comm_radius": 100.0,
    "collision_radius": 1e-3,
    "max_control": 0.2,
    "max_speed": np.inf,
    "allow_undetectable": True,
}


def plan_from(start, targets, steps=20, **changes):
    """A mission of one leg, from rest to rest."""
    return make_mission(at_rest(start), leg_to(at_rest(targets), steps), **(LIMITS | changes))


def cloud(rng, count, d=2):
    return rng.uniform(-5, 5, (count, d))


def context_of(mission, step=0, alive=None, memory=None):
    alive = mission.alive if alive is None else alive
    x = mission.initial_states
    graph = CommunicationGraph.from_positions(x[:, : mission.axes], mission.comm_radius, alive)
    return DecisionContext(mission, mission.legs[0], graph, x, memory, step, step * mission.step)


def first_decision(mission, target_count=None):
    N = len(mission.initial_states)
    memory = AgentMemory.initial(np.full(N, target_count or N))
    return assign_targets(context_of(mission, memory=memory), np.full(N, np.inf))


def exact_costs(mission):
    """Costs of all pairs at the start, and which are within reach, with the speed limit."""
    leg, model = mission.legs[0], context_of(mission).remaining_model(0)
    transfer = TransferProblem(model, mission.max_control, mission.max_speed)
    fuel, reachable, exact = compute_transfer_costs(transfer, mission.initial_states, leg.targets)
    for i, j in np.argwhere(~exact):
        found = solve_transfer(transfer, mission.initial_states[i], leg.targets[j])
        reachable[i, j] = found is not None
        fuel[i, j] = found.fuel if found else unreachable_cost(model, mission.max_control)
    distance = compute_distances(model, mission.initial_states, leg.targets)
    return 10.0 * fuel + 0.2 * distance**2, reachable


@pytest.mark.parametrize("speed", [np.inf, 0.32])
def test_assignment_is_within_n_epsilon_of_the_optimum(rng, speed):
    # Also where the speed limit makes some costs lower bounds at first.
    mission = plan_from(cloud(rng, 12), cloud(rng, 15), max_speed=speed)
    decision = first_decision(mission)
    leg, targets = mission.legs[0], decision.memory.target_index
    cost, reachable = exact_costs(mission)
    cost = cost[:, :12]
    epsilon = 0.1 * min_distance(leg.targets[:, :2]) ** 2
    best = cost[np.arange(12), solve_assignment(cost)].sum()
    assert reachable[np.arange(12), targets].all()
    assert len(set(targets)) == 12
    assert cost[np.arange(12), targets].sum() <= best + 12 * epsilon + 1e-9
    assert (decision.solve_count > 0) == np.isfinite(speed)


@pytest.mark.parametrize(("speed", "away"), [(0.2, 3.0), (0.25, 4.0)])
def test_wrong_forecast_with_targets_left_over_does_not_loosen_the_bound(speed, away, monkeypatch):
    # Some costs are lower bounds, so that an agent leaves the target that it had in the forecast.
    rng, has_prices = np.random.default_rng(3), []

    def note_prices(auction):
        has_prices.append(bool(auction.opening.price.any()))
        return run_vsdaa(auction)

    monkeypatch.setitem(assignment.METHODS, "auction", note_prices)
    start, targets = cloud(rng, 8) / 2, cloud(rng, 12) / 2 + np.array([away, 0.0])
    mission = plan_from(start, targets, max_speed=speed)
    decision = first_decision(mission, target_count=12)
    assert has_prices[0] and not has_prices[-1]
    cost, reachable = exact_costs(mission)
    held = decision.memory.target_index
    best = cost[np.arange(8), solve_assignment(cost)].sum()
    epsilon = 0.1 * min_distance(targets) ** 2
    assert reachable[np.arange(8), held].all()
    assert cost[np.arange(8), held].sum() <= best + 8 * epsilon + 1e-9


def test_distance_cost_minimizes_distance(rng):
    start, targets = cloud(rng, 10), cloud(rng, 10)
    mission = plan_from(start, targets, cost="distance", tie_break=0.0, epsilon=1e-4)
    decision = first_decision(mission)
    d = np.linalg.norm(start[:, None] - targets[None], axis=2)
    total = d[np.arange(10), decision.memory.target_index].sum()
    assert total <= d[np.arange(10), solve_assignment(d)].sum() + 10 * 1e-4


def test_tie_break_in_orbit_is_the_control_energy(rng):
    model = ClohessyWiltshire(1.1e-3)
    start, targets = cloud(rng, 6, 3) * 100, cloud(rng, 6, 3) * 100
    mission = plan_from(
        start, targets, model=model, step=60.0, max_control=0.05,
        tie_break=1e3, epsilon=1e-2, comm_radius=1e5, collision_radius=1.0,
    )  # fmt: skip
    decision = first_decision(mission)
    model = context_of(mission).remaining_model(0)
    cost = compute_energies(model, at_rest(start), at_rest(targets))
    assert decision.memory.target_index.tolist() == solve_assignment(cost).tolist()


def test_claims_and_clocks_are_shared_as_by_flooding(rng):
    N = 9
    alive = np.arange(N) != 4
    graph = CommunicationGraph.from_positions(cloud(rng, N), 3.5, alive)
    # One claim of an agent at a time: the target is a function of the step.
    step = rng.integers(-1, 4, (N, N))
    memory = replace(
        AgentMemory.initial(np.full(N, N)),
        claim_step=step,
        claimed_target=np.where(step < 0, -1, (step * 7 + np.arange(N)) % N),
        clock=rng.integers(0, 20, N),
    )
    shared = share_claims(memory, graph)

    def newest(a, b):
        return tuple(max(x, y) for x, y in zip(a, b, strict=True))

    def claims(memory, i):
        each = zip(memory.claim_step[i].tolist(), memory.claimed_target[i].tolist(), strict=True)
        return tuple(each)

    live = np.flatnonzero(alive).tolist()
    flooded = flood(graph, {i: claims(memory, i) for i in live}, newest)
    for i in live:
        assert claims(shared, i) == flooded[i]
    clocks = flood(graph, {i: int(memory.clock[i]) for i in live}, min)
    assert shared.clock[alive].tolist() == [clocks[i] for i in live]


def bid_of_the_first(cost, graph, **known):
    """Costs by which the first of two agents bids, by what it knows of both."""
    memory = AgentMemory.initial(np.full(2, len(cost)))
    rows = {name: np.array([values, [-1, -1]]) for name, values in known.items()}
    table = CostTable(*(np.tile(part, (2, 1)) for part in (cost, np.isfinite(cost), True)))
    return compute_bid_costs(table, replace(memory, **rows), graph)[0]


def test_claim_of_an_absent_agent_makes_its_target_dearer():
    claims = {"claimed_target": [-1, 1], "claim_step": [-1, 5]}
    cost = np.array([3.0, 1.0, 2.0])
    np.testing.assert_allclose(bid_of_the_first(cost, empty(2), **claims), [3.0, 3.0, 2.0])
    np.testing.assert_array_equal(bid_of_the_first(cost, complete(2), **claims), cost)


@pytest.mark.parametrize(("step", "extra"), [(4, 0.0), (12, 2.0)])
def test_newer_claim_counts_and_an_older_one_does_not(step, extra):
    bid = bid_of_the_first(
        np.array([1.0, 3.0]), empty(2), claimed_target=[0, 0], claim_step=[8, step]
    )
    np.testing.assert_allclose(bid, [1.0 + extra, 3.0])


def test_held_target_is_cheaper_by_a_part_of_the_range():
    memory = replace(AgentMemory.initial(np.full(1, 3)), target_index=np.array([0]))
    every = np.ones((1, 3), dtype=bool)
    table = CostTable(np.array([[3.0, 1.0, 2.0]]), every, every)
    np.testing.assert_allclose(compute_bid_costs(table, memory, empty(1)), [[2.96, 1.0, 2.0]])


def test_unreachable_target_costs_more_than_all_reachable_ones():
    cost = np.array([[3.0, 0.5, 0.2], [0.0, 0.0, 0.0]])
    reachable = np.array([[True, True, False], [True, False, False]])
    table = CostTable(cost, reachable, np.ones_like(reachable))
    bid = compute_bid_costs(table, AgentMemory.initial(np.full(2, 3)), empty(2))
    np.testing.assert_allclose(bid, [[3.0, 0.5, 0.2 + 3.0 + 2.5], [0.0, 1.0, 1.0]])


def decide_again(mission, clock, step, alive=None, planned_fuel=np.inf):
    """A first decision, and a later one."""
    N, first = len(mission.initial_states), first_decision(mission)
    memory = replace(first.memory, clock=np.broadcast_to(clock, N))
    context = context_of(mission, step, alive, memory)
    return first, assign_targets(context, np.full(N, planned_fuel))


def test_change_of_bidders_resets_the_clocks_of_its_component(rng):
    mission = plan_from(cloud(rng, 6), cloud(rng, 6), reset="change")
    first, again = decide_again(mission, 5, 5)
    assert not first.was_reset.any()
    assert not again.was_reset.any() and (again.memory.clock == 5).all()
    assert again.memory.target_index.tolist() == first.memory.target_index.tolist()
    fewer = np.arange(6) != 2
    _, after = decide_again(mission, 5, 5, fewer)
    assert after.was_reset.tolist() == fewer.tolist()
    assert (after.memory.clock[fewer] == 0).all()
    assert after.memory.bidder_count[0] == 5


def test_reset_stays_in_its_component(rng):
    far = np.concatenate([cloud(rng, 4), cloud(rng, 4) + 500.0])
    goals = np.concatenate([cloud(rng, 4), cloud(rng, 4) + 500.0])
    mission = plan_from(far, goals, reset="change")
    _, after = decide_again(mission, 5, 5, np.arange(8) != 1)
    assert np.flatnonzero(after.was_reset).tolist() == [0, 2, 3]
    assert after.memory.clock[4:].tolist() == [5] * 4


def test_component_takes_over_the_clock_with_most_time_left(rng):
    _, after = decide_again(plan_from(cloud(rng, 4), cloud(rng, 4)), [5, 5, 5, 2], 5)
    assert np.flatnonzero(after.was_reset).tolist() == [0, 1, 2]
    assert (after.memory.clock == 2).all()


def test_target_unreachable_in_the_time_left_resets_the_clock():
    mission = plan_from(np.array([[0.0, 0.0]]), np.array([[4.0, 0.0]]))
    _, decision = decide_again(mission, 17, 17)
    assert decision.was_reset.tolist() == [True] and decision.memory.clock.tolist() == [0]
    # A plan that leads there is proof that it is in reach.
    assert not decide_again(mission, 17, 17, planned_fuel=0.3)[1].was_reset.any()


def test_no_agent_gets_an_unreachable_target_if_it_can_be_avoided(rng):
    hard = 0
    for _ in range(150):
        mission = plan_from(cloud(rng, 4), cloud(rng, 4))
        mission = replace(mission, legs=replace(mission.legs[0], steps=11))
        transfer = TransferProblem(context_of(mission).remaining_model(0), 0.2)
        reachable = compute_transfer_costs(
            transfer, mission.initial_states, mission.legs[0].targets
        ).is_reachable
        if reachable.all() or (maximum_bipartite_matching(csr_array(reachable)) < 0).any():
            continue
        hard += 1
        assert reachable[np.arange(4), first_decision(mission).memory.target_index].all()
    assert hard > 10


def test_bid_increment_follows_from_the_mission(rng):
    mission = plan_from(cloud(rng, 3), np.array([[0.0, 0.0], [3.0, 4.0], [9.0, 0.0]]))
    leg = mission.legs[0]
    assert compute_epsilon(mission, leg) == pytest.approx(0.5 * 0.2 * 25)
    assert compute_epsilon(replace(mission, tie_break=0.0), leg) == pytest.approx(
        0.01 * np.hypot(9, 4)
    )
    assert compute_epsilon(replace(mission, epsilon=0.3), leg) == 0.3


def test_fuel_in_other_norms_is_that_of_the_transfer_problem(rng):
    mission = plan_from(cloud(rng, 3), cloud(rng, 3), fuel_norm=2, control_norm=2, tie_break=0.0)
    targets = first_decision(replace(mission, epsilon=1e-6)).memory.target_index
    transfer = TransferProblem(context_of(mission).remaining_model(0), 0.2, np.inf, 2, 2)
    goals = mission.legs[0].targets
    cost = np.array([[transfer.solve(x, y).fuel for y in goals] for x in mission.initial_states])
    assert targets.tolist() == solve_assignment(cost).tolist()


def test_target_count_grows_to_the_number_of_bidders(rng):
    mission = plan_from(cloud(rng, 8), cloud(rng, 12))
    few = first_decision(mission, target_count=3)
    many = first_decision(mission, target_count=11)
    assert few.memory.target_count.tolist() == [8] * 8 and few.memory.target_index.max() < 8
    assert many.memory.target_count.tolist() == [11] * 8
    assert few.memory.bidder_count.tolist() == many.memory.bidder_count.tolist() == [8] * 8
