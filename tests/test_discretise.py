"""Holding the input over a step: laws, an integrator, and an integral."""

from dataclasses import dataclass

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad_vec, solve_ivp
from scipy.linalg import expm

from dynamics import (
    ClohessyWiltshire,
    DiscreteModel,
    DoubleIntegrator,
    LinearModel,
    SymbolicModel,
    discretize_zoh,
)
from dynamics.discretize import linearize_along

short = st.floats(1e-3, 200)


@dataclass(frozen=True)
class Swinging(LinearModel):
    """An oscillator whose stiffness and wind change in time."""

    axes: int = 2

    def A(self, t):
        """Stiffness that comes and goes."""
        A = np.zeros((4, 4))
        A[:2, 2:] = np.eye(2)
        A[2:, :2] = -(1 + 0.5 * np.sin(t)) * np.array([[1.0, 0.2], [0.2, 2.0]])
        return A

    def z(self, t):
        """Wind."""
        return np.array([0, 0, 0.1 * np.cos(t), 0.2])


def random_steps(rng, count, axes=2):
    n = 2 * axes
    shapes = (count, n, n), (count, n, axes), (count, n)
    return DiscreteModel(*(rng.normal(size=shape) / n for shape in shapes), 1.0)


@given(short)
def test_two_half_steps_make_a_step(dt):
    model = ClohessyWiltshire(1.1e-3)
    whole, half = discretize_zoh(model, dt, 1), discretize_zoh(model, dt / 2, 1)
    A, B = half.A[0], half.B[0]
    np.testing.assert_allclose(A @ A, whole.A[0], rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(A @ B + B, whole.B[0], rtol=1e-12, atol=1e-12)


@given(short)
def test_a_step_back_undoes_a_step(dt):
    A = discretize_zoh(ClohessyWiltshire(1.1e-3), dt, 1).A[0]
    back = expm(-dt * ClohessyWiltshire(1.1e-3).A(0.0))
    np.testing.assert_allclose(back @ A, np.eye(6), atol=1e-12)


@given(short)
def test_volume_in_phase_space_is_conserved(dt):
    for model in (DoubleIntegrator(3), ClohessyWiltshire(1.1e-3)):
        assert np.linalg.det(discretize_zoh(model, dt, 1).A[0]) == pytest.approx(1, rel=1e-9)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.sampled_from([(), (1,), (5,), (2, 3)]))
def test_the_roll_of_many_is_the_roll_of_each(seed, count, many):
    rng = np.random.default_rng(seed)
    steps = random_steps(rng, count)
    x, u = rng.normal(size=(*many, 4)), rng.normal(size=(*many, count, 2))
    together = steps.simulate(x, u)
    assert together.shape == (*many, count + 1, 4)
    for index in np.ndindex(many):
        np.testing.assert_allclose(together[index], steps.simulate(x[index], u[index]), atol=1e-13)


def test_the_roll_is_affine_in_state_and_input(rng):
    steps = random_steps(rng, 6)
    x, u = rng.normal(size=(2, 4)), rng.normal(size=(2, 6, 2))
    mixed = steps.simulate(0.3 * x[0] + 0.7 * x[1], 0.3 * u[0] + 0.7 * u[1])
    each = steps.simulate(x, u)
    np.testing.assert_allclose(mixed, 0.3 * each[0] + 0.7 * each[1], atol=1e-13)


def test_a_window_of_steps_goes_on_where_the_steps_before_it_ended(rng):
    steps = random_steps(rng, 7)
    x, u = rng.normal(size=4), rng.normal(size=(7, 2))
    path = steps.simulate(x, u)
    np.testing.assert_allclose(steps[3:].simulate(path[3], u[3:]), path[3:], atol=1e-13)
    assert (len(steps[3:]), steps.axes, steps[3:].dt) == (4, 2, steps.dt)


def test_fewer_inputs_than_steps_roll_as_far_as_they_go(rng):
    steps = random_steps(rng, 7)
    x, u = rng.normal(size=4), rng.normal(size=(7, 2))
    np.testing.assert_array_equal(steps.simulate(x, u[:4]), steps.simulate(x, u)[:5])


def test_a_constant_model_has_the_same_matrices_whenever_it_begins():
    early, late = (
        discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 3, start) for start in (0.0, 1e4)
    )
    np.testing.assert_array_equal(early.A, late.A)
    np.testing.assert_array_equal(early.B[0], late.B[2])


def test_a_changing_model_discretised_in_one_go_or_in_two_is_the_same():
    whole, rest = (
        discretize_zoh(Swinging(), 0.1, 9, t0=1.0),
        discretize_zoh(Swinging(), 0.1, 4, t0=1.5),
    )
    np.testing.assert_allclose(whole.A[5:], rest.A, atol=1e-14)
    np.testing.assert_allclose(whole.z[5:], rest.z, atol=1e-14)


