"""Double integrator, against its closed form."""

import numpy as np
import pytest

from dynamics import DoubleIntegrator, discretize_zoh


@pytest.mark.parametrize("axes", [2, 3])
def test_free_motion_is_straight_and_uniform(rng, axes):
    x = rng.normal(size=2 * axes)
    path = discretize_zoh(DoubleIntegrator(axes), 0.7, 20).simulate(x, np.zeros((20, axes)))
    time = 0.7 * np.arange(21)[:, None]
    np.testing.assert_allclose(path[:, :axes], x[:axes] + time * x[axes:], atol=1e-13)
    np.testing.assert_array_equal(path[:, axes:], np.tile(x[axes:], (21, 1)))


@pytest.mark.parametrize("axes", [2, 3])
def test_constant_acceleration_gives_a_parabola(rng, axes):
    x, u = rng.normal(size=2 * axes), rng.normal(size=axes)
    path = discretize_zoh(DoubleIntegrator(axes), 0.7, 20).simulate(x, np.tile(u, (20, 1)))
    time = 0.7 * np.arange(21)[:, None]
    expected = x[:axes] + time * x[axes:] + time**2 / 2 * u
    np.testing.assert_allclose(path[:, :axes], expected, atol=1e-12)
    np.testing.assert_allclose(path[:, axes:], x[axes:] + time * u, atol=1e-12)


def test_the_rate_is_velocity_and_acceleration():
    rate = DoubleIntegrator(2).rate(0.0, np.array([1.0, 2, 3, 4]), np.array([5.0, 6]))
    np.testing.assert_array_equal(rate, [3, 4, 5, 6])


@pytest.mark.parametrize("axes", [0, 1, 4])
def test_dimensions_other_than_2_and_3_are_refused(axes):
    with pytest.raises(ValueError, match=f"2 or 3 axes, got {axes}"):
        DoubleIntegrator(axes)
