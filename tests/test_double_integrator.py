"""Double integrator, against its closed form."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from dynamics import DoubleIntegrator, discretize_zoh


@pytest.mark.parametrize("axes", [2, 3])
def test_constant_acceleration_gives_a_parabola(rng, axes):
    x, u = rng.normal(size=2 * axes), rng.normal(size=axes)
    path = discretize_zoh(DoubleIntegrator(axes), 0.7, 20).simulate(x, np.tile(u, (20, 1)))
    time = 0.7 * np.arange(21)[:, None]
    expected = x[:axes] + time * x[axes:] + time**2 / 2 * u
    assert_allclose(path[:, :axes], expected, atol=1e-12)
    assert_allclose(path[:, axes:], x[axes:] + time * u, atol=1e-12)


@pytest.mark.parametrize("axes", [0, 1, 4])
def test_dimensions_other_than_2_and_3_are_refused(axes):
    with pytest.raises(ValueError, match=f"2 or 3 axes, got {axes}"):
        DoubleIntegrator(axes)
