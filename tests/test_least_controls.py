"""Bounds of the least control: below it, and close."""

import numpy as np
import pytest

from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from problems.auction_cost import solve_transfer
from problems.limit import Limit
from problems.minimum_fuel import solve_minimum_fuel
from problems.reach import bound_least_controls
from problems.transfer import TransferProblem

MODELS = {"plane": (DoubleIntegrator(2), 1.0), "orbit": (ClohessyWiltshire(1.1e-3), 60.0)}


@pytest.mark.parametrize("count", [2, 3, 8, 40])
@pytest.mark.parametrize("name", MODELS)
def test_least_control_is_a_few_percent_above_its_bound_at_most(rng, name, count):
    model, h = MODELS[name]
    steps = discretize_zoh(model, h, count)
    b = rng.normal(size=(12, 2 * steps.axes)) * np.repeat([100.0, 1.0], steps.axes)
    b[0], b[1, 1:] = 0.0, 0.0
    bound, _ = bound_least_controls(steps, b, Limit(1.0, "inf", steps.axes))
    assert bound[0] == 0.0
    for q in range(1, 12):
        for factor, is_reachable in ((1.05, True), (1 - 1e-6, False)):
            found = solve_minimum_fuel(steps, b[q : q + 1], factor * bound[q], np.ones(count))
            assert np.isfinite(found.fuel[0]) == is_reachable


def test_steps_too_few_for_every_state_give_no_bound():
    steps = discretize_zoh(DoubleIntegrator(2), 1.0, 1)
    lower, upper = bound_least_controls(steps, np.ones((3, 4)), Limit(1.0, 2, 2))
    assert (lower == 0).all() and (upper == np.inf).all()


@pytest.mark.parametrize("norm", [1, 2, "inf"])
def test_bounds_scale_with_displacements_of_any_size(rng, norm):
    steps, limit = discretize_zoh(DoubleIntegrator(2), 1.0, 20), Limit(1.0, norm, 2)
    b = rng.normal(size=(4, 4))
    bounds = np.array(bound_least_controls(steps, b, limit))
    for scale in (2.0**-80, 2.0**80):
        assert np.array_equal(bound_least_controls(steps, scale * b, limit), scale * bounds)


@pytest.mark.parametrize("norm", [1, 2, "inf"])
@pytest.mark.parametrize("name", MODELS)
def test_least_control_of_each_norm_lies_between_its_bounds(rng, name, norm):
    model, h = MODELS[name]
    steps = discretize_zoh(model, h, 20)
    d = steps.axes
    b = rng.normal(size=(4, 2 * d)) * np.repeat([100.0, 1.0], d)
    shares = 1.0 if norm != "inf" else np.array([1.0, 0.5, 0.8])[:d]
    lower, upper = bound_least_controls(steps, b, Limit(shares, norm, d))
    assert (lower <= upper).all()
    assert norm == 1 or (upper <= 1.05 * lower).all()
    for q in range(4):
        end = steps.coast_to_end(np.zeros((1, 2 * d)))[0] + b[q]
        found = []
        for size in (1.001 * upper[q], 0.999 * lower[q]):
            transfer = TransferProblem(steps, size * shares, fuel_norm=2, control_norm=norm)
            found.append(solve_transfer(transfer, np.zeros(2 * d), end) is not None)
        assert found == [True, False]
