"""Centralized problem of a mission: its data, and its assignment."""

from dataclasses import replace
from itertools import permutations

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import sato
from dynamics import discretize_zoh

ORBIT = sato.Orbit.from_elements(6878e3, 0.02, 0.8)


def mission(model, rng, count=4, targets=4, **more):
    scale, step, control, speed = (1.0, 1.0, 0.3, 1.0) if model.axes == 2 else (60, 60, 5e-3, 2.0)
    grid = scale * np.stack(np.meshgrid(*[1.5 * np.arange(3)] * model.axes), axis=-1)
    places = grid.reshape(-1, model.axes) + rng.uniform(-0.2, 0.2, model.axes) * scale
    start, goal = (rng.permutation(places)[:k] for k in (count, targets))
    limits = {"max_control": control, "max_speed": speed, "comm_radius": 100 * scale}
    return sato.Reconfiguration(
        model=model, start=start, legs=[sato.Leg(goal, steps=20)], step=step,
        collision_radius=0.5 * scale, **limits, **more,
    )  # fmt: skip


MODELS = [sato.DoubleIntegrator(2), sato.ClohessyWiltshire.from_orbit(ORBIT), sato.J2(ORBIT)]


@pytest.mark.parametrize("model", MODELS, ids=lambda model: type(model).__name__)
def test_the_problem_has_the_data_of_the_mission(model, rng):
    drawn = mission(model, rng, 2, 2).draw(rng)
    central = sato.central_problem(drawn)
    assert_array_equal(central.start, drawn.initial_states)
    assert_array_equal(np.unique(central.goal, axis=0), np.unique(drawn.legs[0].targets, axis=0))
    transfer, horizon = central.problem.transfer, central.problem.horizon
    own = discretize_zoh(drawn.linear_model, drawn.step, 20)
    for part in ("A", "B", "z"):
        assert_array_equal(getattr(transfer.model, part), getattr(own, part))
    assert (transfer.max_control, transfer.max_speed) == (drawn.max_control, drawn.max_speed)
    assert horizon.clearance >= drawn.collision_radius + drawn.margin
    program = central.problem.nonlinear_program(central.start, central.goal)
    quiet = {"ipopt": {"print_level": 0, "sb": "yes"}, "print_time": False}
    solver = casadi.nlpsol("central", "ipopt", program.problem, quiet)
    x, u = program.trajectories(solver(**program.arguments)["x"])
    found = central.problem.simulate(central.start, central.goal, u, "IPOPT")
    assert solver.stats()["success"] and found.terminal_error <= 1e-6
    assert_allclose(x, found.x, rtol=1e-6, atol=1e-6 * np.abs(x).max())


@pytest.mark.parametrize("choose", ["nearest", "prefix"])
def test_targets_are_assigned_at_the_least_total_cost(choose, rng):
    given = mission(MODELS[0], rng, 3, 5)
    legs = [replace(given.legs[0], choose=choose)]
    central = sato.central_problem(replace(given, legs=legs))
    targets = given.draw(np.random.default_rng(0)).legs[0].targets
    transfer, count = central.problem.transfer, 5 if choose == "nearest" else 3
    cost = np.array([[transfer.solve(x, y).fuel for y in targets[:count]] for x in central.start])
    least = min(cost[range(3), order].sum() for order in map(list, permutations(range(count), 3)))
    alone = [transfer.solve(*ends).fuel for ends in zip(central.start, central.goal, strict=True)]
    assert sum(alone) == pytest.approx(least, rel=1e-6)


def test_given_targets_and_the_objective_are_kept(rng):
    given = mission(MODELS[0], rng, assignment="given", objective="energy")
    central = sato.central_problem(given)
    assert_array_equal(central.goal[:, :2], given.legs[0].shape.positions)
    assert central.problem.transfer.objective == "energy"


@pytest.mark.parametrize(
    "more", [{"obstacles": [sato.Sphere((3.0, 9.0), 0.3)]}, {"box": [[-90, -90], [90, 90]]}]
)
def test_what_the_optimum_would_not_keep_is_refused(more):
    start = np.array([[0.0, 0.0], [0.0, 2.0]])
    limits = {"comm_radius": 20.0, "collision_radius": 0.5, "max_control": 0.2}
    mission = sato.Reconfiguration(
        model=sato.DoubleIntegrator(2), start=start, legs=[sato.Leg(start + 6.0, 30)],
        step=1.0, max_speed=1.0, **limits, **more,
    )  # fmt: skip
    with pytest.raises(sato.InputError, match=f"{next(iter(more))}: is no part of the joint"):
        sato.central_problem(mission)


def test_fuel_without_derivatives_is_refused(rng):
    with pytest.raises(ValueError, match="fuel_norm must be 1 or inf in the joint program, got 2"):
        sato.central_problem(mission(MODELS[0], rng, fuel_norm=2))


