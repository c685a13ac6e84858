"""Bounds of the least control: below it, and close."""

import numpy as np
import pytest

from dynamics import ClohessyWiltshire, DoubleIntegrator, discretize_zoh
from problems.minimum_fuel import solve_minimum_fuel
from problems.reach import bound_least_controls

MODELS = {"plane": (DoubleIntegrator(2), 1.0), "orbit": (ClohessyWiltshire(1.1e-3), 60.0)}


@pytest.mark.parametrize("count", [2, 3, 8, 40])
@pytest.mark.parametrize("name", MODELS)
def test_least_control_is_a_few_percent_above_its_bound_at_most(rng, name, count):
    model, h = MODELS[name]
    steps = discretize_zoh(model, h, count)
    b = rng.normal(size=(12, 2 * steps.axes)) * np.repeat([100.0, 1.0], steps.axes)
    b[0], b[1, 1:] = 0.0, 0.0
    bound = bound_least_controls(steps, b)
    assert bound[0] == 0.0
    for q in range(1, 12):
        for factor, is_reachable in ((1.05, True), (1 - 1e-6, False)):
            found = solve_minimum_fuel(steps, b[q : q + 1], factor * bound[q], np.ones(count))
            assert np.isfinite(found.fuel[0]) == is_reachable


def test_steps_too_few_for_every_state_give_no_bound():
    steps = discretize_zoh(DoubleIntegrator(2), 1.0, 1)
    assert (bound_least_controls(steps, np.ones((3, 4))) == 0).all()
