"""Roundabouts and conflict resolution: turns, sides, and the fuel saved."""

from dataclasses import replace

import numpy as np
import pytest
from graphs import complete, two_components
from planner_examples import (
    RADIUS,
    antipodal_swarm,
    continuous_separation,
    immobile,
    make_planner,
    random_swarm,
    renumbered,
    total_cost,
    with_previous_plans,
)

from sato.network.load import Load
from sato.scp.exchange import ConflictResolution
from sato.scp.negotiation import negotiate
from sato.scp.planner import is_clear
from sato.scp.priority_orders import offset_right, try_priority_orders
from sato.scp.resolve import (
    OFFSETS,
    can_use_roundabout,
    resolve_conflicts,
    solve_roundabout,
    update_in_turn,
)


def spin(planners):
    """Angular momentum of each agent about the center, summed over time."""
    found = []
    for p in planners.values():
        place, speed = p.nominal.x[:, :2], p.nominal.x[:, 2:]
        found.append(np.sum(place[:, 0] * speed[:, 1] - place[:, 1] * speed[:, 0]))
    return np.array(found)


@pytest.mark.parametrize(("bend", "hand"), [(1.0, 1), (2.0, 1), (-1.0, -1), (-2.0, -1)])
def test_all_go_around_on_one_side_separated_and_reach_targets(bend, hand):
    planners = antipodal_swarm(5, 1.5)
    found = solve_roundabout(planners, complete(len(planners)), bend)
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
    # A turn each, one round of trajectories, and a flood of the outcome.
    assert found.round_count == 5 + 1 + 1


def test_later_turns_use_the_plans_of_earlier_ones():
    # If all planned around the first messages, these six would never be clear.
    planners = antipodal_swarm(6, 1.5)
    found = solve_roundabout(planners, complete(len(planners)), -1.0)
    assert (found.planners.keys(), found.solve_count) == (planners.keys(), 6)


def test_agents_in_conflict_after_a_round_have_another_turn():
    # With so small an offset, the first agents conflict in round one and not in a later one.
    planners = antipodal_swarm(7, 1.5)
    found = solve_roundabout(planners, complete(len(planners)), 0.1)
    assert found.planners.keys() == planners.keys()
    assert found.round_count % (7 + 2) == 0 and found.round_count > 7 + 2
    assert found.solve_count == sum(p.solve_count for p in found.planners.values()) > 7
    assert continuous_separation(found.planners) >= RADIUS


def test_resolution_is_the_cheaper_of_orders_and_roundabout(monkeypatch):
    planners = antipodal_swarm(5, 1.5)
    graph = complete(len(planners))
    settled = try_priority_orders(planners, graph, 2)
    ordered = negotiate(settled.planners, graph, 2)
    begun = solve_roundabout(planners, graph, -1.0)
    negotiated = negotiate(begun.planners, graph, 2)
    monkeypatch.setattr("sato.scp.resolve.OFFSETS", [-1.0])
    resolved = resolve_conflicts(planners, graph, 2, 2)
    assert total_cost(resolved.planners) == total_cost(negotiated.planners)
    assert total_cost(resolved.planners)[:2] == (0, 0)
    assert continuous_separation(resolved.planners) >= RADIUS
    assert total_cost(resolved.planners)[2] < 0.95 * total_cost(ordered.planners)[2]
    parts = settled, ordered, begun, negotiated
    assert resolved.solve_count == sum(part.solve_count for part in parts)
    # And floods of the costs.
    assert resolved.round_count == sum(part.round_count for part in parts) + 2


def test_both_sides_are_tried_with_two_offsets_each(monkeypatch):
    tried = []

    def nowhere(planners, graph, bend):
        tried.append(bend)
        return ConflictResolution({}, 0, 0, Load.none(len(graph.alive)))

    monkeypatch.setattr("sato.scp.resolve.solve_roundabout", nowhere)
    planners = antipodal_swarm(5, 1.5)
    resolve_conflicts(planners, complete(len(planners)), 1, 1)
    assert sorted(tried) == [-2.0, -1.0, 1.0, 2.0]


def test_component_without_cost_has_no_roundabout(monkeypatch):
    monkeypatch.setattr("sato.scp.resolve.OFFSETS", OFFSETS[:1])
    dear = antipodal_swarm(3, 1.5)
    cheap = {3 + i: make_planner(3 + i, [9.0, 2.0 * i], [11.0, 2.0 * i]) for i in (0, 1)}
    both = resolve_conflicts(dear | cheap, two_components(3, 2), 1, 1)
    assert both.solve_count == resolve_conflicts(dear, complete(len(dear)), 1, 1).solve_count
    assert all(both.planners[i].nominal is p.nominal for i, p in cheap.items())


def test_resolution_never_costs_more_than_negotiated_orders(rng):
    for _ in range(2):
        planners = random_swarm(rng, 4, box=3.0)
        graph = complete(len(planners))
        ordered = negotiate(try_priority_orders(planners, graph, 2).planners, graph, 2)
        resolved = resolve_conflicts(planners, graph, 2, 2)
        assert total_cost(resolved.planners) <= total_cost(ordered.planners)
        assert continuous_separation(resolved.planners) >= RADIUS


