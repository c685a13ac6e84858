"""The programme of the whole swarm as it is written: instants, derivatives, bounds."""

import casadi
import numpy as np
import pytest
from swarm_cast import RADIUS, STEP, T
from test_central import CROSSING, by_themselves, question

from dynamics.path import at
from problems.central_programme import Instants, differences, optimise, write


def drawn(rng, axes=2, **norms):
    central = question(axes, **norms)
    x, u = rng.normal(size=(3, T + 1, 2 * axes)), rng.uniform(-0.2, 0.2, (3, T, axes))
    pair, piece = np.array([[0, 1], [2, 0], [1, 2], [0, 1]]), np.array([0, 5, 23, 11])
    keep = np.array([1.0, 1.25, 1.0, 1.5])
    return central, x, u, Instants(pair, piece, np.array([0.3, 0.0, 1.0, 0.71]), keep)


def test_instants_move_over_the_pieces_and_stay_among_them(rng):
    instants = drawn(rng)[-1]
    later, earlier = instants.moved(0.9, 23), instants.moved(-6.0, 23)
    np.testing.assert_allclose(later.time, [1.2, 5.9, 24.0, 12.61])
    np.testing.assert_allclose(earlier.time, [0.0, 0.0, 18.0, 5.71])
    for moved in (later, earlier):
        assert (moved.piece >= 0).all() and (moved.piece <= 23).all()
        assert (moved.fraction >= 0).all() and (moved.fraction <= 1).all()


def test_only_the_same_pair_about_the_same_time_is_kept_further_apart(rng):
    instants = drawn(rng)[-1]
    pair = np.array([[0, 1], [0, 1]])
    others = Instants(pair, np.array([0, 1]), np.array([0.9, 0.1]), np.ones(2))
    raised = instants.further(others, np.array([0.01, 0.02]), 2.0)
    np.testing.assert_allclose(raised.keep - instants.keep, [0.02, 0.0, 0.0, 0.0])


@pytest.mark.parametrize("axes", [2, 3])
def test_differences_of_places_are_those_of_the_paths(rng, axes):
    central, x, u, instants = drawn(rng, axes)
    path = central.horizon.path(x, u)
    own, other = (path[instants.pair[:, side], instants.piece] for side in (0, 1))
    expected = at(own - other, instants.fraction) / RADIUS
    Dx, Du = differences(central.horizon, central.unit, 0.2, 3, instants)
    found = Dx @ (x / central.unit).ravel() + Du @ (u / 0.2).ravel()
    np.testing.assert_allclose(found.reshape(expected.shape), expected, atol=1e-12)


@pytest.mark.parametrize(("fuel_norm", "control_norm"), [(1, "inf"), (2, 2), (1, 1)])
def test_derivatives_are_those_of_finite_differences_and_sparse(rng, fuel_norm, control_norm):
    central, _, _, instants = drawn(rng, fuel_norm=fuel_norm, control_norm=control_norm)
    by = rng.uniform(-0.5, 0.5, (3, T, 2))
    programme = write(central.transfer, central.horizon, 3, instants, by)
    z, f, g = programme.unknown, programme.cost, programme.kept
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
    np.testing.assert_allclose(
        np.asarray(J @ along).ravel(), central_difference(values), rtol=1e-6, atol=1e-6
    )
    np.testing.assert_allclose(
        np.asarray(H @ along).ravel(), central_difference(slopes, w), rtol=1e-5, atol=1e-5
    )
    assert J.nnz() < 20 * J.shape[0] + z.numel()
    assert H.nnz() <= 3 * z.numel()


def test_the_programme_holds_the_motion_and_its_bounds(rng):
    # Flown states satisfy every equation; rows of distance are their squares.
    central, _, u, instants = drawn(rng, control_norm=2)
    start = rng.normal(size=(3, 4))
    x = central.transfer.steps.roll(start, u)
    programme = write(central.transfer, central.horizon, 3, instants)
    xs, us = x / central.unit, u / 0.2
    Dx, Du = differences(central.horizon, central.unit, 0.2, 3, instants)
    apart = Dx @ xs.ravel() + Du @ us.ravel()
    parts = xs, np.maximum(us, 0), np.maximum(-us, 0), apart
    z = np.concatenate([part.ravel() for part in parts])
    kept = np.asarray(casadi.Function("g", [programme.unknown], [programme.kept])(z)).ravel()
    equations = programme.least == programme.most
    assert equations.sum() == 3 * T * 4 + len(apart)
    np.testing.assert_allclose(kept[equations], programme.least[equations], atol=1e-12)
    np.testing.assert_allclose(kept[-4:], (apart.reshape(4, 2) ** 2).sum(axis=1))
    assert (programme.least[-4:] == instants.keep**2).all() and np.isinf(programme.most[-4:]).all()
    speeds = (np.linalg.norm(x[:, 1:-1, 2:], axis=-1) * STEP / RADIUS).ravel() ** 2
    np.testing.assert_allclose(kept[3 * T * 4 :][: len(speeds)], speeds, atol=1e-12)
    assert (programme.most[3 * T * 4 :][: len(speeds)] == (0.6 / RADIUS) ** 2).all()
    thrusts = (us**2).sum(axis=-1).ravel()
    after = 3 * T * 4 + len(speeds)
    np.testing.assert_allclose(kept[after : after + len(thrusts)], thrusts, atol=1e-12)


def test_the_solver_is_not_believed_but_what_it_says_is_kept():
    central = question()
    start, goal = CROSSING
    free = by_themselves(central, start, goal)
    nowhere = Instants(
        np.zeros((0, 2), dtype=int), np.zeros(0, dtype=int), np.zeros(0), np.zeros(0)
    )
    _, u, said = optimise(central.transfer, central.horizon, (start, goal), free, nowhere)
    assert "Solve_Succeeded" in said  # of a programme that forgot to keep them apart
    assert not central.fly(start, goal, u, said).stands
