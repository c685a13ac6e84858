"""Centralized problem: laws, convex cases, and the distributed method against it."""

import sys
from dataclasses import replace
from pathlib import Path

import casadi
import numpy as np
import pytest
from graphs import complete
from numpy.testing import assert_allclose
from planner_examples import RADIUS, STEP, T, make_planner

from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from dynamics.trajectory_geometry import evaluate_bezier, separations
from problems.centralized import CentralizedProblem, NoFeasibleSolution
from problems.centralized_nlp import SeparationConstraints, SwarmProgram
from problems.convexify import AvoidanceHorizon
from problems.transfer import TransferProblem
from sato.reconfiguration.solo_trajectories import solve_solo_transfers
from sato.scp.exchange import run_scp

sys.path.append(str(Path(__file__).parents[1] / "campaigns"))
from price import displace_guess


def question(axes=2, radius=RADIUS, pieces=2, model=None, step=STEP, **norms):
    model = model or DoubleIntegrator(axes)
    limits = {"max_control": 0.2, "max_speed": 0.6} | norms
    steps = discretize_zoh(model, step, T)
    return CentralizedProblem(
        TransferProblem(steps, **limits),
        AvoidanceHorizon(steps, discretize_zoh(model, step / pieces, pieces * T), radius),
    )


def at_rest(places):
    places = np.asarray(places, dtype=float)
    return np.hstack([places, np.zeros_like(places)])


CROSSING = at_rest([[-1.5, 0.0], [1.5, 0.1]]), at_rest([[1.5, 0.05], [-1.5, 0.0]])


def by_themselves(central, start, goal):
    flights = [f for f in solve_solo_transfers(central.transfer, start, goal)[0] if f is not None]
    return np.stack([f.x for f in flights]), np.stack([f.u for f in flights])


def by_priority(central, start, goal):
    transfer, axes = replace(central.transfer, tie_break_rise=1e-3), start.shape[1] // 2
    planners = {
        i: make_planner(
            i, start[i, :axes], goal[i, :axes], transfer=transfer, horizon=central.horizon
        )
        for i in range(len(start))
    }
    after, *_ = run_scp(planners, complete(len(planners)))
    assert all(max(p.terminal_error, p.slack) <= 1e-6 for p in after.values())
    assert not any(p.has_failed for p in after.values())
    return np.stack([p.nominal.x for p in after.values()]), np.stack(
        [p.nominal.u for p in after.values()]
    )


def keeps_everything(central, found, start, goal):
    """Check feasibility step by step and densely between the samples."""
    transfer, d = central.transfer, central.transfer.model.axes
    for x, u, begin, end in zip(found.x, found.u, start, goal, strict=True):
        state = begin
        for k in range(T):
            steps = transfer.model
            state = steps.A[k] @ state + steps.B[k] @ u[k] + steps.z[k]
            assert_allclose(state, x[k + 1], atol=1e-12)
        assert_allclose(state, end, atol=1e-6)
        order = {"inf": np.inf}.get(transfer.control_norm, transfer.control_norm)
        assert np.linalg.norm(u, order, axis=1).max() <= transfer.max_control * (1 + 1e-9)
        assert np.linalg.norm(x[1:-1, d:], axis=1).max() <= transfer.max_speed * (1 + 1e-9)
    path = central.horizon.control_points(found.x, found.u)
    dense = np.stack([evaluate_bezier(path, f) for f in np.linspace(0, 1, 41)], axis=-2)
    for i in range(len(path)):
        for j in range(i):
            assert np.linalg.norm(dense[i] - dense[j], axis=-1).min() >= RADIUS * (1 - 1e-6)


@pytest.mark.parametrize("axes", [2, 3])
def test_two_crossing_agents_need_no_more_fuel_than_by_priority(axes):
    central = question(axes)
    start, goal = (
        np.insert(side, [2] * (axes - 2) + [4] * (axes - 2), 0.0, 1) for side in CROSSING
    )
    planned, free = by_priority(central, start, goal), by_themselves(central, start, goal)
    assert central.simulate(start, goal, planned[1], "SATO").is_feasible
    assert not central.simulate(start, goal, free[1], "alone").is_feasible
    best, tried = central.solve(start, goal, [planned, free])
    keeps_everything(central, best, start, goal)
    assert best.cost <= tried[0].cost
    assert best.cost >= tried[1].cost - 1e-9  # no agent needs less fuel than alone
    x = np.moveaxis(best.x, 0, 1)
    closest = separations(x[..., :axes], x[..., axes:], np.ones(x.shape[:2], dtype=bool), STEP)
    assert closest.minimum.distance == pytest.approx(RADIUS * best.min_separation, rel=1e-9)
    assert best.min_separation <= 1.001  # the constraint is active


