"""Models about a circular orbit, against laws and published solutions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from orbit_examples import transition_matrix

from dynamics import discretize_zoh
from dynamics.circular_orbit import ClohessyWiltshire, SchweighartSedwick
from dynamics.orbit import Orbit

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


def test_steps_are_the_published_solution_of_clohessy_and_wiltshire():
    """Compare every entry [Clohessy1960]."""
    n, t = 1.1e-3, 1440.0
    c, s, a = np.cos(n * t), np.sin(n * t), n * t
    Phi = [
        [4 - 3 * c, 0, 0, s / n, 2 * (1 - c) / n, 0],
        [6 * (s - a), 1, 0, -2 * (1 - c) / n, (4 * s - 3 * a) / n, 0],
        [0, 0, c, 0, 0, s / n],
        [3 * n * s, 0, 0, c, 2 * s, 0],
        [-6 * n * (1 - c), 0, 0, -2 * s, 4 * c - 3, 0],
        [0, 0, -n * s, 0, 0, c],
    ]
    Gamma = [
        [(1 - c) / n**2, 2 * (a - s) / n**2, 0],
        [-2 * (a - s) / n**2, 4 * (1 - c) / n**2 - 1.5 * t**2, 0],
        [0, 0, (1 - c) / n**2],
        [s / n, 2 * (1 - c) / n, 0],
        [-2 * (1 - c) / n, 4 * s / n - 3 * t, 0],
        [0, 0, s / n],
    ]
    step = discretize_zoh(ClohessyWiltshire(n), t, 1)
    assert_allclose(step.A[0], Phi, rtol=1e-11, atol=0)
    assert_allclose(step.B[0], Gamma, rtol=1e-11, atol=0)


def test_mean_motion_is_that_of_the_orbit():
    orbit = Orbit.from_elements(6878e3, inclination=0.8, true_anomaly=1.0)
    n = np.sqrt(3.986004418e14 / 6878e3**3)
    assert ClohessyWiltshire.from_orbit(orbit).n == pytest.approx(n, rel=1e-13)
    eccentric = Orbit.from_elements(8600e3, 0.2, true_anomaly=2.0)
    assert eccentric.period * ClohessyWiltshire.from_orbit(eccentric).n == pytest.approx(2 * np.pi)


@pytest.mark.parametrize("bad", [0.0, -1e-3, np.nan, np.inf])
def test_a_mean_motion_that_is_not_positive_is_refused(bad):
    with pytest.raises(ValueError, match=r"^n: .*must be"):
        ClohessyWiltshire(bad)
