"""Models about a circular orbit, against laws and integration.

Errors of Φ are relative to its largest entry, with velocities in units of the rotation
rate times a meter.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from orbit_examples import transition_matrix
from scipy.integrate import solve_ivp

from dynamics import discretize_zoh
from dynamics.circular_orbit import ClohessyWiltshire, SchweighartSedwick

MODELS = [
    ClohessyWiltshire(1.1e-3),
    SchweighartSedwick(6878e3, np.radians(45)),
    SchweighartSedwick(7200e3, np.radians(98)),
]
models = pytest.mark.parametrize("model", MODELS, ids=["Clohessy", "Schweighart45", "98"])


def units(model):
    return np.repeat([1.0, model.rotation_rate], 3)


@models
def test_bounded_orbit_closes_after_one_period(model, rng):
    x = rng.uniform(-1500, 1500, (20, 6)) * units(model)
    x[:, 4] = model.bounded_velocity(x[:, :3])[:, 1]
    period = 2 * np.pi / model.in_plane_rate
    end = x @ transition_matrix(model, period).T
    assert_allclose(end[:, [0, 1, 3, 4]], x[:, [0, 1, 3, 4]], atol=1e-8)
    half = x @ transition_matrix(model, period / 2).T
    assert np.abs(half - x)[:, :2].max() > 1000  # the orbit is not a point


@models
def test_centered_orbit_is_opposite_after_half_a_period(model, rng):
    position = rng.uniform(-1500, 1500, (20, 3))
    x = np.hstack([position, model.centered_velocity(position)])
    half = x @ transition_matrix(model, np.pi / model.in_plane_rate).T
    assert_allclose(half[:, [0, 1, 3, 4]], -x[:, [0, 1, 3, 4]], atol=1e-8)


@models
def test_other_orbits_drift_by_the_stated_amount(model, rng):
    x = rng.uniform(-1000, 1000, 6) * units(model)
    period = 2 * np.pi / model.in_plane_rate
    D = x[4] + 2 * model.rotation_rate * x[0]
    moved = (transition_matrix(model, period) @ x - x)[[0, 1, 3, 4]]
    drift = -model.radial_gradient / model.in_plane_rate**2 * D * period
    assert_allclose(moved, [0, drift, 0, 0], atol=1e-7)


@models
def test_a_discrete_step_solves_the_equations_of_motion(model):
    """Compare Φ and the control matrix of a step with DOP853 over three periods."""
    unit, end = units(model), 6 * np.pi / model.rotation_rate
    A = model.A(0.0) * unit / unit[:, None]
    B = model.B(0.0) / unit[:, None]

    def rate(t, y):
        y = y.reshape(6, 9)
        return (A @ y + np.hstack([np.zeros((6, 6)), B])).ravel()

    start = np.eye(6, 9).ravel()
    y = solve_ivp(rate, (0, end), start, method="DOP853", rtol=1e-13, atol=1e-13).y[:, -1]
    Phi, Gamma = np.split(y.reshape(6, 9), [6], axis=1)
    found = transition_matrix(model, end) * unit / unit[:, None]
    assert_allclose(found, Phi, rtol=0, atol=1e-11 * np.abs(Phi).max())
    error = np.abs(discretize_zoh(model, end, 1).B[0] / unit[:, None] - Gamma).max()
    assert error <= 1e-9 * np.abs(Gamma).max()