QUIET = {"ipopt": {"print_level": 0, "sb": "yes"}, "print_time": False}


def solve(central):
    program = central.problem.nonlinear_program(central.start, central.goal)
    solver = casadi.nlpsol("central", "ipopt", program.problem, QUIET)
    guess = program.trajectories(solver(**program.arguments)["x"])
    return central.problem.solve(central.start, central.goal, [guess]).best


def drawn_limits(rng, count, axes):
    """Random limits of the vehicles: in any norm, each its own, or each axis its own."""
    kind = int(rng.integers(3))
    own = {"max_control": 0.3 * rng.uniform(1, 2, count), "max_speed": rng.uniform(0.8, 1.6, count)}
    if kind == 1:
        own = {"max_control_axes": 0.3 * rng.uniform(1, 2, axes), "control_norm": "inf"}
        own |= {"max_speed_axes": rng.uniform(0.8, 1.6, axes), "speed_norm": "inf"}
    else:
        own |= {f"{key}_norm": [1, 2, "inf"][rng.integers(3)] for key in ("control", "speed")}
    return {k: list(v) if isinstance(v, np.ndarray) else v for k, v in own.items()}


def measured(limit, v):
    """Largest vector over its limit, by NumPy alone."""
    bound, order = np.asarray(limit.bound), {"inf": np.inf}.get(limit.norm, limit.norm)
    if bound.ndim:
        return float((np.abs(v) / bound).max())
    return float(np.linalg.norm(v, order, axis=-1).max() / bound)


@pytest.mark.parametrize("case", range(6))
def test_unequal_vehicles_keep_their_own_limits_and_distances(case):
    rng = np.random.default_rng(case)
    axes, count = 2 + case % 2, 3
    radii, start = rng.uniform(0.3, 0.9, count), 1.5 * rng.permutation(np.eye(3))[:, :axes]
    start += rng.uniform(-0.1, 0.1, start.shape)
    fuel = ["energy", 1, "inf"][case % 3]
    costs = {"objective": "energy"} if fuel == "energy" else {"fuel_norm": fuel}
    drawn = sato.Reconfiguration(
        model=sato.DoubleIntegrator(axes), start=start, step=1.0, comm_radius=100.0,
        legs=[sato.Leg(-start[::-1], steps=12)], assignment="given",
        collision_radius=radii.tolist(), **drawn_limits(rng, count, axes), **costs,
    ).draw(rng)  # fmt: skip
    central = sato.central_problem(drawn)
    best = solve(central)
    assert_allclose(best.x[:, -1], central.goal, atol=1e-6)
    time = np.linspace(0, 1, 41)[:, None]
    for i in range(count):
        assert measured(drawn.control_limit(i), best.u[i]) <= 1 + 1e-6
        assert measured(drawn.speed_limit(i), best.x[i, 1:-1, axes:]) <= 1 + 1e-6
        for j in range(i):
            gap, u = best.x[i] - best.x[j], (best.u[i] - best.u[j])[:, None]
            between = gap[:-1, None, :axes] + time * gap[:-1, None, axes:] + time**2 / 2 * u
            least = np.linalg.norm(between, axis=-1).min()
            assert least >= (radii[i] + radii[j]) / 2 * (1 - 1e-6)
    order = {"inf": np.inf}.get(fuel, fuel)
    cost = (best.u**2).sum() if fuel == "energy" else np.linalg.norm(best.u, order, axis=2).sum()
    assert best.cost == pytest.approx(cost, rel=1e-9)
    model, objective = central.problem.transfer.model, drawn.objective
    for i, ends in enumerate(zip(central.start, central.goal, strict=True)):
        own = drawn.make_transfer(model, i, objective=objective)
        cost -= own.cost(own.solve(*ends))
    assert cost >= -1e-6 * best.cost  # no less than each alone


@pytest.mark.parametrize("objective", ["fuel", "energy"])
def test_lists_of_equal_vehicles_state_the_program_of_one_number(objective, rng):
    one = mission(MODELS[0], rng, 3, 3, objective=objective, assignment="given")
    each = {"max_control": [0.3] * 3, "max_speed": [1.0] * 3, "collision_radius": [0.5] * 3}
    (first, second) = map(sato.central_problem, (one, replace(one, **each)))
    assert solve(second).cost == pytest.approx(solve(first).cost, rel=1e-9)
    split = replace(first.problem, own_transfers=(first.problem.transfer,) * 3,
                    clearances=np.full(3, first.problem.horizon.clearance))  # fmt: skip
    assert solve(first._replace(problem=split)).cost == pytest.approx(solve(first).cost, rel=1e-6)


@pytest.mark.parametrize("other", ["crossing", {"system": "reconfiguration"}, None])
def test_only_reconfigurations_have_a_centralized_problem(other):
    with pytest.raises(sato.InputError, match="mission: must be a Reconfiguration, got"):
        sato.central_problem(other)
