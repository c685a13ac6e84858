"""Nonlinear program of the swarm: instants, derivatives and bounds."""

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose
from planner_examples import RADIUS, STEP, T
from test_centralized import CROSSING, by_themselves, question

from dynamics.trajectory_geometry import evaluate_bezier
from problems.centralized_nlp import (
    SeparationConstraints,
    build_nlp,
    relative_position_maps,
    solve_nlp,
)


def drawn(rng, axes=2, **norms):
    central = question(axes, **norms)
    x, u = rng.normal(size=(3, T + 1, 2 * axes)), rng.uniform(-0.2, 0.2, (3, T, axes))
    pair, piece = np.array([[0, 1], [2, 0], [1, 2], [0, 1]]), np.array([0, 5, 23, 11])
    keep = np.array([1.0, 1.25, 1.0, 1.5])
    return central, x, u, SeparationConstraints(pair, piece, np.array([0.3, 0.0, 1.0, 0.71]), keep)


def test_shifted_instants_stay_within_the_pieces(rng):
    instants = drawn(rng)[-1]
    later, earlier = instants.shift(0.9, 23), instants.shift(-6.0, 23)
    assert_allclose(later.time, [1.2, 5.9, 24.0, 12.61])
    assert_allclose(earlier.time, [0.0, 0.0, 18.0, 5.71])
    for moved in (later, earlier):
        assert (moved.piece >= 0).all() and (moved.piece <= 23).all()
        assert (moved.fraction >= 0).all() and (moved.fraction <= 1).all()


def test_only_the_same_pair_near_the_same_time_gets_a_larger_distance(rng):
    instants = drawn(rng)[-1]
    pair = np.array([[0, 1], [0, 1]])
    others = SeparationConstraints(pair, np.array([0, 1]), np.array([0.9, 0.1]), np.ones(2))
    raised = instants.enlarge_distance(others, np.array([0.01, 0.02]), 2.0)
    assert_allclose(raised.min_distance - instants.min_distance, [0.02, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("axes", [2, 3])
def test_relative_positions_are_those_of_the_trajectories(rng, axes):
    central, x, u, instants = drawn(rng, axes)
    path = central.horizon.control_points(x, u)
    own, other = (path[instants.pair[:, side], instants.piece] for side in (0, 1))
    expected = evaluate_bezier(own - other, instants.fraction) / RADIUS
    Dx, Du = relative_position_maps(central.horizon, central.state_units, 0.2, 3, instants)
    found = Dx @ (x / central.state_units).ravel() + Du @ (u / 0.2).ravel()
    assert_allclose(found.reshape(expected.shape), expected, atol=1e-12)


@pytest.mark.parametrize(("fuel_norm", "control_norm"), [(1, "inf"), (2, 2), (1, 1)])
def test_derivatives_agree_with_finite_differences_and_are_sparse(rng, fuel_norm, control_norm):
    central, _, _, instants = drawn(rng, fuel_norm=fuel_norm, control_norm=control_norm)
    by = rng.uniform(-0.5, 0.5, (3, T, 2))
    program = build_nlp(central.transfer, central.horizon, 3, instants, by)
    z, f, g = program.variables, program.objective, program.constraints
    weight = casadi.MX.sym("weight", g.numel())
    slope = casadi.gradient(f + casadi.dot(weight, g), z)
    values = casadi.Function("values", [z], [casadi.vertcat(f, g)])
    first = casadi.Function("first", [z], [casadi.jacobian(casadi.vertcat(f, g), z)])
    second = casadi.Function("second", [z, weight], [casadi.jacobian(slope, z)])
    slopes = casadi.Function("slopes", [z, weight], [slope])
    at_z, w = rng.uniform(0.1, 0.9, z.numel()), rng.normal(size=g.numel())
    along, h = rng.normal(size=z.numel()), 1e-5

    def central_difference(function, *more):
        ahead, behind = function(at_z + h * along, *more), function(at_z - h * along, *more)
        return np.asarray(ahead - behind).ravel() / (2 * h)

    J, H = first(at_z), second(at_z, w)
    assert_allclose(np.asarray(J @ along).ravel(), central_difference(values), rtol=1e-6, atol=1e-6)
    assert_allclose(
        np.asarray(H @ along).ravel(), central_difference(slopes, w), rtol=1e-5, atol=1e-5
    )
    assert J.nnz() < 20 * J.shape[0] + z.numel()
    assert H.nnz() <= 3 * z.numel()


def test_simulated_states_satisfy_dynamics_and_bounds(rng):
    # Simulated states satisfy every equation; distances enter as squares.
    central, _, u, instants = drawn(rng, control_norm=2)
    start = rng.normal(size=(3, 4))
    x = central.transfer.model.simulate(start, u)
    program = build_nlp(central.transfer, central.horizon, 3, instants)
    xs, us = x / central.state_units, u / 0.2
    Dx, Du = relative_position_maps(central.horizon, central.state_units, 0.2, 3, instants)
    apart = Dx @ xs.ravel() + Du @ us.ravel()
    parts = xs, np.maximum(us, 0), np.maximum(-us, 0), apart
    z = np.concatenate([part.ravel() for part in parts])
    kept = np.asarray(casadi.Function("g", [program.variables], [program.constraints])(z)).ravel()
    equations = program.lower == program.upper
    assert equations.sum() == 3 * T * 4 + len(apart)
    assert_allclose(kept[equations], program.lower[equations], atol=1e-12)
    assert_allclose(kept[-4:], (apart.reshape(4, 2) ** 2).sum(axis=1))
    assert (program.lower[-4:] == instants.min_distance**2).all() and np.isinf(
        program.upper[-4:]
    ).all()
    speeds = (np.linalg.norm(x[:, 1:-1, 2:], axis=-1) * STEP / RADIUS).ravel() ** 2
    assert_allclose(kept[3 * T * 4 :][: len(speeds)], speeds, atol=1e-12)
    assert (program.upper[3 * T * 4 :][: len(speeds)] == (0.6 / RADIUS) ** 2).all()
    thrusts = (us**2).sum(axis=-1).ravel()
    after = 3 * T * 4 + len(speeds)
    assert_allclose(kept[after : after + len(thrusts)], thrusts, atol=1e-12)


def test_the_reported_status_does_not_decide_feasibility():
    central = question()
    start, goal = CROSSING
    free = by_themselves(central, start, goal)
    nowhere = SeparationConstraints(
        np.zeros((0, 2), dtype=int), np.zeros(0, dtype=int), np.zeros(0), np.zeros(0)
    )
    _, u, said = solve_nlp(central.transfer, central.horizon, (start, goal), free, nowhere)
    assert "Solve_Succeeded" in said  # of a program without separation constraints
    assert not central.simulate(start, goal, u, said).is_feasible
