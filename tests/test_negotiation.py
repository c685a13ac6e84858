"""Negotiation in pairs: turns, agreements, and the fuel saved."""

from dataclasses import replace

import numpy as np
import pytest
from graphs import complete, graph_of, two_components
from messages import flood
from planner_examples import (
    RADIUS,
    antipodal_swarm,
    continuous_separation,
    immobile,
    left_astray,
    make_planner,
    make_problem,
    random_swarm,
    renumbered,
    total_cost,
)

from dynamics.trajectory_geometry import hull_distance
from problems.centralized import CentralizedProblem
from problems.pair_avoidance import PairProblem
from sato.network.rounds import run_round
from sato.scp.negotiation import find_nearby, negotiate, negotiate_pairs, schedule_pairs, solve_pair
from sato.scp.planner import FEASIBILITY_TOLERANCE
from sato.scp.priority_orders import try_priority_orders


def solved(planners, orders=1):
    return try_priority_orders(planners, complete(len(planners)), orders).planners


@pytest.mark.parametrize("axes", [2, 3])
def test_no_sweep_raises_the_cost_and_all_constraints_hold(rng, axes):
    saved = 0.0
    for _ in range(3):
        now = solved(random_swarm(rng, 5, axes, box=3.5))
        for _ in range(3):
            after = negotiate(now, complete(len(now)), 1).planners
            assert total_cost(after)[:2] <= total_cost(now)[:2]
            assert total_cost(after)[2] <= total_cost(now)[2] + 1e-8
            assert continuous_separation(after) >= RADIUS
            saved += total_cost(now)[2] - total_cost(after)[2]
            now = after
        for p in now.values():
            np.testing.assert_allclose(p.nominal.x[-1], p.target_state, atol=1e-6)
            np.testing.assert_array_equal(
                p.control_points, p.horizon.control_points(p.nominal.x, p.nominal.u)
            )
            assert np.abs(p.nominal.u).max() <= p.transfer.max_control * (1 + 1e-9)
            speed = np.linalg.norm(p.nominal.x[:, axes:], axis=1).max()
            assert speed <= p.transfer.max_speed * (1 + 1e-8)
    assert saved > 0.01


def unequal_swarm(rng, swarm):
    """The same starts and targets, with radii and limits of each agent's own."""
    own = {}
    for i, p in swarm.items():
        limits = {"max_control": rng.uniform(0.2, 0.5), "max_speed": rng.uniform(0.5, 1.0)}
        if i % 2:
            limits = {"max_control": rng.uniform(0.2, 0.4, 2), "speed_norm": "inf"}
            limits |= {"max_speed": rng.uniform(0.5, 1.0, 2)}
        options = {
            "transfer": replace(p.transfer, **limits),
            "horizon": p.horizon.with_clearance(rng.uniform(0.5, 1.5) * RADIUS),
        }
        own[i] = make_planner(i, p.nominal.x[0, :2], p.target_state[:2], **options)
    return own


@pytest.mark.parametrize("case", [1, 2])
def test_unequal_agents_save_fuel_within_their_own_limits(case):
    rng = np.random.default_rng(case)
    now = solved(unequal_swarm(rng, antipodal_swarm(4, 1.8)), orders=3)
    after = negotiate(now, complete(len(now)), 2).planners
    assert total_cost(after)[:2] == total_cost(now)[:2] == (0, 0)
    assert total_cost(after)[2] < 0.97 * total_cost(now)[2]
    for i, p in after.items():
        np.testing.assert_allclose(p.nominal.x[-1], p.target_state, atol=1e-6)
        speed = p.nominal.x[1:-1, 2:]
        measured = np.abs(speed) if i % 2 else np.linalg.norm(speed, axis=1)[:, None]
        assert (np.abs(p.nominal.u) <= p.transfer.max_control * (1 + 1e-9)).all()
        assert (measured <= p.transfer.max_speed * (1 + 1e-8)).all()
        for j in range(i):
            required = (p.horizon.clearance + after[j].horizon.clearance) / 2
            assert continuous_gap(after, i, j) >= required


def test_two_agents_reach_the_centralized_optimum():
    planners = antipodal_swarm(2, 1.5)
    now = solved(planners)
    start, goal = (
        np.stack([side(p) for p in planners.values()])
        for side in (lambda p: p.nominal.x[0], lambda p: p.target_state)
    )
    central = CentralizedProblem(planners[0].transfer, planners[0].horizon)
    guess = tuple(np.stack([getattr(p.nominal, part) for p in now.values()]) for part in "xu")
    best = central.solve(start, goal, [guess]).best.cost
    before = sum(p.nominal.fuel for p in now.values())
    after = sum(p.nominal.fuel for p in negotiate(now, complete(len(now)), 20).planners.values())
    assert before > 1.005 * best
    assert best * (1 - 1e-6) <= after <= 1.001 * best