@pytest.mark.parametrize("is_in_orbit", [False, True])
def test_distant_agents_fly_their_own_transfers(is_in_orbit):
    if is_in_orbit:
        limits = {"step": 60.0, "max_control": 0.01, "max_speed": 4.0}
        central = question(3, 50.0, model=ClohessyWiltshire(1.1e-3), **limits)
        start = at_rest([[0.0, 0.0, 0.0], [1000.0, 500.0, 0.0]])
        goal = start + at_rest([[100.0, 200.0, 30.0], [50.0, -80.0, 40.0]])
    else:
        central, start = question(), at_rest([[0.0, 0.0], [9.0, 0.0], [0.0, 9.0]])
        goal = start + at_rest([[3.0, 1.0], [1.0, -2.0], [0.5, 0.0]])
    free = [central.transfer.solve(*ends) for ends in zip(start, goal, strict=True)]
    still = np.zeros((len(start), T, start.shape[1] // 2))
    best, tried = central.solve(
        start, goal, [(central.transfer.model.simulate(start, still), still)]
    )
    assert not tried[0].is_feasible  # the optimum is not among the guesses
    assert best.cost == pytest.approx(sum(f.fuel for f in free), rel=1e-6)
    keeps_everything(central, best, start, goal)


def test_a_feasible_guess_is_never_lost():
    central = question()
    start, goal = CROSSING
    planned = by_priority(central, start, goal)
    astray = np.full_like(planned[0], 1e3), planned[1]
    best, tried = central.solve(start, goal, [astray])
    assert best.cost <= tried[0].cost and tried[0].solver_message == "initial guess"


def test_solutions_dearer_than_the_best_feasible_one_are_abandoned(monkeypatch):
    solve, solved = SwarmProgram.solve, []

    def counted(*args):
        solved.append(args)
        return solve(*args)

    monkeypatch.setattr(SwarmProgram, "solve", counted)
    central, start, goal, (cheap, dear) = through_one_point(np.random.default_rng(3), 3)
    best, _ = central.solve(start, goal, [cheap])
    alone_takes = len(solved)
    worse, _ = central.solve(start, goal, [dear])
    assert worse.cost > 1.1 * best.cost and len(solved) > alone_takes + 1
    solved.clear()
    again, _ = central.solve(start, goal, [cheap, dear])
    assert again.cost == best.cost and len(solved) == alone_takes + 1


def test_without_a_feasible_solution_all_solutions_are_raised():
    # The time just suffices to fly straight, and for a displacement of 1.8 m on the other axis.
    central = question(radius=7.0, max_speed=np.inf)
    start, goal = at_rest([[-3.59, 0.0], [3.59, 0.0]]), at_rest([[3.59, 0.0], [-3.59, 0.0]])
    free = by_themselves(central, start, goal)
    guesses = [free, displace_guess(free, STEP, np.array([[0.0, 1.0], [0.0, -1.0]]))]
    with pytest.raises(NoFeasibleSolution, match="none of 4 solutions is feasible") as raised:
        central.solve(start, goal, guesses)
    assert raised.value.problem is central
    assert len(raised.value.solutions) == 4
    assert all(t.max_violation > 1e-3 for t in raised.value.solutions)


def through_one_point(rng, count):
    """Agents that exchange sides of a circle, with plain and displaced guesses."""
    turn = np.linspace(0, 2 * np.pi, count, endpoint=False) + rng.uniform(-0.2, 0.2, count)
    start = at_rest(1.6 * np.column_stack([np.cos(turn), np.sin(turn)]))
    central, goal = question(), -start
    free = by_themselves(central, start, goal)
    aside = displace_guess(free, STEP, RADIUS * rng.normal(size=(count, 2)))
    return central, start, goal, [free, aside]


@pytest.mark.parametrize(("count", "instances"), [(3, 3), (4, 1)])
def test_optima_need_hardly_any_padding(rng, count, instances):
    for _ in range(instances):
        central, start, goal, guesses = through_one_point(rng, count)
        best, tried = central.solve(start, goal, guesses)
        assert max(t.padding for t in tried if t.is_feasible) <= 1e-3
        assert best.min_separation <= 1.001
        keeps_everything(central, best, start, goal)


def test_close_ends_and_unsupported_problems_are_refused():
    central, near = question(), at_rest([[0.0, 0.0], [0.4, 0.0]])
    with pytest.raises(ValueError, match=r"two starts are 0\.4 m apart"):
        central.solve(near, CROSSING[1], [])
    with pytest.raises(ValueError, match=r"two goals are 0\.4 m apart"):
        central.solve(CROSSING[0], near, [])
    with pytest.raises(ValueError, match="guesses must have at least one entry"):
        central.solve(*CROSSING, [])
    with pytest.raises(ValueError, match=r"^guess\.0: must be an array"):
        central.nonlinear_program(*CROSSING, (np.zeros((2, 3, 4)), np.zeros((2, 2, 2))))
    with pytest.raises(ValueError, match="fuel_norm must be 1 or inf"):
        question(fuel_norm=2)
    with pytest.raises(ValueError, match="got 12 steps and 6"):
        replace(central, transfer=replace(central.transfer, model=central.transfer.model[:6]))


@pytest.mark.parametrize(
    "spoilt", ["control_violation", "speed_violation", "terminal_error", "separation"]
)
def test_simulation_reveals_each_kind_of_violation(spoilt):
    central = question()
    start, goal = CROSSING
    good = by_priority(central, start, goal)[1]
    assert central.simulate(start, goal, good, "").is_feasible
    u, other, end = good.copy(), central, goal
    if spoilt == "control_violation":
        other = question(max_control=0.99 * np.abs(good).max())
    elif spoilt == "speed_violation":
        fastest = np.linalg.norm(central.simulate(start, goal, good, "").x[..., 2:], axis=-1).max()
        other = question(max_speed=0.99 * fastest)
    elif spoilt == "terminal_error":
        end = goal + 1e-5
    else:
        u = by_themselves(central, start, goal)[1]
    found = other.simulate(start, end, u, "")
    assert not found.is_feasible
    names = ("terminal_error", "control_violation", "speed_violation")
    broken = {name for name in names if getattr(found, name) > 1e-6}
    assert broken | ({"separation"} if found.min_separation < 1 - 1e-6 else set()) == {spoilt}


def test_a_displaced_guess_keeps_its_ends_and_is_consistent():
    x, u = np.zeros((2, T + 1, 4)), np.zeros((2, T, 2))
    by = np.array([[1.0, 0.0], [0.0, -2.0]])
    bent, same = displace_guess((x, u), STEP, by)
    np.testing.assert_array_equal(same, u)
    assert_allclose(bent[:, T // 2, :2], by)
    assert_allclose(bent[:, [0, -1], :2], 0, atol=1e-12)
    fine, _ = displace_guess((np.zeros((2, 1001, 4)), np.zeros((2, 1000, 2))), 0.012, by)
    slope = np.gradient(fine[..., :2], 0.012, axis=1)
    assert_allclose(slope[:, 1:-1], fine[:, 1:-1, 2:], atol=1e-4)


def test_only_the_same_pair_near_the_same_time_gets_a_larger_distance():
    pair, time = np.array([[0, 1], [2, 0], [1, 2], [0, 1]]), np.array([0.3, 1.0, 24.0, 11.71])
    instants = SeparationConstraints(pair, time, np.array([1.0, 1.25, 1.0, 1.5]))
    others = SeparationConstraints(pair[[0, 0]], np.array([0.9, 1.1]), np.ones(2))
    raised = instants.enlarge_distance(others, np.array([0.01, 0.02]), 2.0)
    assert_allclose(raised.min_distance - instants.min_distance, [0.02, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("axes", [2, 3])
def test_relative_positions_are_those_of_the_trajectories(rng, axes):
    central = question(axes)
    x, u = rng.normal(size=(3, T + 1, 2 * axes)), rng.uniform(-0.2, 0.2, (3, T, axes))
    pair, time = np.array([[0, 1], [2, 0], [1, 2], [0, 1]]), np.array([0.3, 5.0, 24.0, 11.71])
    instants = SeparationConstraints(pair, time, np.ones(4))
    piece = np.minimum(time.astype(int), 23)
    path = central.horizon.control_points(x, u)
    own, other = (path[pair[:, side], piece] for side in (0, 1))
    expected = evaluate_bezier(own - other, time - piece) / RADIUS
    program = SwarmProgram(central.transfer, central.horizon)
    Dx, Du = program._relative_position_maps(3, instants)
    found = Dx @ (x / program.state_units).ravel() + Du @ (u / 0.2).ravel()
    assert_allclose(found.reshape(expected.shape), expected, atol=1e-12)


def test_the_reported_status_does_not_decide_feasibility():
    central, (start, goal) = question(), CROSSING
    nowhere = SeparationConstraints(np.zeros((0, 2), dtype=int), np.zeros(0), np.zeros(0))
    program, free = (
        SwarmProgram(central.transfer, central.horizon),
        by_themselves(central, *CROSSING),
    )
    _, u, said = program.solve(CROSSING, free, nowhere)
    assert "Solve_Succeeded" in said  # of a program without separation constraints
    assert not central.simulate(start, goal, u, said).is_feasible


QUIET = {"ipopt": {"print_level": 0, "sb": "yes"}, "print_time": False}


def solve_program(program, method="ipopt", options=QUIET):
    solver = casadi.nlpsol("central", method, program.problem, options)
    return program.trajectories(solver(**program.arguments)["x"]), solver.stats()["success"]


@pytest.mark.parametrize("objective", ["fuel", "energy"])
def test_programs_of_distant_agents_are_solved_as_their_transfers(objective, rng):
    limits = {"max_control": 0.2, "max_speed": 0.6, "objective": objective}
    central = CentralizedProblem.from_model(DoubleIntegrator(3), 1.0, 12, RADIUS, **limits)
    start = at_rest(9 * np.eye(3) + rng.normal(size=(3, 3)))
    goal = start + at_rest(rng.uniform(-1.5, 1.5, (3, 3)))
    (x, u), is_solved = solve_program(central.nonlinear_program(start, goal))
    found = central.simulate(start, goal, u, "IPOPT")
    alone = [central.transfer.solve(*ends) for ends in zip(start, goal, strict=True)]
    assert is_solved and found.is_feasible
    assert_allclose(x, found.x, atol=1e-6)
    assert found.cost == pytest.approx(sum(map(central.transfer.cost, alone)), rel=1e-5)


@pytest.mark.parametrize("objective", ["fuel", "energy"])
def test_programs_keep_agents_apart_at_nearly_all_times(objective, rng):
    for count in (2, 3, 4):
        limits = {"max_control": 0.2, "max_speed": 0.6, "objective": objective}
        central = CentralizedProblem.from_model(DoubleIntegrator(2), 1.0, 14, RADIUS, **limits)
        turn = np.linspace(0, 2 * np.pi, count, endpoint=False) + rng.uniform(-0.2, 0.2, count)
        start = at_rest(1.6 * np.column_stack([np.cos(turn), np.sin(turn)]))
        (x, u), is_solved = solve_program(central.nonlinear_program(start, -start))
        found = central.simulate(start, -start, u, "IPOPT")
        assert is_solved and found.terminal_error <= 1e-9 and found.control_violation <= 1e-6
        assert found.speed_violation <= 1e-6 and 0.98 <= found.min_separation <= 1.001
        best, _ = central.solve(start, -start, [(x, u)])
        assert best.cost >= found.cost * (1 - 1e-6)  # more instants, not less cost


@pytest.mark.parametrize("method", ["sleqp", "uno"])
def test_other_solvers_find_the_same_optimum(method):
    limits = {"max_control": 0.3, "objective": "energy"}
    central = CentralizedProblem.from_model(DoubleIntegrator(2), 1.0, 8, RADIUS, **limits)
    program = central.nonlinear_program(*CROSSING)
    (_, first), _ = solve_program(program)
    (_, second), is_solved = solve_program(program, method, {"print_time": False})
    costs = [central.simulate(*CROSSING, u, "").cost for u in (first, second)]
    assert is_solved and costs[1] == pytest.approx(costs[0], rel=1e-6)
