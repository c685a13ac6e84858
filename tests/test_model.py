"""Linear, symbolic and linearized models."""

import casadi
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from dynamics import DoubleIntegrator, LinearizedModel, LinearModel, SymbolicModel

GRAVITY = 9.81  # [m/s²]
angles = st.tuples(*[st.floats(-3, 3) for _ in range(6)])


def pendulums(t, x, u):
    """Return the rate of two pendulums of 1 m, one with drag in an increasing wind."""
    return casadi.vertcat(
        x[2:],
        -GRAVITY * casadi.sin(x[0]) + u[0] * casadi.cos(x[0]),
        -GRAVITY * casadi.sin(x[1]) - 0.1 * x[3] * x[3] + u[1] + 0.3 * t,
    )


pendulum = SymbolicModel(2, pendulums)


class Wind(LinearModel):
    """r̈ = u + w(t), with nothing but A and z written."""

    axes = 2

    def A(self, t):
        """State matrix."""
        return DoubleIntegrator(2).A(t)

    def z(self, t):
        """Affine term."""
        return np.array([0.0, 0.0, 0.5, -t])


@given(angles)
def test_jacobians_agree_with_finite_differences(values):
    x, u, h = np.array(values[:4]), np.array(values[4:]), 1e-6
    A, B = pendulum.jacobian(0.4, x, u)
    for i in range(4):
        e = h * np.eye(4)[i]
        change = pendulum.rate(0.4, x + e, u) - pendulum.rate(0.4, x - e, u)
        assert_allclose(A[:, i], change / (2 * h), atol=1e-7)
    for i in range(2):
        e = h * np.eye(2)[i]
        change = pendulum.rate(0.4, x, u + e) - pendulum.rate(0.4, x, u - e)
        assert_allclose(B[:, i], change / (2 * h), atol=1e-7)


def test_linearized_rate_has_an_error_of_second_order():
    linear, away = LinearizedModel(pendulum), np.array([0.3, 0.3, 1.0, 1.0])
    for t in (-5.0, 0.0, 3.0):
        still = t, np.zeros(4), np.zeros(2)
        assert_allclose(linear.rate(*still), pendulum.rate(*still), atol=1e-12)
    errors = [
        np.abs(linear.rate(0.0, h * away, np.zeros(2)) - pendulum.rate(0.0, h * away, np.zeros(2)))
        for h in (1e-2, 1e-3)
    ]
    assert 80 < errors[0].max() / errors[1].max() < 125


def test_a_linear_model_needs_only_axes_and_matrices():
    wind = Wind()
    x, u = np.array([1.0, 2, 3, 4]), np.array([0.25, 1.0])
    assert_array_equal(wind.rate(2.0, x, u), [3.0, 4.0, 0.75, -1.0])
    at_many_times = wind.rate(np.array([2.0, 3.0]), np.array([x, x]), u)
    assert_array_equal(at_many_times, [[3, 4, 0.75, -1], [3, 4, 0.75, -2]])
