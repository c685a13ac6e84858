"""Discretization with a zero-order hold, against integration and the matrix exponential."""

from dataclasses import dataclass, field

import casadi
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
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
from dynamics.discretize import _discretize_time_varying, linearize_along

durations = st.floats(1e-3, 200)


@dataclass(frozen=True)
class Swinging(LinearModel):
    """Oscillator with time-varying stiffness and wind."""

    axes: int = 2

    def A(self, t):
        """State matrix."""
        A = np.zeros((4, 4))
        A[:2, 2:] = np.eye(2)
        A[2:, :2] = -(1 + 0.5 * np.sin(t)) * np.array([[1.0, 0.2], [0.2, 2.0]])
        return A

    def z(self, t):
        """Affine term."""
        return np.array([0, 0, 0.1 * np.cos(t), 0.2])


def random_steps(rng, count, axes=2):
    n = 2 * axes
    shapes = (count, n, n), (count, n, axes), (count, n)
    return DiscreteModel(*(rng.normal(size=shape) / n for shape in shapes), 1.0)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.sampled_from([(), (1,), (5,), (2, 3)]))
def test_simulation_of_many_agents_is_that_of_each(seed, count, many):
    rng = np.random.default_rng(seed)
    steps = random_steps(rng, count)
    x, u = rng.normal(size=(*many, 4)), rng.normal(size=(*many, count, 2))
    together = steps.simulate(x, u)
    assert together.shape == (*many, count + 1, 4)
    for index in np.ndindex(many):
        assert_allclose(together[index], steps.simulate(x[index], u[index]), atol=1e-13)


def test_a_slice_of_steps_continues_the_trajectory(rng):
    steps = random_steps(rng, 7)
    x, u = rng.normal(size=4), rng.normal(size=(7, 2))
    path = steps.simulate(x, u)
    assert_allclose(steps[3:].simulate(path[3], u[3:]), path[3:], atol=1e-13)
    assert (len(steps[3:]), steps.axes, steps[3:].dt) == (4, 2, steps.dt)


def test_steps_of_each_agent_are_sliced_in_time_and_simulated(rng):
    shared = [random_steps(rng, 4) for _ in range(4)]
    own = DiscreteModel(*(np.stack([getattr(s, k) for s in shared]) for k in "ABz"), 1.0)
    x, u = rng.normal(size=(4, 4)), rng.normal(size=(4, 4, 2))
    later = own[1:]
    assert len(later) == 3
    for i in range(4):
        expected = shared[i][1:].simulate(x[i], u[i, 1:])
        assert_array_equal(later.for_agent(i).simulate(x[i], u[i, 1:]), expected)
    together = later.simulate(x, u[:, 1:])
    assert_allclose(together, [later.for_agent(i).simulate(x[i], u[i, 1:]) for i in range(4)])


def test_a_time_invariant_model_has_the_same_steps_at_all_times():
    early, late = (
        discretize_zoh(ClohessyWiltshire(1.1e-3), 60.0, 3, start) for start in (0.0, 1e4)
    )
    assert_array_equal(early.A, late.A)
    assert_array_equal(early.B[0], late.B[2])


def test_a_time_varying_model_has_the_same_steps_from_any_start():
    for first in (-17, -1, 0, 1, 10, 15, 16, 17, 31, 10.5):
        found = discretize_zoh(Swinging(), 0.1, 35, t0=first * 0.1)
        alone = [_discretize_time_varying(Swinging(), 0.1, 1, (first + k) * 0.1) for k in range(35)]
        for part in "ABz":
            expected = np.concatenate([getattr(one, part) for one in alone])
            assert_allclose(getattr(found, part), expected, atol=1e-12)


def test_no_steps_give_the_initial_state_alone():
    none = discretize_zoh(DoubleIntegrator(2), 1.0, 0)
    assert len(none) == 0
    assert none.B.shape == (0, 4, 2)
    path = none.simulate(np.arange(4.0), np.zeros((0, 2)))
    assert_array_equal(path, [[0.0, 1.0, 2.0, 3.0]])


@given(durations, st.sampled_from([DoubleIntegrator(2), ClohessyWiltshire(1.1e-3)]))
def test_steps_agree_with_the_integral_of_the_exponential(dt, model):
    steps = discretize_zoh(model, dt, 1)
    A, B = model.A(0.0), model.B(0.0)
    assert_allclose(steps.A[0], expm(A * dt), rtol=1e-12, atol=1e-12)
    integral, _ = quad_vec(lambda s: expm(A * s) @ B, 0, dt, epsabs=1e-12, epsrel=1e-12)
    assert_allclose(steps.B[0], integral, rtol=1e-10, atol=1e-12)


def unhashable_oscillator(frozen, constant):
    @dataclass(frozen=frozen)
    class Oscillator(LinearModel):
        stiffness: np.ndarray = field(default_factory=lambda: np.eye(2))
        is_time_invariant: bool = constant
        axes: int = 2

        def A(self, t):
            """State matrix."""
            return np.block([[np.zeros((2, 2)), np.eye(2)], [-self.stiffness, np.zeros((2, 2))]])

    return Oscillator()


