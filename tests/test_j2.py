"""Relative motion under J2, against a reference table, inertial orbits and CasADi."""

import json
from math import pi, sqrt
from pathlib import Path

import casadi
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from orbit_examples import propagate_relative, random_orbit

from dynamics.coordinate_frames import LVLH, inertial_state, to_polar_nodal
from dynamics.j2 import J2, invariant_velocity
from dynamics.orbit import Orbit, lvlh_rates
from dynamics.propagation import propagate

TRUTH = json.loads(Path(__file__).with_name("j2_truth.json").read_text())
LOW = Orbit.from_elements(6878e3, inclination=pi / 4)


def test_reference_table_is_met_to_a_micrometer():
    mu, k = TRUTH["mu"] * 1e9, TRUTH["kJ2"] * 1e15
    orbit = Orbit(6878e3, 0.0, sqrt(mu * 6878e3), 0.0, pi / 4, 0.0, mu=mu, k_J2=k)
    names = ["8min", "16min", "24min", "1orbit"]
    times = np.array([480.0, 960.0, 1440.0, TRUTH["orbit_s"]])
    start = 1e3 * np.array([deputy["initial"] for deputy in TRUTH["deputies"]])
    expected = 1e3 * np.array([[deputy[name] for deputy in TRUTH["deputies"]] for name in names])
    off = np.abs(propagate_relative(orbit, start, times) - expected)
    assert off[..., :3].max() <= 1e-6
    assert off[..., 3:].max() <= 1e-9


@pytest.mark.parametrize("case", range(20))
def test_relative_motion_is_the_difference_of_two_inertial_orbits(case):
    rng = np.random.default_rng(case)
    orbit = random_orbit(rng)
    position = rng.normal(size=(3, 3))
    position *= rng.uniform(0.1, 20e3, (3, 1)) / np.linalg.norm(position, axis=1, keepdims=True)
    x = np.hstack([position, rng.normal(scale=orbit.mean_motion * 1e3, size=(3, 3))])
    end = np.array([orbit.period])
    relative = propagate_relative(orbit, x, end)[0]

    chief = inertial_state(np.array(orbit.initial_elements))
    frame = LVLH.from_polar_nodal(np.array(orbit.initial_elements), orbit.k_J2)
    both = np.vstack([chief, frame.to_inertial(x)])
    after = propagate(both, end, accuracy=1e-13)[0]
    there = LVLH.from_polar_nodal(to_polar_nodal(after[0]), orbit.k_J2).from_inertial(after[1:])
    assert_allclose(relative[:, :3], there[:, :3], rtol=0, atol=1e-5)
    assert_allclose(relative[:, 3:], there[:, 3:], rtol=0, atol=1e-8)


def symbolic_rate(chief, alpha, x, u, mu, k):
    """Return the equations component by component, as published in [Xu2008]."""
    r, _, h, _, i, theta = (chief[j] for j in range(6))
    s, c = casadi.sin, casadi.cos
    w_x, w_z = -k * s(2 * i) * s(theta) / (h * r**3), h / r**2
    a_x, a_z = alpha[0], alpha[1]
    X, Y, Z, vx, vy, vz = (x[j] for j in range(6))
    r_j = casadi.sqrt((r + X) ** 2 + Y**2 + Z**2)
    r_jZ = (r + X) * s(i) * s(theta) + Y * s(i) * c(theta) + Z * c(i)
    eta2 = mu / r**3 + k / r**5 - 5 * k * (s(i) * s(theta)) ** 2 / r**5
    zeta = 2 * k * s(i) * s(theta) / r**4
    eta2_j = mu / r_j**3 + k / r_j**5 - 5 * k * r_jZ**2 / r_j**7
    zeta_j = 2 * k * r_jZ / r_j**5
    d = zeta_j - zeta
    ax = 2 * w_z * vy - (eta2_j - w_z**2) * X + a_z * Y - w_x * w_z * Z
    ay = -2 * w_z * vx + 2 * w_x * vz - a_z * X - (eta2_j - w_z**2 - w_x**2) * Y + a_x * Z
    az = -2 * w_x * vy - w_x * w_z * X - a_x * Y - (eta2_j - w_x**2) * Z
    return casadi.vertcat(
        x[3:],
        ax - d * s(i) * s(theta) - r * (eta2_j - eta2) + u[0],
        ay - d * s(i) * c(theta) + u[1],
        az - d * c(i) + u[2],
    )


