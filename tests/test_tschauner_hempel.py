"""Tschauner–Hempel, against laws, two-body motion and exact equations.

Errors of Φ are relative to its largest entry, with velocities in units of the mean motion
times a meter.
"""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from orbit_examples import transition_matrix

from dynamics.circular_orbit import ClohessyWiltshire
from dynamics.coordinate_frames import LVLH
from dynamics.forces import Forces
from dynamics.j2 import J2
from dynamics.orbit import Orbit
from dynamics.propagation import propagate
from dynamics.tschauner_hempel import TschaunerHempel

PERIGEE = 6900e3  # [m]


def ellipse(e, anomaly=0.0):
    return TschaunerHempel(Orbit.from_elements(PERIGEE / (1 - e), e, true_anomaly=anomaly))


def scaled(model, Phi):
    unit = np.repeat([1.0, model.orbit.mean_motion], 3)
    return Phi * unit / unit[:, None]


@pytest.fixture(params=[(0.0, 1.0), (0.3, -2.0), (0.6, 0.5), (0.9, 2.5)], ids=str)
def model(request):
    return ellipse(*request.param)


def test_transitions_are_symplectic(model):
    """With the momenta p = v + ω × l the motion is Hamiltonian, so Φᵀ Ω Φ = Ω."""
    a, b = np.array([0.2, 0.9]) * model.orbit.period
    Phi = scaled(model, transition_matrix(model, b, a))
    form = []
    for t in (a, b):
        turn = model.A(t)[3, 4] / 2 / model.orbit.mean_motion
        W = np.eye(6)
        W[3, 1], W[4, 0] = -turn, turn
        form.append(W.T @ np.kron([[0, 1], [-1, 0]], np.eye(3)) @ W)
    assert_allclose(Phi.T @ form[1] @ Phi, form[0], atol=1e-8 * max(1.0, np.abs(Phi).max()) ** 2)


@pytest.mark.parametrize("t", [0.0, 700.0, 9000.0])
def test_without_eccentricity_it_is_clohessy_wiltshire(t):
    circle = ellipse(0.0, 1.0)
    plain = ClohessyWiltshire(circle.orbit.mean_motion)
    unit = np.abs(plain.A(0.0)).max(axis=1, keepdims=True)
    assert_allclose(circle.A(t) / unit, plain.A(0.0) / unit, rtol=0, atol=1e-10)
    where = np.array([300.0, -200.0, 100.0])
    here, there = circle.bounded_velocity(where, t), plain.bounded_velocity(where)
    assert_allclose(here, there, rtol=0, atol=1e-9)


@pytest.mark.parametrize("part", [0.0, 0.7])
def test_bounded_orbit_closes_from_any_true_anomaly(rng, model, part):
    t, place = part * model.orbit.period, rng.uniform(-1500, 1500, (5, 3))
    x = np.hstack([place, model.bounded_velocity(place, t)])
    Phi = transition_matrix(model, t + model.orbit.period, t)
    end, size = x @ Phi.T, np.abs(scaled(model, Phi)).max()
    unit = np.repeat([1.0, model.orbit.mean_motion], 3)
    assert_allclose(end / unit, x / unit, atol=1e-9 * 1500 * size)


def test_only_bounded_orbits_close_at_any_cross_track_speed(rng):
    model = ellipse(0.4, 0.7)
    place = rng.uniform(-1500, 1500, 3)
    x = np.concatenate([place, model.bounded_velocity(place)])
    Phi = transition_matrix(model, model.orbit.period)
    x[5] = 2.0
    assert_allclose(Phi @ x, x, atol=1e-5)
    x[4] += 0.01
    assert np.linalg.norm((Phi @ x - x)[:3]) > 100


def test_matrices_at_many_times_are_each_its_own(rng):
    model, times = ellipse(0.3), rng.uniform(0, 1e4, 3)
    A, B, z = model.matrices(times)
    assert_allclose(A[1], model.A(times[1]), rtol=1e-13)
    assert_array_equal(B, [model.B(0.0)] * 3)
    assert not z.any()


@pytest.mark.parametrize("e", [0.0, 0.2, 0.7])
def test_equations_are_the_linearized_two_body_equations(e):
    """Compare with the exact equations without J2, linearized at the chief."""
    orbit = Orbit.from_elements(PERIGEE / (1 - e), e, inclination=1.0, true_anomaly=0.3)
    model = TschaunerHempel(orbit)
    for t in np.array([0.0, 0.1, 0.4]) * orbit.period:
        A, _ = J2(model.orbit).jacobian(t, np.zeros(6), np.zeros(3))
        exact = scaled(model, A)
        assert_allclose(scaled(model, model.A(t)), exact, rtol=0, atol=1e-9 * np.abs(exact).max())


def test_the_error_in_inertial_space_is_of_second_order():
    """Compare with inertial space after half an orbit at e = 0.5."""
    orbit = Orbit.from_elements(2 * PERIGEE, 0.5, 0.9, 0.4, 1.2, 0.2, k_J2=0.0)
    model, half = TschaunerHempel(orbit), orbit.period / 2
    x = np.array([300.0, -500.0, 400.0, 0.2, 0.0, -0.3])
    x[4] = model.bounded_velocity(x[:3])[1]
    begin = LVLH.from_polar_nodal(np.array(orbit.initial_elements), 0.0)
    start = begin.to_inertial(np.outer([0, 1, 0.5], x))
    end = propagate(start, np.array([half]), Forces(k_J2=0.0), accuracy=1e-11)[0]
    truth = LVLH.from_state(end[0]).from_inertial(end[1:])
    predicted = transition_matrix(model, half) @ x
    error = np.linalg.norm((np.outer([1, 0.5], predicted) - truth)[:, :3], axis=1)
    assert np.linalg.norm(truth[0, :3]) > 3000
    assert error[0] < 3  # [m]: (3 km)² over the radius
    assert error[0] / error[1] == pytest.approx(4, rel=0.01)
