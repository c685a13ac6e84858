"""Several orders of priority: the choice of each component, and the fuel saved."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from graphs import complete, two_components
from hypothesis import given, settings
from hypothesis import strategies as st
from messages import flood, plan_by_messages
from planner_examples import (
    RADIUS,
    antipodal_swarm,
    continuous_separation,
    immobile,
    make_planner,
    make_problem,
    random_swarm,
    renumbered,
    total_cost,
    with_previous_plans,
)
from reconfiguration_runs import at_rest, make_mission

from dynamics.trajectory_geometry import separations
from sato.network.graph import CommunicationGraph
from sato.reconfiguration.leg import Leg
from sato.reconfiguration.planning import plan_trajectories
from sato.reconfiguration.state import AgentMemory, DecisionContext
from sato.reconfiguration.stopping import Commitment, controls_at
from sato.scp.exchange import run_batched, run_scp
from sato.scp.priority_orders import (
    component_costs,
    compute_priority_cost,
    keep_cheaper,
    offset_right,
    select_clear_components,
    select_components,
    try_priority_orders,
)


@cache
def any_planner():
    return make_planner(0, np.zeros(2), np.ones(2))


def random_outcome(rng):
    """Planner of an agent that may have failed or missed its target, at some cost."""
    p = any_planner()
    return p._replace(
        nominal=p.nominal._replace(fuel=rng.random()),
        target_state=p.target_state + rng.integers(2),
        has_failed=bool(rng.integers(2)),
    )


@given(
    links=st.lists(st.booleans(), min_size=21, max_size=21),
    dead=st.sets(st.integers(0, 6), max_size=3),
    seed=st.integers(0, 99),
)
def test_component_sums_and_choices_follow_from_a_flood(links, dead, seed):
    alive = np.array([i not in dead for i in range(7)])
    adjacency = np.zeros((7, 7), dtype=bool)
    adjacency[np.triu_indices(7, 1)] = links
    adjacency = (adjacency | adjacency.T) & alive & alive[:, None]
    graph = CommunicationGraph(adjacency, alive)
    draw = np.random.default_rng(seed)
    live = np.flatnonzero(alive).tolist()
    some, again = ({i: random_outcome(draw) for i in live} for _ in range(2))
    clear = select_components(some, graph, lambda p: not p.has_failed)
    kept, total = keep_cheaper(some, again, graph), component_costs(some, graph)
    told = {i: {i: tuple(map(compute_priority_cost, (some[i], again[i])))} for i in live}
    for i, known in flood(graph, told, dict.__or__).items():
        mine, theirs = ([known[j][k] for j in sorted(known)] for k in (0, 1))
        added = np.sum(mine, axis=0)
        np.testing.assert_allclose(total[i], added, rtol=1e-12)
        assert (i in clear) == all(not some[j].has_failed for j in known)
        better = tuple(np.sum(theirs, axis=0)) < tuple(added)
        assert kept[i] is (again[i] if better else some[i])


def test_one_order_is_method_2_itself(rng):
    planners = random_swarm(rng, 5)
    once, exchanges, *_ = run_scp(planners, complete(len(planners)))
    found = try_priority_orders(planners, complete(len(planners)), 1)
    assert found.round_count == exchanges
    assert found.solve_count == sum(p.solve_count for p in once.values())
    for i, p in once.items():
        np.testing.assert_array_equal(p.nominal.u, found.planners[i].nominal.u)


@pytest.mark.parametrize("axes", [2, 3])
def test_more_orders_never_cost_more_and_stay_separated(rng, axes):
    saved = 0.0
    for _ in range(3):
        planners = random_swarm(rng, 5, axes, box=3.5)
        once, after = (
            try_priority_orders(planners, complete(len(planners)), orders).planners
            for orders in (1, 4)
        )
        assert total_cost(after) <= total_cost(once)
        assert after.keys() == planners.keys()
        assert all(p.is_final for p in after.values())
        assert total_cost(after)[:2] == (0, 0)
        assert continuous_separation(after) >= RADIUS
        for p in after.values():
            np.testing.assert_allclose(p.nominal.x[-1], p.target_state, atol=1e-6)
        saved += total_cost(once)[2] - total_cost(after)[2]
    assert saved > 0


def test_components_choose_their_orders_independently(rng):
    left, right = random_swarm(rng, 4), random_swarm(rng, 3)
    both = left | renumbered(right, 4)
    together = try_priority_orders(both, two_components(4, 3), 4).planners
    for some, first in ((left, 0), (right, 4)):
        for i, p in try_priority_orders(some, complete(len(some)), 4).planners.items():
            np.testing.assert_array_equal(p.nominal.u, together[first + i].nominal.u)


def test_component_without_cost_tries_no_further_order(rng):
    dear = random_swarm(rng, 4)
    cheap = {4 + i: make_planner(4 + i, [0.0, 40.0 + 4 * i], [2.0, 40.0 + 4 * i]) for i in range(3)}
    both = try_priority_orders(dear | cheap, two_components(4, 3), 4)
    assert both.solve_count == try_priority_orders(dear, complete(len(dear)), 4).solve_count > 0


def test_swarm_without_conflicts_solves_nothing():
    planners = {i: make_planner(i, [0.0, 4.0 * i], [2.0, 4.0 * i]) for i in range(3)}
    once, exchanges, *_ = run_scp(planners, complete(len(planners)))
    found = try_priority_orders(planners, complete(len(planners)), 9)
    assert (found.round_count, found.solve_count) == (exchanges + 1, 0)  # one flood of the costs
    assert all(found.planners[i].nominal is once[i].nominal for i in once)


def test_clear_and_cheaper_previous_plans_are_kept(rng):
    # Begin with the result of several orders; the first order alone costs more.
    planners = random_swarm(rng, 5, box=3.5)
    found = try_priority_orders(planners, complete(len(planners)), 5).planners
    begun = with_previous_plans(planners, found)
    again = try_priority_orders(begun, complete(len(begun)), 2).planners
    assert total_cost(run_scp(planners, complete(len(planners)))[0]) > total_cost(found)
    assert total_cost(again) <= total_cost(found)
    assert continuous_separation(again) >= RADIUS


def test_component_in_conflict_is_not_clear(rng):
    planners = random_swarm(rng, 4)
    meeting = antipodal_swarm(2, 1.5)
    assert not select_clear_components(meeting, complete(len(meeting)))
    far = {0: meeting[0]}
    assert select_clear_components(far, complete(len(far))).keys() == {0}
    settled = with_previous_plans(planners, run_scp(planners, complete(len(planners)))[0])
    assert select_clear_components(settled, complete(len(settled))).keys() == settled.keys()


def test_infeasible_agent_sends_the_path_that_it_flies():
    # Two immobile agents overlap it, and its nominal is offset: no program is feasible.
    me = make_planner(2, [0.0, 0.0], [0.0, 0.0])
    walls = {i: immobile(i, [0.1 * i, 0.0]) for i in range(2)}
    swarm = walls | {2: me._replace(control_points=me.control_points + 0.3, has_converged=False)}
    after, *_ = run_scp(swarm, complete(len(swarm)))
    assert after[2].has_failed or after[2].slack > 0
    flown = after[2].with_nominal(after[2].nominal)
    np.testing.assert_array_equal(after[2].control_points, flown.control_points)


@pytest.mark.parametrize("axes", [2, 3])
def test_batched_exchanges_of_offset_nominals_equal_the_definition(rng, axes):
    planners = {i: offset_right(p, 1.0) for i, p in random_swarm(rng, 5, axes).items()}
    graph = complete(len(planners))
    slow, fast = list(plan_by_messages(planners, graph)), list(run_batched(planners, graph))
    assert len(slow) == len(fast)
    for a, b in zip(slow, fast, strict=True):
        for i in planners:
            np.testing.assert_array_equal(a[i].control_points, b[i].control_points)
            assert (a[i].is_final, a[i].solve_count) == (b[i].is_final, b[i].solve_count)


def test_immobile_agent_stays_and_others_avoid_it(rng):
    planners = random_swarm(rng, 4)
    planners[0] = immobile(0, planners[0].nominal.x[0, :2])
    after = try_priority_orders(planners, complete(len(planners)), 4).planners
    assert after[0].nominal is planners[0].nominal
    assert all(p.is_final for p in after.values())


def test_several_orders_solve_a_crossing_that_one_cannot():
    planners = antipodal_swarm(6, 1.5)
    once = try_priority_orders(planners, complete(len(planners)), 1).planners
    after = try_priority_orders(planners, complete(len(planners)), 6).planners
    assert total_cost(once)[1] > 0
    assert total_cost(after)[:2] == (0, 0)
    assert continuous_separation(after) >= RADIUS


@settings(max_examples=20, deadline=None)
@given(angle=st.floats(0, 2 * np.pi), length=st.floats(1.0, 3.0), hand=st.sampled_from([1.0, -2.0]))
def test_offset_is_zero_at_the_ends_and_as_asked_halfway(angle, length, hand):
    way = length * np.array([np.cos(angle), np.sin(angle)])
    straight = make_planner(0, np.zeros(2), way)
    curved = offset_right(straight, hand)
    right = np.array([way[1], -way[0]]) / length
    aside = (curved.control_points - straight.control_points) @ right / (hand * RADIUS)
    assert abs(aside[0, 0]) < 1e-12 > abs(aside[-1, -1])
    assert np.all(aside > -1e-12)
    np.testing.assert_allclose(aside.max(), 1.0, rtol=0.01)
    np.testing.assert_allclose(
        curved.control_points[1:, 0], curved.control_points[:-1, -1], atol=1e-12
    )


def test_nominals_in_space_are_not_offset(rng):
    planners = random_swarm(rng, 2, axes=3)
    assert offset_right(planners[0], 1.0) is planners[0]


def test_separation_is_kept_within_a_short_horizon():
    planners = antipodal_swarm(5, 1.5)
    short = make_problem(horizon_steps=8)[1]
    seen = {
        i: p._replace(horizon=short, control_points=short.control_points(p.nominal.x, p.nominal.u))
        for i, p in planners.items()
    }
    after = try_priority_orders(seen, complete(len(seen)), 3).planners
    assert all(p.is_final for p in after.values())
    assert continuous_separation(seen, states=9) < RADIUS
    assert continuous_separation(after, states=9) >= RADIUS


@pytest.mark.parametrize("bargains", [0, 2])
def test_replanning_never_raises_the_fuel_of_the_first_plan(bargains):
    # All trajectories cross in one point.
    angle = 2 * np.pi * np.arange(4) / 4
    start = 2.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    goal = -start @ np.array([[1.0, 0.03], [-0.03, 1.0]])
    limits = {"comm_radius": 100.0, "collision_radius": 1.0, "max_speed": 0.5}
    tries = {"foresight_steps": 24, "orders": 4, "bargains": bargains}
    mission = make_mission(at_rest(start), Leg(at_rest(goal), 24), **limits, **tries)
    leg, x, everyone = mission.legs[0], mission.initial_states, np.ones(4, dtype=bool)
    plans, spent, planned, path = {}, np.zeros(4), [], [x]
    for k in range(24):
        if k % 4 == 0:
            memory = AgentMemory.initial(np.full(4, 4))
            memory = replace(memory, target_index=np.arange(4), clock=np.full(4, k))
            context = DecisionContext(mission, leg, complete(4), x, memory, k, float(k))
            plans, events, _ = plan_trajectories(context, spent, plans)
            assert [event["kind"] for event in events] == ["replan"]
            planned.append(spent.sum() + sum(plan.trajectory.fuel for plan in plans.values()))
        flown = {i: Commitment(p.planned_at, p.trajectory.u) for i, p in plans.items()}
        u = controls_at(flown, k, everyone, mission)
        spent = spent + np.abs(u).sum(axis=1)
        x = mission.flown_plant.propagate(x, u, float(k), 1.0)[1]
        path.append(x)
    np.testing.assert_allclose(x, leg.targets, atol=1e-6)
    assert np.diff(planned).max() < 1e-6
    path = np.array(path)
    alive = np.ones(path.shape[:2], dtype=bool)
    assert separations(path[..., :2], path[..., 2:], alive, 1.0).minimum.distance >= 1.0
