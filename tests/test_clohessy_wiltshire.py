"""Clohessy–Wiltshire: closed orbits, drift, invariants and two-body motion."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.integrate import solve_ivp

from dynamics import ClohessyWiltshire, discretize_zoh
from dynamics.orbit import Orbit

n = np.sqrt(3.986004418e14 / 6878e3**3)  # circular orbit of 6878 km
model = ClohessyWiltshire(float(n))
period = 2 * np.pi / n


def propagate_free(x, duration, count):
    return discretize_zoh(model, duration / count, count).simulate(
        x, np.zeros((*x.shape[:-1], count, 3))
    )


def test_equations_are_two_body_motion_to_first_order():
    """Compare with the difference of two orbits integrated in inertial space."""
    radius, mu = 6878e3, 3.986004418e14
    offset, velocity = np.array([30.0, -50.0, 40.0]), np.array([0.02, 0.05, -0.03])
    chief = np.array([radius, 0, 0, 0, n * radius, 0])
    spin = np.array([0, 0, n])
    deputy = chief.copy()
    deputy[:3] += offset
    deputy[3:] += velocity + np.cross(spin, offset)

    def fall(t, x):
        return np.concatenate([x[3:], -mu * x[:3] / np.linalg.norm(x[:3]) ** 3])

    time = period / 4
    precise = {"method": "DOP853", "rtol": 1e-13, "atol": 1e-7}
    ends = [solve_ivp(fall, (0, time), x, **precise).y[:, -1] for x in (chief, deputy)]
    turn = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # a quarter of a revolution
    truth = turn @ (ends[1] - ends[0])[:3]
    linear = propagate_free(np.concatenate([offset, velocity]), time, 10)[-1, :3]
    assert np.linalg.norm(truth) > 100
    assert_allclose(linear, truth, atol=0.01)  # separation² over radius: 6 mm


def test_transition_and_control_matrices_are_the_published_ones():
    """Compare every entry with the published solution [Clohessy1960]."""
    t = 1440.0
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
    step = discretize_zoh(model, t, 1)
    assert_allclose(step.A[0], Phi, rtol=1e-11, atol=0)
    assert_allclose(step.B[0], Gamma, rtol=1e-11, atol=0)


def test_mean_motion_is_that_of_the_orbit():
    orbit = Orbit.from_elements(6878e3, inclination=0.8, true_anomaly=1.0)
    assert ClohessyWiltshire.from_orbit(orbit).n == pytest.approx(n, rel=1e-13)
    eccentric = Orbit.from_elements(8600e3, 0.2, true_anomaly=2.0)
    assert eccentric.period * ClohessyWiltshire.from_orbit(eccentric).n == pytest.approx(2 * np.pi)


@pytest.mark.parametrize("bad", [0.0, -1e-3, np.nan, np.inf])
def test_a_mean_motion_that_is_not_positive_is_refused(bad):
    with pytest.raises(ValueError, match="n: the mean motion must be positive"):
        ClohessyWiltshire(bad)
