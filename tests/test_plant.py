"""Plants: the contract of all of them, and those that follow a model."""

from dataclasses import dataclass

import casadi
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from dynamics import (
    J2,
    ClohessyWiltshire,
    DoubleIntegrator,
    LinearModel,
    NonlinearModel,
    SymbolicModel,
)
from dynamics.atmosphere import Atmosphere
from dynamics.callbacks import CallbackError
from dynamics.inertial import InertialPlant
from dynamics.orbit import Orbit
from dynamics.plant import LinearPlant, NonlinearPlant

ORBIT = Orbit.from_elements(6878e3, inclination=np.pi / 4)


@dataclass(frozen=True)
class Swinging(LinearModel):
    """Oscillator with time-varying stiffness."""

    axes: int = 3

    def A(self, t):
        """State matrix."""
        A = np.zeros((6, 6))
        A[:3, 3:] = np.eye(3)
        A[3:, :3] = -1e-4 * (1 + np.sin(t / 20)) * np.eye(3)
        return A


def plants():
    return {
        "a time-invariant model": LinearPlant(ClohessyWiltshire(1.1e-3), ORBIT),
        "a time-varying model": LinearPlant(Swinging()),
        "two bodies and J2": InertialPlant(ORBIT),
        "an eccentric orbit": InertialPlant(Orbit.from_elements(9e6, 0.2, 1.2, 0.1, 0.2, 0.3)),
        "a nonlinear model": NonlinearPlant(J2(ORBIT)),
        "drag": InertialPlant(ORBIT, np.linspace(0.01, 0.02, 5), 0.015, Atmosphere()),
    }


@pytest.fixture(params=list(plants()))
def plant(request):
    return plants()[request.param]


@pytest.fixture
def swarm(rng):
    x = rng.normal(size=(5, 6)) * np.repeat([1e3, 1.0], 3)
    return x, rng.normal(0, 1e-3, (5, 3))


def test_propagation_starts_at_the_given_states(plant, swarm):
    path = plant.propagate(*swarm, 90.0, 60.0, 3)
    assert path.shape == (4, 5, 6)
    assert_array_equal(path[0], swarm[0])


def test_propagation_is_independent_of_earlier_calls(plant, swarm):
    first = plant.propagate(*swarm, 200.0, 60.0, 2)
    for t in (0.0, 977.0, 31.4):
        plant.propagate(2 * swarm[0], -swarm[1], t, 45.0)
        plant.chief_elements(t + 1)
    assert_array_equal(plant.propagate(*swarm, 200.0, 60.0, 2), first)


def test_substeps_agree_with_separate_propagations(plant, swarm):
    x, u = swarm
    path = plant.propagate(x, u, 30.0, 120.0, 12)
    for k in range(12):
        x = plant.propagate(x, u, 30.0 + 10.0 * k, 10.0)[1]
        assert_allclose(path[k + 1], x, rtol=0, atol=1e-8)


def test_absent_agents_stay_absent_and_have_no_effect(plant, swarm):
    x, u = swarm[0].copy(), swarm[1].copy()
    everyone = plant.propagate(x, u, 0.0, 60.0, 2)
    x[2], u[2] = np.nan, np.nan
    path = plant.propagate(x, u, 0.0, 60.0, 2)
    assert np.isnan(path[:, 2]).all()
    others = [0, 1, 3, 4]
    assert_allclose(path[:, others], everyone[:, others], rtol=0, atol=1e-9)


def test_a_swarm_of_absent_agents_can_be_propagated(plant):
    away = np.full((5, 6), np.nan)
    assert np.isnan(plant.propagate(away, np.zeros((5, 3)), 0.0, 60.0, 2)).all()


def test_the_chief_is_that_of_the_orbit_or_of_the_model():
    assert LinearPlant(DoubleIntegrator(2)).chief_elements(10.0) is None
    assert NonlinearPlant(SymbolicModel(1, lambda t, x, u: x)).chief_elements(10.0) is None
    for plant in (LinearPlant(ClohessyWiltshire(1.1e-3), ORBIT), NonlinearPlant(J2(ORBIT))):
        assert_array_equal(plant.chief_elements(70.0), ORBIT.elements_at(70.0))


def test_a_nonlinear_plant_agrees_with_a_linear_one_for_a_linear_model(swarm):
    linear = ClohessyWiltshire(1.1e-3)
    A, B = linear.A(0.0), linear.B(0.0)
    symbolic = SymbolicModel(3, lambda t, x, u: casadi.DM(A) @ x + casadi.DM(B) @ u)
    path = NonlinearPlant(symbolic).propagate(*swarm, 0.0, 120.0, 3)
    second = LinearPlant(linear).propagate(*swarm, 0.0, 120.0, 3)
    assert_allclose(path, second, rtol=0, atol=1e-8)


def test_a_model_that_cannot_be_integrated_is_reported():
    blow_up = SymbolicModel(1, lambda t, x, u: casadi.vertcat(x[1], x[1] ** 2))
    with pytest.raises(CallbackError, match="SymbolicModel cannot be integrated from t = 0 to 2 s"):
        NonlinearPlant(blow_up).propagate(np.ones((1, 2)), np.zeros((1, 1)), 0.0, 2.0)


def test_a_rate_that_jumps_at_each_evaluation_is_refused_in_bounded_time():
    class Rough(NonlinearModel):
        axes = 2

        def rate(self, t, x, u):
            return np.concatenate([x[..., 2:], u + 1e-6 * np.sign(np.sin(1e9 * x[..., :2]))], -1)

        def jacobian(self, t, x, u):
            raise NotImplementedError

    with pytest.raises(CallbackError, match=r"Rough cannot .* at t = .* in doubles would do"):
        NonlinearPlant(Rough()).propagate(np.full((1, 4), 0.3), np.full((1, 2), 0.1), 0.0, 1.0)


@pytest.mark.parametrize(
    ("shape", "dt", "substeps", "message"),
    [
        (((5, 4), (5, 2)), 60.0, 1, r"in 3 axes have states of shape \(agents, 6\).*\(5, 4\)"),
        (((5, 6), (5, 2)), 60.0, 1, r"got \(5, 6\) and \(5, 2\)"),
        (((5, 6), (5, 3)), 0.0, 1, "the duration must be positive .* got dt = 0.0 s"),
        (((5, 6), (5, 3)), 60.0, 0, "at least one substep, got dt = 60.0 s and substeps = 0"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(plant, shape, dt, substeps, message):
    x, u = (np.zeros(part) for part in shape)
    with pytest.raises(ValueError, match=message):
        plant.propagate(x, u, 0.0, dt, substeps)


def test_controls_that_are_not_finite_are_refused(plant, swarm):
    swarm[1][3, 0] = np.nan
    with pytest.raises(ValueError, match=r"agent 3 is present, but its acceleration is \[ *nan"):
        plant.propagate(*swarm, 0.0, 60.0)
