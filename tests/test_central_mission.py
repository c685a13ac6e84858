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


def test_other_norms_are_refused(rng):
    with pytest.raises(ValueError, match="has fuel_norm 1"):
        sato.central_problem(mission(MODELS[0], rng, fuel_norm=2))