@pytest.mark.parametrize("constant", [True, False])
@pytest.mark.parametrize("frozen", [True, False])
def test_a_model_that_was_changed_is_discretized_anew(frozen, constant):
    model = unhashable_oscillator(frozen, constant)
    discretize_zoh(model, 0.5, 2)
    model.stiffness[0, 0] = 4.0
    steps = discretize_zoh(model, 0.5, 2)
    assert_allclose(steps.A, [expm(0.5 * model.A(0.0))] * 2, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize("model", [DoubleIntegrator(2), Swinging()])
def test_steps_cannot_be_altered_for_the_next_caller(model):
    first = discretize_zoh(model, 1.0, 3)
    expected = first.A.copy()
    if first.A.flags.writeable:
        first.A[:] = 0
    assert_array_equal(discretize_zoh(model, 1.0, 3).A, expected)


def integrate(model, x, u, dt):
    for k, control in enumerate(u):
        span = (k * dt, (k + 1) * dt)
        rate = lambda t, x, u=control: model.rate(t, x, u)  # noqa: E731
        x = solve_ivp(rate, span, x, rtol=1e-11, atol=1e-12).y[:, -1]
    return x


@pytest.mark.parametrize("parts", [1, 5])
def test_a_time_varying_model_is_discretized_exactly(parts):
    x, u, model = np.array([1.0, -0.5, 0.2, 0.0]), np.array([[0.3, -0.2]]), Swinging()
    truth = integrate(model, x, np.tile(u, (4, 1)), 0.5)
    end = discretize_zoh(model, 0.5 / parts, 4 * parts).simulate(x, np.tile(u, (4 * parts, 1)))[-1]
    assert_allclose(end, truth, rtol=0, atol=1e-9)


def swing(t, x, u):
    return casadi.vertcat(x[1], -casadi.sin(x[0]) * (2 + casadi.sin(t)) + u[0])


def test_linearization_of_many_agents_is_that_of_each(rng):
    model, u = SymbolicModel(1, swing), rng.normal(size=(3, 4, 1))
    x = rng.normal(size=(3, 5, 2))
    together = linearize_along(model, x, u, 0.3, t0=0.7)
    assert len(together) == 4
    for i in range(3):
        alone, own = linearize_along(model, x[i], u[i], 0.3, t0=0.7), together.for_agent(i)
        assert_allclose(own.A, alone.A, rtol=0, atol=1e-9)
        assert_allclose(own.z, alone.z, rtol=0, atol=1e-9)


def test_linearization_agrees_with_finite_differences_of_the_motion(rng):
    model, u = SymbolicModel(1, swing), np.array([[0.4]])
    x, h = np.array([[0.8, -0.3], [0.0, 0.0]]), 1e-5
    steps = linearize_along(model, x, u, 0.5)

    def end(state, control):
        rate = lambda t, y: model.rate(t, y, control)  # noqa: E731
        return solve_ivp(rate, (0, 0.5), state, "DOP853", rtol=1e-13, atol=1e-13).y[:, -1]

    for i, e in enumerate(np.eye(2)):
        slope = (end(x[0] + h * e, u[0]) - end(x[0] - h * e, u[0])) / (2 * h)
        assert_allclose(steps.A[0, :, i], slope, atol=1e-8)
    slope = (end(x[0], u[0] + h) - end(x[0], u[0] - h)) / (2 * h)
    assert_allclose(steps.B[0, :, 0], slope, atol=1e-8)
    assert_allclose(steps.simulate(x[0], u)[-1], end(x[0], u[0]), atol=1e-10)


@pytest.mark.parametrize(
    ("dt", "count"), [(0.0, 3), (-1.0, 3), (np.nan, 3), (np.inf, 3), (1.0, -1)]
)
def test_a_step_that_is_not_positive_is_refused(dt, count):
    with pytest.raises(ValueError, match=r"^(dt|count): must be .* (above|at least) 0"):
        discretize_zoh(DoubleIntegrator(2), dt, count)


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
    with pytest.raises(ValueError, match=f"axes: must be 2 or 3, got {axes}"):
        DoubleIntegrator(axes)


def wave(t, x, u):
    return casadi.vertcat(x[2:], u - casadi.sin(x[:2]))


def test_agents_and_controls_may_share_axes(rng):
    shared, x = discretize_zoh(DoubleIntegrator(2), 0.5, 4), rng.normal(size=(3, 4))
    u = rng.normal(size=(2, 1, 4, 2))
    own = linearize_along(SymbolicModel(2, wave), np.stack([x] * 4, 1), np.zeros((3, 4, 2)), 0.5)
    for steps in (shared, own):
        states = steps.simulate(x, u)
        assert states.shape == (2, 3, 5, 4)
        for i in range(2):
            assert_array_equal(states[i], steps.simulate(x, np.tile(u[i], (3, 1, 1))))
        with pytest.raises(ValueError, match=r"^u: must be an array of"):
            steps.simulate(x, np.zeros((2, 4, 2)))
    assert_array_equal(shared.simulate(x, u[0, 0]), shared.simulate(x, u)[0])
    assert_array_equal(shared.simulate(x[1], u)[:, 0], shared.simulate(x, u)[:, 1])
