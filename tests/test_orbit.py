"""Orbit of the chief, against Kepler's laws, published numbers and invariants."""

import json
from math import pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from dynamics.orbit import (
    EARTH_MU,
    EARTH_RADIUS,
    K_J2,
    Orbit,
    lvlh_rates,
    polar_nodal_rates,
    polar_nodal_scales,
)

TRUTH = json.loads(Path(__file__).with_name("j2_truth.json").read_text())
angle = st.floats(0.0, 2 * pi)
elements = st.tuples(
    st.floats(9.5e6, 4.2e7), st.floats(0.0, 0.3), st.floats(0.0, pi), angle, angle, angle
)


def low(**elements):
    return Orbit.from_elements(6878e3, inclination=pi / 4, **elements)


def test_reference_table_is_met_to_its_printed_digits():
    mu, k = TRUTH["mu"] * 1e9, TRUTH["kJ2"] * 1e15
    orbit = Orbit(6878e3, 0.0, sqrt(mu * 6878e3), 0.0, pi / 4, 0.0, mu=mu, k_J2=k)
    times = {"8min": 480.0, "16min": 960.0, "24min": 1440.0, "1orbit": TRUTH["orbit_s"]}
    for name, t in times.items():
        expected = np.array(TRUTH["reference_states"][name]) * [1e3, 1e3, 1e6, 1, 1, 1]
        assert_allclose(orbit.elements_at(t), expected, rtol=1e-11, atol=1e-9)


@given(elements)
def test_osculating_elements_satisfy_keplers_laws(values):
    orbit = Orbit.from_elements(*values)
    a, e = orbit.semi_major_axis, orbit.eccentricity
    assert orbit.h == pytest.approx(sqrt(EARTH_MU * a * (1 - e**2)), rel=1e-12)
    assert orbit.period == pytest.approx(2 * pi * sqrt(a**3 / EARTH_MU), rel=1e-12)
    assert orbit.v_x**2 + (orbit.h / orbit.r) ** 2 == pytest.approx(
        EARTH_MU * (2 / orbit.r - 1 / a), rel=1e-12
    )


def test_an_orbit_without_oblateness_closes():
    orbit = low(eccentricity=0.05, arg_perigee=0.4, true_anomaly=2.0, k_J2=0.0)
    after = orbit.elements_at(3 * orbit.period)
    assert_allclose(after[:5], orbit.initial_elements[:5], rtol=1e-9, atol=1e-5)
    assert after[5] - orbit.arg_latitude == pytest.approx(6 * pi, rel=1e-10)


@given(elements, st.floats(0, 4e4))
def test_energy_and_polar_angular_momentum_are_conserved(values, t):
    orbit = Orbit.from_elements(*values)

    def invariants(chief):
        r, v_x, h, _, i, theta = chief
        high = (np.sin(i) * np.sin(theta)) ** 2
        energy = (v_x**2 + (h / r) ** 2) / 2 - EARTH_MU / r - K_J2 / r**3 * (1 / 3 - high)
        return np.array([energy, h * np.cos(i) / orbit.h])

    assert_allclose(
        invariants(orbit.elements_at(t)),
        invariants(np.array(orbit.initial_elements)),
        rtol=1e-10,
        atol=1e-11,
    )


@given(elements)
def test_interpolated_elements_satisfy_their_rates(values):
    orbit = Orbit.from_elements(*values)
    # Across the boundary of two segments.
    t, h = np.array([3599.5, 3600.0, 3600.5]), 0.5
    chief = orbit.elements_at(t)
    slope = (chief[2] - chief[0]) / (2 * h)
    rate = polar_nodal_rates(chief[1], orbit.mu, orbit.k_J2)
    size = polar_nodal_scales(chief[1])
    assert_allclose(slope / size, rate / size, rtol=1e-6, atol=1e-12)


@given(elements, st.floats(10, 2e4))
def test_angular_acceleration_is_the_derivative_of_angular_velocity(values, t):
    orbit, h = Orbit.from_elements(*values), 1.0
    before, now, after = (lvlh_rates(orbit.elements_at(s), orbit.k_J2) for s in (t - h, t, t + h))
    size = orbit.mean_motion**2
    assert now.alpha_z == pytest.approx((after.omega_z - before.omega_z) / (2 * h), abs=1e-5 * size)
    assert now.alpha_x == pytest.approx((after.omega_x - before.omega_x) / (2 * h), abs=1e-8 * size)


def test_elements_at_many_times_are_those_at_each():
    orbit, t = low(), np.array([[0.0, 10.0], [4000.0, 9000.0]])
    together = orbit.elements_at(t)
    for at in np.ndindex(2, 2):
        np.testing.assert_array_equal(together[at], orbit.elements_at(t[at]))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"semi_major_axis": 7e6, "eccentricity": 1.0}, "ellipse needs 0 ≤ e < 1, got 1"),
        ({"semi_major_axis": 7e6, "eccentricity": 0.2}, "above 7973 km would do"),
        ({"semi_major_axis": -7e6}, "semi_major_axis: must be positive"),
        ({"semi_major_axis": 7e6, "inclination": 4.0}, "between 0 and π, got 4 rad"),
    ],
)
def test_invalid_orbits_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        Orbit.from_elements(**wrong)


def test_orbits_that_escape_are_refused():
    with pytest.raises(ValueError, match="0 ≤ e < 1"):
        Orbit(EARTH_RADIUS + 5e5, 0.0, 12e3 * (EARTH_RADIUS + 5e5), 0.0, 0.5, 0.0)


def test_times_before_0_are_refused():
    with pytest.raises(ValueError, match=r"from time 0 on, .* got -1"):
        low().elements_at(np.array([3.0, -1.0]))