def test_negotiation_saves_a_tenth_of_the_extra_fuel_of_five():
    now = solved(antipodal_swarm(5, 1.5), orders=4)
    negotiated = negotiate(now, complete(len(now)), 6)
    assert total_cost(now)[:2] == total_cost(negotiated.planners)[:2] == (0, 0)
    assert total_cost(negotiated.planners)[2] < 0.9 * total_cost(now)[2]
    assert continuous_separation(negotiated.planners) >= RADIUS


def test_agents_without_cost_have_no_turn():
    planners = {i: make_planner(i, [0.0, 0.7 * i], [2.0, 0.7 * i]) for i in range(3)}
    now = solved(planners)
    negotiated = negotiate(now, complete(len(now)), 5)
    # Trajectories of the neighbors, and a flood of the costs.
    assert (negotiated.round_count, negotiated.solve_count) == (2, 0)
    assert all(negotiated.planners[i] is now[i] for i in now)


def test_zero_sweeps_change_nothing(rng):
    now = solved(random_swarm(rng, 4))
    assert negotiate(now, complete(len(now)), 0)[:3] == (now, 0, 0)


def test_components_negotiate_independently(rng):
    left, right = solved(random_swarm(rng, 4)), solved(random_swarm(rng, 3))
    together = negotiate(left | renumbered(right, 4), two_components(4, 3), 2).planners
    for some, first in ((left, 0), (right, 4)):
        for i, p in negotiate(some, complete(len(some)), 2).planners.items():
            np.testing.assert_array_equal(p.nominal.u, together[first + i].nominal.u)


def test_scheduled_pairs_follow_from_a_flood(rng):
    now = solved(random_swarm(rng, 6, box=3.5))
    adjacency = rng.random((6, 6)) < 0.4
    graph = graph_of(np.triu(adjacency, 1))
    nearby = run_round(graph, now, find_nearby, {i: p.message for i, p in now.items()})
    turns = schedule_pairs(now, graph, now)
    for known in flood(graph, {i: {i: nearby[i]} for i in now}, dict.__or__).values():
        near = {(min(i, j), max(i, j)) for i in known for j in known[i]}
        pairs = [{a: b, b: a} for a, b in sorted(near)]
        mine = [{a: b for a, b in turn.items() if a in known} for turn in turns]
        assert [turn for turn in mine if turn] == pairs
        assert all(graph.adjacency[a, b] for a, b in near)
    assert turns


def test_both_partners_fly_the_agreed_trajectories():
    now = solved(antipodal_swarm(5, 1.5), orders=4)
    turns = schedule_pairs(now, complete(len(now)), now)
    negotiated = [negotiate_pairs(now, complete(len(now)), turn) for turn in turns]
    assert [pair.keys() for pair in negotiated] == [turn.keys() for turn in turns]
    made = 0
    for pair in negotiated:
        host, guest = (pair[i] for i in sorted(pair))
        if host.agreement:
            assert host.agreement.recipient == guest.agent_id
            assert guest.planner.nominal is host.agreement.trajectory
            assert host.planner.nominal is not now[host.agent_id].nominal
            made += 1
        assert guest.agreement is None
    assert made


def offers(now, i, j):
    negotiators = negotiate_pairs(now, complete(len(now)), {i: j, j: i})
    return [negotiators[k].offer for k in (i, j)]


def test_costlier_pair_is_rejected_unless_a_target_was_missed():
    now = solved(antipodal_swarm(3, 1.5), orders=3)
    first, second = offers(now, 0, 1)
    assert solve_pair(first, second, now[0].horizon)[0]
    fuel = sum(f.fuel for f in solve_pair(first, second, now[0].horizon)[0])
    spent = 0.99 * fuel - second.trajectory.fuel
    cheaper = first._replace(trajectory=first.trajectory._replace(fuel=spent))
    assert solve_pair(cheaper, second, now[0].horizon)[0] is None
    assert solve_pair(cheaper._replace(reaches_target=False), second, now[0].horizon)[0]


