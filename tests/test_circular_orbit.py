"""Closed forms about a circular orbit, against laws, exponentials and integration.

Errors of Φ are relative to its largest entry, with velocities in units of the rotation
rate times a meter.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from dynamics import discretize_zoh
from dynamics.clohessy_wiltshire import ClohessyWiltshire
from dynamics.schweighart_sedwick import SchweighartSedwick

MODELS = [
    ClohessyWiltshire(1.1e-3),
    SchweighartSedwick(6878e3, np.radians(45)),
    SchweighartSedwick(7200e3, np.radians(98)),
]
models = pytest.mark.parametrize("model", MODELS, ids=["Clohessy", "Schweighart45", "98"])
times = st.floats(-2e4, 2e4)
any_model = st.sampled_from(MODELS)


def units(model):
    return np.repeat([1.0, model.rotation_rate], 3)


def scaled(model, Phi):
    return Phi * units(model) / units(model)[:, None]


def assert_same(model, Phi, other, rtol):
    a, b = scaled(model, Phi), scaled(model, other)
    assert_allclose(a, b, rtol=0, atol=rtol * np.abs(b).max())


@models
def test_transitions_over_many_times_are_each_its_own(model, rng):
    t = rng.uniform(0, 6e3, (2, 3))
    Phi = model.transition_matrix(t)
    assert Phi.shape == (2, 3, 6, 6)
    assert_array_equal(Phi[1, 2], model.transition_matrix(t[1, 2]))


@models
def test_bounded_orbit_closes_after_one_period(model, rng):
    x = rng.uniform(-1500, 1500, (20, 6)) * units(model)
    x[:, 4] = model.bounded_velocity(x[:, :3])[:, 1]
    period = 2 * np.pi / model.in_plane_rate
    end = x @ model.transition_matrix(period).T
    assert_allclose(end[:, [0, 1, 3, 4]], x[:, [0, 1, 3, 4]], atol=1e-8)
    half = x @ model.transition_matrix(period / 2).T
    assert np.abs(half - x)[:, :2].max() > 1000  # the orbit is not a point


@models
def test_centered_orbit_is_opposite_after_half_a_period(model, rng):
    position = rng.uniform(-1500, 1500, (20, 3))
    x = np.hstack([position, model.centered_velocity(position)])
    half = x @ model.transition_matrix(np.pi / model.in_plane_rate).T
    assert_allclose(half[:, [0, 1, 3, 4]], -x[:, [0, 1, 3, 4]], atol=1e-8)


@models
def test_other_orbits_drift_by_the_stated_amount(model, rng):
    x = rng.uniform(-1000, 1000, 6) * units(model)
    period = 2 * np.pi / model.in_plane_rate
    D = x[4] + 2 * model.rotation_rate * x[0]
    moved = (model.transition_matrix(period) @ x - x)[[0, 1, 3, 4]]
    drift = -model.radial_gradient / model.in_plane_rate**2 * D * period
    assert_allclose(moved, [0, drift, 0, 0], atol=1e-7)


@models
@pytest.mark.parametrize("t", [1e-3, 1.0, 60.0, 450.0, 460.0, 1440.0])
def test_a_discrete_step_is_the_closed_form_in_every_entry(model, t):
    closed, found = model.transition_matrix(t), discretize_zoh(model, t, 1).A[0]
    assert_array_equal(closed != 0, found != 0)
    assert_allclose(closed, found, rtol=1e-10, atol=0)


@given(any_model, times)
def test_the_closed_form_is_the_matrix_exponential(model, t):
    # The exponential, computed by squaring, is the less accurate of the two.
    assert_same(model, model.transition_matrix(t), expm(model.A(0.0) * t), 1e-11)


@models
def test_the_closed_form_solves_the_equations_of_motion(model):
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
    assert_same(model, model.transition_matrix(end), Phi * unit[:, None] / unit, 1e-11)
    error = np.abs(discretize_zoh(model, end, 1).B[0] / unit[:, None] - Gamma).max()
    assert error <= 1e-9 * np.abs(Gamma).max()