def test_rate_and_jacobian_agree_with_the_published_equations():
    x, u = casadi.SX.sym("x", 6), casadi.SX.sym("u", 3)
    chief, alpha = casadi.SX.sym("chief", 6), casadi.SX.sym("alpha", 2)
    rng = np.random.default_rng(3)
    for _ in range(20):
        orbit = random_orbit(rng)
        f = symbolic_rate(chief, alpha, x, u, orbit.mu, orbit.k_J2)
        slopes = casadi.jacobian(f, x), casadi.jacobian(f, u)
        printed = casadi.Function("printed", [chief, alpha, x, u], [f, *slopes])
        t, model = rng.uniform(0, 9e3), J2(orbit)
        state = rng.normal(scale=[5e3] * 3 + [5] * 3)
        control = rng.normal(scale=1e-2, size=3)
        rates = lvlh_rates(orbit.elements_at(t), orbit.k_J2)
        expected = printed(orbit.elements_at(t), [rates.alpha_x, rates.alpha_z], state, control)
        found = model.rate(t, state, control), *model.jacobian(t, state, control)
        for ours, theirs in zip(found, expected, strict=True):
            theirs = np.asarray(theirs).reshape(ours.shape)
            assert_allclose(ours, theirs, rtol=1e-9, atol=1e-13)


def test_rates_of_an_array_of_symbols_are_those_of_numbers(rng):
    model, x, u = J2(random_orbit(rng)), 1e3 * rng.normal(size=6), rng.normal(size=3)
    x[3:] *= 1e-3
    symbols = casadi.SX.sym("x", 6)
    traced = model.rate(100.0, np.array(casadi.vertsplit(symbols)), u.astype(object))
    function = casadi.Function("rate", [symbols], [casadi.vertcat(*traced)])
    assert_allclose(np.array(function(x)).ravel(), model.rate(100.0, x, u), rtol=1e-9, atol=1e-12)


def test_the_chief_stays_at_the_origin():
    still = np.zeros(6)
    np.testing.assert_array_equal(J2(LOW).rate(123.0, still, np.zeros(3)), still)


def drift(orbit, position, orbits):
    """Return the along-track drift of the mean over an orbit [m an orbit]."""
    phase = np.arange(8) / 8
    times = orbit.period * np.concatenate([phase, orbits - 1 + phase])
    x = np.hstack([position, invariant_velocity(orbit, position)])
    along = propagate_relative(orbit, x, times)[..., 1].reshape(2, 8, -1).mean(axis=1)
    return np.abs(along[1] - along[0]).max() / (orbits - 1)


@pytest.mark.parametrize("latitude", [0.0, 0.8, 1.57, 3.9])
def test_in_plane_invariant_velocities_leave_no_drift(latitude):
    orbit = Orbit.from_elements(6878e3, inclination=pi / 4, true_anomaly=latitude)
    angle = np.arange(6) * pi / 3
    ring = 1e3 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=-1)
    assert drift(orbit, ring, 15) <= 0.1


def test_out_of_plane_invariant_velocities_leave_little_drift():
    tilted = Orbit.from_elements(6878e3, inclination=pi / 4, true_anomaly=-pi / 4)
    assert drift(tilted, np.array([[500.0, -300.0, 400.0], [0.0, 800.0, -700.0]]), 15) <= 0.1


def test_about_an_ellipse_the_drift_of_the_perigee_is_left():
    # Equal energy gives equal mean motion, but perigees still turn at different rates.
    long = Orbit.from_elements(8600e3, 0.2, pi / 4, true_anomaly=0.3)
    ring = np.array([[700.0, 300.0, 0.0], [-500.0, 800.0, 0.0]])
    assert drift(long, ring, 8) <= 1.0


@given(st.floats(0.0, 0.3), st.floats(-1.2, 1.2))
def test_invariant_velocities_give_equal_inclinations(e, latitude):
    orbit = Orbit.from_elements(9e6 / (1 - e), e, pi / 4, true_anomaly=latitude)
    place = np.array([0.0, 0.0, 1000.0])
    frame = LVLH.from_polar_nodal(np.array(orbit.initial_elements), orbit.k_J2)
    deputy = frame.to_inertial(np.hstack([place, invariant_velocity(orbit, place)]))
    assert abs(to_polar_nodal(deputy)[4] - orbit.inclination) * orbit.r < 0.5


@pytest.mark.parametrize(("radius", "tilt"), [(6878e3, 0.001), (42164e3, pi - 0.05)])
def test_near_the_equator_no_latitude_has_large_velocities(radius, tilt):
    top = Orbit.from_elements(radius, inclination=tilt, true_anomaly=pi / 2)
    place = np.array([[200.0, -300.0, 700.0]])
    assert drift(top, place, 3) <= 0.1
    x = np.hstack([place, invariant_velocity(top, place)])
    path = propagate_relative(top, x, np.linspace(0, top.period, 12))
    assert np.abs(path[..., 2]).max() <= 700.0 * (1 + 1e-6)


def test_out_of_plane_positions_at_latitude_90_are_refused():
    top = Orbit.from_elements(6878e3, inclination=pi / 4, true_anomaly=pi / 2)
    with pytest.raises(ValueError, match=r"latitude 90°.*in the plane \(z = 0\)"):
        invariant_velocity(top, np.array([0.0, 500.0, 300.0]))