def test_no_steps_are_no_steps():
    none = discretize_zoh(DoubleIntegrator(2), 1.0, 0)
    assert len(none) == 0
    assert none.B.shape == (0, 4, 2)
    path = none.simulate(np.arange(4.0), np.zeros((0, 2)))
    np.testing.assert_array_equal(path, [[0.0, 1.0, 2.0, 3.0]])


@given(short, st.sampled_from([DoubleIntegrator(2), ClohessyWiltshire(1.1e-3)]))
def test_van_loan_agrees_with_the_integral_of_the_exponential(dt, model):
    steps = discretize_zoh(model, dt, 1)
    A, B = model.A(0.0), model.B(0.0)
    np.testing.assert_allclose(steps.A[0], expm(A * dt), rtol=1e-12, atol=1e-12)
    integral, _ = quad_vec(lambda s: expm(A * s) @ B, 0, dt, epsabs=1e-12, epsrel=1e-12)
    np.testing.assert_allclose(steps.B[0], integral, rtol=1e-10, atol=1e-12)


def flown(model, x, u, dt):
    for k, push in enumerate(u):
        span = (k * dt, (k + 1) * dt)
        rate = lambda t, x, push=push: model.rate(t, x, push)  # noqa: E731
        x = solve_ivp(rate, span, x, rtol=1e-11, atol=1e-12).y[:, -1]
    return x


def test_a_constant_model_is_held_exactly(rng):
    model = ClohessyWiltshire(1.1e-3)
    x, u = rng.normal(0, [300] * 3 + [0.5] * 3), rng.normal(0, 1e-3, (4, 3))
    path = discretize_zoh(model, 90.0, 4).simulate(x, u)
    np.testing.assert_allclose(path[-1], flown(model, x, u, 90.0), rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize("parts", [1, 5])
def test_a_changing_model_is_held_exactly(parts):
    x, u, model = np.array([1.0, -0.5, 0.2, 0.0]), np.array([[0.3, -0.2]]), Swinging()
    truth = flown(model, x, np.tile(u, (4, 1)), 0.5)
    end = discretize_zoh(model, 0.5 / parts, 4 * parts).simulate(x, np.tile(u, (4 * parts, 1)))[-1]
    np.testing.assert_allclose(end, truth, rtol=0, atol=1e-9)


def swing(t, x, u):
    return casadi.vertcat(x[1], -casadi.sin(x[0]) * (2 + casadi.sin(t)) + u[0])


def test_steps_about_a_path_are_those_of_each_agent(rng):
    model, u = SymbolicModel(1, swing), rng.normal(size=(3, 4, 1))
    x = rng.normal(size=(3, 5, 2))
    together = linearize_along(model, x, u, 0.3, t0=0.7)
    assert len(together) == 4
    for i in range(3):
        alone, own = linearize_along(model, x[i], u[i], 0.3, t0=0.7), together.for_agent(i)
        np.testing.assert_allclose(own.A, alone.A, rtol=0, atol=1e-9)
        np.testing.assert_allclose(own.z, alone.z, rtol=0, atol=1e-9)


def test_steps_about_a_path_have_the_slopes_of_the_motion(rng):
    model, u = SymbolicModel(1, swing), np.array([[0.4]])
    x, h = np.array([[0.8, -0.3], [0.0, 0.0]]), 1e-5
    steps = linearize_along(model, x, u, 0.5)

    def end(state, push):
        rate = lambda t, y: model.rate(t, y, push)  # noqa: E731
        return solve_ivp(rate, (0, 0.5), state, "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]

    for i, e in enumerate(np.eye(2)):
        slope = (end(x[0] + h * e, u[0]) - end(x[0] - h * e, u[0])) / (2 * h)
        np.testing.assert_allclose(steps.A[0, :, i], slope, atol=1e-8)
    slope = (end(x[0], u[0] + h) - end(x[0], u[0] - h)) / (2 * h)
    np.testing.assert_allclose(steps.B[0, :, 0], slope, atol=1e-8)
    np.testing.assert_allclose(steps.simulate(x[0], u)[-1], end(x[0], u[0]), atol=1e-10)


@pytest.mark.parametrize(
    ("dt", "count"), [(0.0, 3), (-1.0, 3), (np.nan, 3), (np.inf, 3), (1.0, -1)]
)
def test_a_step_takes_time(dt, count):
    with pytest.raises(ValueError, match="a step must be positive"):
        discretize_zoh(DoubleIntegrator(2), dt, count)
