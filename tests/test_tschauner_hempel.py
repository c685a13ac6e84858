"""Tschauner–Hempel, against laws, two-body motion and integration.

Errors of Φ are relative to its largest entry, with velocities in units of the mean motion
times a meter.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from orbit_examples import transition_matrix
from scipy.optimize import brentq

from dynamics.clohessy_wiltshire import ClohessyWiltshire
from dynamics.coordinate_frames import LVLH
from dynamics.forces import Forces
from dynamics.j2 import J2
from dynamics.orbit import Orbit
from dynamics.propagation import propagate
from dynamics.tschauner_hempel import TschaunerHempel, mean_anomaly, true_anomaly

PERIGEE = 6900e3  # [m]


def ellipse(e, anomaly=0.0):
    return TschaunerHempel(PERIGEE / (1 - e), e, anomaly)


def period(model):
    return 2 * np.pi / model.n


def scaled(model, Phi):
    unit = np.repeat([1.0, model.n], 3)
    return Phi * unit / unit[:, None]


def assert_same(model, Phi, other, rtol):
    a, b = scaled(model, Phi), scaled(model, other)
    assert_allclose(a, b, rtol=0, atol=rtol * np.abs(b).max())


models = st.builds(ellipse, st.floats(0, 0.9), st.floats(-np.pi, np.pi))
parts = st.floats(0.01, 2)  # of a period


@settings(max_examples=20)
@given(models, parts, parts)
def test_transitions_are_symplectic(model, first, span):
    """With the momenta p = v + ω × l the motion is Hamiltonian, so Φᵀ Ω Φ = Ω."""
    a, b = np.array([first, first + span]) * period(model)
    Phi = scaled(model, transition_matrix(model, b, a))
    form = []
    for t in (a, b):
        turn = model.A(t)[3, 4] / 2 / model.n
        W = np.eye(6)
        W[3, 1], W[4, 0] = -turn, turn
        form.append(W.T @ np.kron([[0, 1], [-1, 0]], np.eye(3)) @ W)
    assert_allclose(Phi.T @ form[1] @ Phi, form[0], atol=1e-8 * max(1.0, np.abs(Phi).max()) ** 2)


@given(st.floats(-3, 3), parts)
def test_without_eccentricity_it_is_clohessy_wiltshire(anomaly, part):
    circle = TschaunerHempel(PERIGEE, 0.0, anomaly)
    plain, a = ClohessyWiltshire(circle.n), part * period(circle)
    assert_allclose(circle.A(a), plain.A(0.0), rtol=1e-14, atol=0)
    where = np.array([300.0, -200.0, 100.0])
    assert_allclose(circle.bounded_velocity(where, a), plain.bounded_velocity(where), rtol=1e-14)


@settings(max_examples=20)
@given(models, parts, st.integers(0, 2**32 - 1))
def test_bounded_orbit_closes_from_any_true_anomaly(model, part, seed):
    t = part * period(model)
    place = np.random.default_rng(seed).uniform(-1500, 1500, (5, 3))
    x = np.hstack([place, model.bounded_velocity(place, t)])
    Phi = transition_matrix(model, t + period(model), t)
    end, size = x @ Phi.T, np.abs(scaled(model, Phi)).max()
    unit = np.repeat([1.0, model.n], 3)
    assert_allclose(end / unit, x / unit, atol=1e-9 * 1500 * size)


def test_only_bounded_orbits_close_at_any_cross_track_speed(rng):
    model = ellipse(0.4, 0.7)
    place = rng.uniform(-1500, 1500, 3)
    x = np.concatenate([place, model.bounded_velocity(place)])
    Phi = transition_matrix(model, period(model))
    x[5] = 2.0
    assert_allclose(Phi @ x, x, atol=1e-7)
    x[4] += 0.01
    assert np.linalg.norm((Phi @ x - x)[:3]) > 100


@given(models)
def test_true_anomaly_grows_by_a_revolution_in_a_period(model):
    f = model.true_anomaly_at(np.linspace(-2, 2, 41) * period(model))
    assert (np.diff(f) > 0).all()
    assert_allclose(f[10:] - f[:-10], 2 * np.pi, atol=1e-8)
    assert f[20] == pytest.approx(model.true_anomaly, abs=1e-14)


def test_matrices_at_many_times_are_each_its_own(rng):
    model, times = ellipse(0.3), rng.uniform(0, 1e4, 3)
    A, B, z = model.matrices(times)
    assert_allclose(A[1], model.A(times[1]), rtol=1e-13)
    assert_array_equal(B, [model.B(0.0)] * 3)
    assert not z.any()


@given(st.floats(-30, 30), st.floats(0, 0.999))
def test_anomalies_survive_the_round_trip(f, e):
    mean = mean_anomaly(f, e)
    slope = (1 - e**2) ** 1.5 / (1 + e * np.cos(f)) ** 2  # dM/df
    assert true_anomaly(mean, e) == pytest.approx(f, abs=1e-13 * max(1, 1 / slope))
    assert mean_anomaly(true_anomaly(f, e), e) == pytest.approx(f, abs=1e-12)


@given(st.floats(0.01, np.pi), st.floats(0, 0.99))
def test_keplers_equation_agrees_with_brent(M, e):
    E = brentq(lambda E: E - e * np.sin(E) - M, 0, np.pi + 1e-9, xtol=1e-14)
    f = 2 * np.arctan(np.sqrt((1 + e) / (1 - e)) * np.tan(E / 2))
    assert true_anomaly(M, e) == pytest.approx(f, abs=1e-10)


@pytest.mark.parametrize("e", [0.0, 0.2, 0.7])
def test_equations_are_the_linearized_two_body_equations(e):
    """Compare with the exact equations without J2, linearized at the chief."""
    orbit = Orbit.from_elements(PERIGEE / (1 - e), e, inclination=1.0, true_anomaly=0.3, k_J2=0.0)
    exact, model = J2(orbit), TschaunerHempel.from_orbit(orbit)
    for t in np.array([0.0, 0.1, 0.4]) * orbit.period:
        A, _ = exact.jacobian(t, np.zeros(6), np.zeros(3))
        assert_same(model, model.A(t), A, 1e-9)


def test_the_error_in_inertial_space_is_of_second_order():
    """Compare with inertial space after half an orbit at e = 0.5."""
    orbit = Orbit.from_elements(2 * PERIGEE, 0.5, 0.9, 0.4, 1.2, 0.2, k_J2=0.0)
    model, half = TschaunerHempel.from_orbit(orbit), orbit.period / 2
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


@settings(max_examples=20)
@given(st.floats(0, 0.9), st.floats(-3.1, 3.1))
def test_the_ellipse_of_an_orbit_is_found_again(e, anomaly):
    orbit = Orbit.from_elements(PERIGEE / (1 - e), e, 0.5, true_anomaly=anomaly)
    model = TschaunerHempel.from_orbit(orbit)
    assert (model.semi_major_axis, model.eccentricity) == pytest.approx(
        (PERIGEE / (1 - e), e), rel=1e-12, abs=1e-12
    )
    # Where e is lost in rounding, the perigee is undefined and has no effect.
    assert_allclose(
        model.eccentricity * np.exp(1j * model.true_anomaly), e * np.exp(1j * anomaly), atol=1e-12
    )


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ((7e6, 1.0), "0 ≤ e < 1, got 1;"),
        ((-7e6, 0.1), "semi_major_axis: must be positive"),
        ((7e6, 0.1, np.inf), "and true_anomaly finite"),
        ((7e6, 0.1, 0.0, 0.0), "mu: must be positive"),
        ((7e6, 0.2), "5600 km from the center, is inside .* 0.2 .* above 7973 km would do"),
    ],
)
def test_invalid_ellipses_are_refused(fields, message):
    with pytest.raises(ValueError, match=message):
        TschaunerHempel(*fields)