@pytest.mark.parametrize("axes", [2, 3])
def test_no_roundabout_without_sweeps_or_in_space(rng, axes):
    planners = random_swarm(rng, 4, axes)
    graph, sweeps = complete(len(planners)), axes - 2
    settled = try_priority_orders(planners, graph, 2)
    ordered = negotiate(settled.planners, graph, sweeps)
    resolved = resolve_conflicts(planners, graph, 2, sweeps)
    assert resolved.solve_count == settled.solve_count + ordered.solve_count
    # And floods of the costs.
    assert resolved.round_count == settled.round_count + ordered.round_count + sweeps
    for i, p in ordered.planners.items():
        np.testing.assert_array_equal(p.nominal.u, resolved.planners[i].nominal.u)


def test_previous_plan_or_missed_target_excludes_a_roundabout():
    planners = antipodal_swarm(4, 1.5)
    graph = complete(len(planners))
    before = solve_roundabout(planners, graph, 1.0).planners
    stuck = immobile(0, planners[0].nominal.x[0, :2])
    kept = with_previous_plans(planners, before)[0]
    lost = stuck._replace(target_state=stuck.target_state + 1e-5)
    assert all(map(can_use_roundabout, planners.values())) and can_use_roundabout(stuck)
    for one in (kept, lost):
        assert not can_use_roundabout(one)
        some = planners | {0: one}
        settled = try_priority_orders(some, graph, 1)
        ordered = negotiate(settled.planners, graph, 1)
        resolved = resolve_conflicts(some, graph, 1, 1)
        assert resolved.solve_count == settled.solve_count + ordered.solve_count


def test_components_go_around_independently():
    left, right = antipodal_swarm(4, 1.5), antipodal_swarm(3, 1.5)
    both = left | renumbered(right, 4)
    together = solve_roundabout(both, two_components(4, 3), 1.0).planners
    for some, first in ((left, 0), (right, 4)):
        for i, p in solve_roundabout(some, complete(len(some)), 1.0).planners.items():
            np.testing.assert_array_equal(p.nominal.u, together[first + i].nominal.u)


def test_turn_keeps_clear_of_all_neighbors_of_any_priority():
    planners = {i: offset_right(p, 0.3) for i, p in antipodal_swarm(4, 1.5).items()}
    told = tuple(planners[i].message for i in (1, 2, 3))
    first = planners[0]._replace(priority=(True, -99.0, 0))
    after, same = update_in_turn(planners[0], told), update_in_turn(first, told)
    np.testing.assert_array_equal(after.control_points, same.control_points)
    assert is_clear(after.control_points, told, RADIUS)
    assert not is_clear(planners[0].control_points, told, RADIUS)


def test_turn_relinearizes_and_drops_the_tie_break():
    planners = antipodal_swarm(3, 1.5)
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


def test_turn_relaxes_only_where_infeasible():
    me = offset_right(make_planner(2, [-1.0, 0.0], [1.0, 0.0]), 1.0)
    places = {"on the way": [0.0, 0.0], "at the goal": [1.0, 0.2], "at the start": [-0.6, 0.1]}
    after, keeps = {}, {}
    for name, place in places.items():
        others = (immobile(0, place).message,)
        after[name] = update_in_turn(me, others)
        keeps[name] = is_clear(after[name].control_points, others, RADIUS)
    assert [p.solve_count for p in after.values()] == [1, 2, 2]
    assert [p.reaches_target(p.nominal) for p in after.values()] == [True, False, True]
    assert list(keeps.values()) == [True, True, False]
    straight = me.with_nominal(me.solo).control_points
    assert np.abs(after["at the start"].control_points - straight).max() > 0.1


def test_agent_alone_or_infeasible_sends_the_path_that_it_flies(monkeypatch):
    planners = {i: offset_right(p, 1.0) for i, p in antipodal_swarm(2, 1.5).items()}
    alone = update_in_turn(planners[0], ())
    monkeypatch.setattr("sato.scp.resolve.solve_around", lambda *_: None)
    without = update_in_turn(planners[0], (planners[1].message,))
    for p in (alone, without):
        np.testing.assert_array_equal(
            p.control_points, p.horizon.control_points(p.nominal.x, p.nominal.u)
        )
    assert without.solve_count == 2
    assert solve_roundabout(antipodal_swarm(2, 1.5), complete(len(planners)), 1.0).planners == {}


def test_one_infeasible_agent_excludes_its_component():
    me = make_planner(2, [-1.0, 0.0], [0.0, 0.0])
    walls = {i: immobile(i, [0.1 * i, 0.0]) for i in range(2)}
    far = renumbered(antipodal_swarm(3, 1.5), 3)
    found = solve_roundabout(walls | {2: me} | far, two_components(3, 3), 1.0)
    assert found.planners.keys() == far.keys()
    assert found.solve_count > sum(p.solve_count for p in found.planners.values())


def test_immobile_agent_stays_and_all_go_around_it():
    planners = antipodal_swarm(4, 1.5)
    still = immobile(4, [0.0, 0.0])
    crowd = planners | {4: still}
    found = solve_roundabout(crowd, complete(len(crowd)), 1.0).planners
    assert found.keys() == {0, 1, 2, 3, 4}
    np.testing.assert_array_equal(found[4].control_points, still.control_points)
    for i in range(4):
        assert is_clear(found[i].control_points, [still.message], RADIUS)
