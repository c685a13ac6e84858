"""Linear, symbolic and linearized models."""

import casadi
import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.integrate import solve_ivp

from dynamics import DoubleIntegrator, LinearizedModel, LinearModel, SymbolicModel, discretize_zoh

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


@given(angles, st.floats(-5, 5))
def test_the_linearized_rate_is_exact_at_the_nominal(values, t):
    x, u = np.array(values[:4]), np.array(values[4:])
    linear = LinearizedModel(pendulum, lambda t: (x, u))
    assert_allclose(linear.rate(t, x, u), pendulum.rate(t, x, u), atol=1e-12)


def test_the_linearized_rate_has_a_second_order_error(rng):
    x, u = rng.normal(size=4), rng.normal(size=2)
    away = rng.normal(size=4)
    linear = LinearizedModel(pendulum, lambda t: (x, u))
    errors = [
        np.abs(linear.rate(0.0, x + h * away, u) - pendulum.rate(0.0, x + h * away, u)).max()
        for h in (1e-2, 1e-3)
    ]
    assert 80 < errors[0] / errors[1] < 125


def test_a_linear_model_needs_only_axes_and_matrices():
    wind = Wind()
    x, u = np.array([1.0, 2, 3, 4]), np.array([0.25, 1.0])
    assert_array_equal(wind.rate(2.0, x, u), [3.0, 4.0, 0.75, -1.0])
    at_many_times = wind.rate(np.array([2.0, 3.0]), np.array([x, x]), u)
    assert_array_equal(at_many_times, [[3, 4, 0.75, -1], [3, 4, 0.75, -2]])


def test_a_linearized_pendulum_moves_as_the_true_one_near_the_nominal():
    start, control, dt, count = np.array([0.6, -0.3, 0.0, 0.2]), np.array([0.5, -0.4]), 0.02, 60
    exactly = {"rtol": 1e-11, "atol": 1e-12}

    def integrate(x, u):
        rate = lambda t, x: pendulum.rate(t, x, u)  # noqa: E731
        return solve_ivp(rate, (0, dt * count), x, dense_output=True, **exactly).sol

    nominal = integrate(start, control)
    steps = discretize_zoh(LinearizedModel(pendulum, lambda t: (nominal(t), control)), dt, count)
    # At the nominal the steps are exact but for its interpolation.
    held = np.tile(control, (count, 1))
    assert np.abs(steps.simulate(start, held)[-1] - nominal(dt * count)).max() < 1e-8
    # Near it the error of a difference is of second order in the distance.
    apart, more = np.array([1e-3, -2e-3, 1e-3, 0.0]), np.array([1e-3, 2e-3])
    truth = integrate(start + apart, control + more)(dt * count) - nominal(dt * count)
    linear = steps.simulate(start + apart, held + more)[-1] - steps.simulate(start, held)[-1]
    assert np.abs(truth).max() > 1e-3
    assert np.abs(linear - truth).max() < 1e-2 * np.abs(truth).max()