def test_pair_that_misses_a_target_is_rejected(monkeypatch):
    now = solved(antipodal_swarm(3, 1.5), orders=3)
    first, second = offers(now, 0, 1)

    def astray(by):
        def solve(pair):
            both = list(exact(pair))
            both[1] = both[1]._replace(x=both[1].x + by)
            return tuple(both)

        return solve

    exact = PairProblem.solve
    for by, agreed in (
        (0.5 * FEASIBILITY_TOLERANCE * RADIUS, True),
        (2 * FEASIBILITY_TOLERANCE * RADIUS, False),
    ):
        monkeypatch.setattr(PairProblem, "solve", astray(by))
        assert (solve_pair(first, second, now[0].horizon)[0] is not None) == agreed


def test_each_partner_linearizes_about_its_own_trajectory():
    now = solved(antipodal_swarm(3, 1.5), orders=3)
    about = {}

    def relinearize(flight):
        about[id(flight)] = replace(now[0].transfer, tie_break_rise=0.5)
        return about[id(flight)]

    curved = {i: p._replace(relinearize=relinearize) for i, p in now.items()}
    negotiators = negotiate_pairs(curved, complete(len(curved)), {0: 1, 1: 0})
    assert about.keys() == {id(now[0].nominal), id(now[1].nominal)}
    assert all(negotiators[i].planner.transfer is about[id(now[i].nominal)] for i in range(2))


def test_partners_with_different_steps_left_do_not_agree():
    now = solved(antipodal_swarm(2, 1.5))
    transfer = replace(now[1].transfer, model=now[1].transfer.model[:8])
    goal = now[1].nominal.x[8]
    short = make_planner(1, now[1].nominal.x[0, :2], goal[:2], transfer=transfer)
    negotiators = negotiate_pairs({0: now[0], 1: short}, complete(len(now)), {0: 1, 1: 0})
    assert negotiators[0].offer and negotiators[1].offer
    assert (negotiators[0].solve_count, negotiators[0].agreement) == (0, None)


def test_separation_is_kept_while_an_agent_drifts_at_its_target():
    # The third passes the target of the first while the first drifts there after its last step.
    slow, _ = make_problem()
    fast, strong = replace(slow, model=slow.model[:6]), replace(slow, max_control=0.3)
    first = make_planner(0, [-1.0, 0.0], [0.0, 0.0], transfer=fast)
    second = make_planner(1, [-1.0, 0.9], [0.0, 0.9], transfer=fast)
    third = make_planner(2, [0.1, -3.0], [0.1, 1.0], transfer=strong)
    now = {0: left_astray(first), 1: second, 2: third}
    assert continuous_gap(now, 0, 2) >= RADIUS > continuous_gap(now | {0: first}, 0, 2)
    after = negotiate(now, complete(len(now)), 3).planners
    assert continuous_gap(after, 0, 2) >= RADIUS


def continuous_gap(planners, i, j):
    return hull_distance(planners[i].control_points - planners[j].control_points)[0].min()


def test_sweeps_end_without_progress_also_off_target():
    movers = {i: make_planner(i, [-1.5, 0.3 * i], [1.5, -0.3 * i]) for i in (0, 2, 4)}
    now = solved(movers | {i: immobile(i, [9.0, float(i)]) for i in (1, 3)})
    now[4] = lost = left_astray(now[4], target_state=np.full(4, 99.0))
    few, many = (negotiate(now, complete(len(now)), sweeps) for sweeps in (4, 30))
    assert many.planners[4].nominal is lost.nominal
    assert total_cost(many.planners)[2] < 0
    assert many.solve_count < 30 and few.solve_count > 0
    assert many.round_count < 200


def test_immobile_or_infeasible_agent_makes_no_offer(rng):
    now = solved(random_swarm(rng, 3))
    spoilt = (
        immobile(0, now[0].nominal.x[0, :2]),
        now[0]._replace(has_failed=True),
        now[0]._replace(slack=0.1),
    )
    for other in spoilt:
        negotiators = negotiate_pairs(now | {0: other}, complete(len(now)), {0: 1, 1: 0})
        assert negotiators[0].offer is None
        assert negotiators[0].planner is other and negotiators[1].planner.nominal is now[1].nominal


def test_agent_off_its_target_is_taken_there_at_extra_fuel():
    ends = [([-1.5, 0.0], [1.5, 0.0]), ([0.1, -1.6], [0.1, 1.5])]
    now = solved({i: make_planner(i, *ends[i]) for i in range(2)})
    now[1] = left_astray(now[1])
    assert total_cost(now)[:2] == (0, 1)
    after = negotiate(now, complete(len(now)), 1).planners
    assert total_cost(after)[:2] == (0, 0)
    assert total_cost(after)[2] > total_cost(now)[2]
    assert after[1].terminal_error == 0 and continuous_separation(after) >= RADIUS
