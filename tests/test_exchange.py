"""Sequential convex programming: laws of Method 2, and batched exchanges."""

from itertools import pairwise

import numpy as np
import pytest
from graphs import complete, graph_of
from messages import plan_by_messages
from planner_examples import (
    RADIUS,
    T,
    continuous_separation,
    immobile,
    keeps_all,
    make_planner,
    make_problem,
    random_swarm,
    weighted_fuel,
    with_previous_plans,
)

from problems.avoidance import AvoidanceProblem
from problems.conic import ConicSolution, solve
from problems.convexify import choose_normals, convexify
from problems.path_separation import are_hulls_separated
from problems.solvers import solve_clarabel
from problems.transfer import Trajectory
from sato.network.graph import CommunicationGraph
from sato.scp.exchange import run_batched, run_scp
from sato.scp.planner import (
    CONVERGENCE_TOLERANCE,
    MAX_SOLVES,
    TrajectoryMessage,
    update_planner,
)


@pytest.mark.parametrize(("count", "axes"), [(4, 2), (8, 2), (8, 3)])
@pytest.mark.parametrize("again", [False, True])
def test_batched_exchanges_equal_the_definition(rng, count, axes, again):
    # Random graphs and priorities, an immobile agent, and previous plans.
    longest = 0
    for _ in range(4):
        planners = random_swarm(rng, count, axes)
        spent = rng.permutation(count)
        planners = {
            i: p._replace(priority=(True, -float(spent[i]), i)) for i, p in planners.items()
        }
        planners[0] = immobile(0, planners[0].nominal.x[0, :axes])
        adjacency = np.triu(rng.random((count, count)) < 0.7, 1)
        graph = graph_of(adjacency)
        if again:
            after, *_ = run_scp(planners, graph)
            some = {i: p for i, p in planners.items() if 0 < i < count // 2 + 1}
            planners |= with_previous_plans(some, after)
        slow, fast = list(plan_by_messages(planners, graph)), list(run_batched(planners, graph))
        assert len(slow) == len(fast)
        longest = max(longest, len(slow))
        for a, b in zip(slow, fast, strict=True):
            for i in planners:
                np.testing.assert_array_equal(a[i].nominal.x, b[i].nominal.x)
                np.testing.assert_array_equal(a[i].control_points, b[i].control_points)
                assert a[i].is_final == b[i].is_final and a[i].solve_count == b[i].solve_count
                assert a[i].has_converged == b[i].has_converged
                assert a[i].terminal_error == b[i].terminal_error
                assert a[i].slack == b[i].slack and a[i].has_failed == b[i].has_failed
    assert longest > 3


@pytest.mark.parametrize("axes", [2, 3])
def test_continuous_paths_keep_the_collision_radius(rng, axes):
    for _ in range(5):
        planners = random_swarm(rng, 6, axes, box=4.0)
        after, *_ = run_scp(planners, complete(len(planners)))
        ended = [p._replace(terminal_error=0.0) for p in after.values()]
        assert all(keeps_all(p) and not p.has_failed for p in ended)
        assert continuous_separation(after) >= RADIUS


def test_iterates_stay_feasible_and_costs_do_not_rise(rng):
    # Propositions 4 and 6: once an iterate is feasible, so is the next, at no higher cost.
    improved = 0
    for _ in range(8):
        planners = random_swarm(rng, 5)
        others = [
            TrajectoryMessage((False, 0.0, i), planners[i].control_points, True, RADIUS)
            for i in range(4)
        ]
        me, costs = planners[4], []
        for _ in range(10):
            after = update_planner(me._replace(is_final=False, has_converged=False), others)
            relative = after.control_points - np.stack([p.control_points for p in others])
            feasible = bool(are_hulls_separated(relative, RADIUS).all()) and keeps_all(after)
            assert feasible or not costs  # once feasible, always feasible
            if feasible:
                costs.append(weighted_fuel(after.nominal, me.transfer))
            me = after
        assert all(b <= a + 1e-7 for a, b in pairwise(costs))
        improved += len(costs) > 2 and costs[-1] < costs[0] - 1e-6
    assert improved > 0


def test_fixed_point_satisfies_the_kkt_conditions(rng, monkeypatch):
    # Theorem 7: a fixed point of the convex program is a KKT point of Problem 4. About the
    # end there must be multipliers that are dual feasible, and complementary with the end.
    monkeypatch.setattr("sato.scp.planner.CONVERGENCE_TOLERANCE", 1e-6)
    monkeypatch.setattr("sato.scp.planner.MAX_SOLVES", 100)
    tested = 0
    for _ in range(6):
        planners = random_swarm(rng, 5)
        after, *_ = run_scp(planners, complete(len(planners)))
        for i, me in after.items():
            if me.solve_count == 0 or me.solve_count >= 100 or not keeps_all(me):
                continue
            above = np.stack([p.control_points for j, p in after.items() if j < i])
            spaces = convexify(
                me.horizon,
                T,
                above,
                choose_normals(me.control_points - above, me.horizon.required_separation),
            )
            program = AvoidanceProblem(me.transfer, me.nominal.x[0], me.target_state, spaces)
            conic = program.assemble_conic("none", np.arange(1, T))
            y = solve(conic, solve_clarabel).y
            u = me.nominal.u.ravel() / me.transfer.max_control
            end = np.concatenate([np.maximum(u, 0), np.maximum(-u, 0)])
            kkt = ConicSolution.evaluate(conic, end, y)
            assert kkt.primal_residual < 1e-6 and kkt.dual_residual < 1e-6
            assert abs(y @ (conic.b - conic.A @ end)) < 1e-5
            tested += 1
    assert tested > 5


def test_agents_converge_when_their_trajectories_hardly_move(rng):
    # [Morgan2016, eq. 39]
    planners, converged = random_swarm(rng, 6), []
    history = [planners, *plan_by_messages(planners, complete(len(planners)))]
    for before, after in pairwise(history):
        for i, p in after.items():
            if before[i].solve_count < p.solve_count < MAX_SOLVES:
                moved = np.abs(p.nominal.x - before[i].nominal.x).max()
                assert p.has_converged == (moved <= CONVERGENCE_TOLERANCE * RADIUS)
                converged.append(p.has_converged)
    assert len(set(converged)) == 2


def test_trajectories_become_final_in_order_of_priority(rng):
    # Theorem 8.
    planners = random_swarm(rng, 6)
    when = {}
    for exchange, now in enumerate(plan_by_messages(planners, complete(len(planners)))):
        for i, p in now.items():
            if p.is_final:
                when.setdefault(i, exchange)
    assert all(when[i] < when[j] for i, j in pairwise(range(6)))


def test_agent_with_more_fuel_left_gives_way_also_head_on():
    ends = ([-1.5, 0.0], [1.5, 0.0])
    for spent in ((0.0, 1.0), (1.0, 0.0)):
        pair = {0: make_planner(0, *ends, spent[0]), 1: make_planner(1, *ends[::-1], spent[1])}
        after, *_ = run_scp(pair, complete(2))
        gives_way = int(np.argmin(spent))
        assert after[1 - gives_way].nominal is pair[1 - gives_way].solo
        assert after[gives_way].solve_count > 0
        assert keeps_all(after[gives_way])
        assert continuous_separation(after) >= RADIUS


@pytest.mark.parametrize("side", [-0.7, 0.7])
def test_agent_keeps_to_the_side_of_its_previous_plan(side):
    pair = {
        0: make_planner(0, [-1.5, 0.0], [1.5, 0.0]),
        1: make_planner(1, [1.5, 0.01], [-1.5, 0.01]),
    }
    x, u = pair[1].solo.x.copy(), pair[1].solo.u
    x[1:-1, 1] += side  # a plan that passes on that side
    begun = pair[1].with_nominal(Trajectory(x, u, 0.0))._replace(has_converged=False)
    after, *_ = run_scp(pair | {1: begun}, complete(len(pair)))
    assert keeps_all(after[1])
    assert np.sign(after[1].nominal.x[T // 2, 1]) == np.sign(side)
    assert continuous_separation(after) >= RADIUS


def test_agent_returns_to_its_solo_trajectory_when_clear(rng):
    planners = random_swarm(rng, 5)
    after, *_ = run_scp(planners, complete(len(planners)))
    last = max((p for p in after.values() if p.solve_count), key=lambda p: p.priority).priority[2]
    begun = with_previous_plans({last: planners[last]}, after)
    alone, *_ = run_scp(begun, graph_of(np.zeros((5, 5), dtype=bool)))
    assert alone[last].nominal is planners[last].solo
    assert alone[last].is_final and alone[last].solve_count == 0


def test_terminal_state_is_relaxed_before_separation():
    # An immobile agent is at the target: the other stops short of it.
    parked = immobile(0, [1.0, 0.0]).message._replace(is_final=True)
    me = update_planner(make_planner(1, [-1.0, 0.0], [1.0, 0.0]), [parked])
    assert me.terminal_error > 0.4 and keeps_all(me._replace(terminal_error=0.0))
    assert are_hulls_separated(me.control_points - parked.control_points, RADIUS).all()
    # Another agent flies through it faster than it can move away.
    time = np.arange(2 * T)[:, None] / 2 + np.arange(4) / 6
    through = np.stack([5 - 4 * time, np.zeros_like(time)], axis=-1)
    rammed = update_planner(
        make_planner(1, [0.0, 0.1], [0.0, 1.0]), [parked._replace(control_points=through)]
    )
    assert rammed.slack > 0.01


def test_effects_travel_one_hop_an_exchange(rng):
    # In a row of agents, each in conflict with the next, a change at one end
    # has no effect h hops away before exchange h, to the last bit.
    row = {i: make_planner(i, [0.51 * i, 0.0], [0.51 * i, 0.9]) for i in range(7)}
    other = dict(row)
    other[0] = make_planner(0, [0.0, 0.0], [0.0, 0.9], velocity=0.2)
    graph = graph_of(np.abs(np.subtract.outer(np.arange(7), np.arange(7))) == 1)
    for run in (plan_by_messages, run_batched):
        one, two = list(run(row, graph)), list(run(other, graph))
        reached = 0
        for w, (a, b) in enumerate(zip(one, two, strict=False)):
            differs = [i for i in row if not np.array_equal(a[i].nominal.x, b[i].nominal.x)]
            reached = max([reached, *differs])
            assert reached <= w + 1  # the exchange of index 0 is the first
        assert reached >= 3


def test_final_planner_ignores_messages(rng):
    me = random_swarm(rng, 2)[1]._replace(is_final=True)
    ram = TrajectoryMessage((False, 0.0, 0), me.control_points, True, RADIUS)
    assert update_planner(me, [ram]) is me


def test_scp_without_agents_takes_no_exchange():
    nobody = CommunicationGraph(np.zeros((3, 3), dtype=bool), np.zeros(3, dtype=bool))
    assert run_scp({}, nobody)[:2] == ({}, 0)


def test_paths_pass_through_states_and_drift_after_the_last_step():
    me = make_planner(0, [0.0, 0.0], [2.0, 1.0], horizon=make_problem(horizon_steps=T + 4)[1])
    start, end = me.control_points[::2, 0], me.control_points[1::2, 3]
    np.testing.assert_allclose(start[: T + 1], me.nominal.x[:, :2], atol=1e-12)
    np.testing.assert_allclose(end[:T], me.nominal.x[1:, :2], atol=1e-12)
    np.testing.assert_allclose(end[T:], np.tile(me.nominal.x[-1, :2], (4, 1)), atol=1e-8)


def test_clear_nominal_satisfies_its_own_half_spaces(rng):
    # Proposition 5, for hulls: n·b ≥ distance of the hull.
    relative = rng.normal(size=(50, 8, 4, 2)) * 0.3 + rng.normal(size=(50, 8, 1, 2)) * 3
    keep = are_hulls_separated(relative, RADIUS).all(axis=1)
    n = choose_normals(relative[keep], RADIUS)
    assert np.einsum("akd,akid->aki", n, relative[keep]).min() >= RADIUS * (1 - 1e-12)
    np.testing.assert_allclose(np.linalg.norm(n, axis=-1), 1, rtol=1e-12)


def test_normals_of_a_collision_point_to_the_side_asked():
    time = np.arange(16)[:, None] + np.arange(4) / 3
    straight = np.stack([(time - 8.5) * 0.3, np.full_like(time, 0.1)], axis=-1)[None]
    near, far = choose_normals(straight, RADIUS), choose_normals(straight, RADIUS, "opposite")
    middle = 8
    assert near[0, middle, 1] > 0.9 and far[0, middle, 1] < -0.9
    assert np.isfinite(near).all() and np.isfinite(far).all()


def test_normals_in_space_point_above_and_below():
    time = np.arange(16)[:, None] + np.arange(4) / 3
    along, miss = (time - 8.5) * 0.3, np.full_like(time, 0.1)
    straight = np.stack([along, miss, np.zeros_like(time)], axis=-1)[None]
    over, under = (choose_normals(straight, RADIUS, way)[0, 8] for way in ("above", "below"))
    assert abs(over[2]) > 0.9 and over[2] == pytest.approx(-under[2], rel=1e-9)


def test_cheapest_passing_side_is_chosen():
    # An immobile agent is on the path, a little to one side and below it.
    start, goal = [-1.5, 0.0, 0.0], [1.5, 0.0, 0.0]
    mover = make_planner(1, start, goal)
    stands = immobile(0, [0.0, 0.05, -0.3])
    after, *_ = run_scp({0: stands, 1: mover}, complete(2))
    fuel = after[1].nominal.fuel
    for axis, side in ((1, 1), (1, -1), (2, 1), (2, -1)):
        x = mover.solo.x.copy()
        x[1:-1, axis] += 0.8 * side
        aside = Trajectory(x, mover.solo.u, 0.0)
        other = mover.with_nominal(aside)._replace(has_converged=False)
        round_there, *_ = run_scp({0: stands, 1: other}, complete(2))
        assert fuel <= round_there[1].nominal.fuel * (1 + 1e-3)


def test_distance_that_no_control_can_keep_counts_as_slack():
    # One agent has no steps left, and the other begins too close to it.
    place = np.array([0.0, 0.8 * RADIUS])
    planners = {0: immobile(0, np.zeros(2)), 1: make_planner(1, place, place * 5)}
    after, *_ = run_scp(planners, complete(2))
    assert after[0].slack == 0.0
    assert 0.2 * RADIUS * (1 - 1e-9) <= after[1].slack <= 0.2 * RADIUS * (1 + 1e-5)
    planners[1] = immobile(1, place)
    assert run_scp(planners, complete(2))[0][1].slack == pytest.approx(0.2 * RADIUS, rel=1e-12)
