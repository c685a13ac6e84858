"""The chief's orbit, against Kepler, published numbers and its own laws."""

import json
from math import pi, sqrt
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

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
elements = st.tuples(
    st.floats(9.5e6, 4.2e7),
    st.floats(0.0, 0.3),
    st.floats(0.0, pi),
    st.floats(0.0, 2 * pi),
    st.floats(0.0, 2 * pi),
    st.floats(0.0, 2 * pi),
)


def low(**elements):
    return Orbit.from_elements(6878e3, inclination=pi / 4, **elements)


def test_the_truth_table_is_met():
    mu, k = TRUTH["mu"] * 1e9, TRUTH["kJ2"] * 1e15
    orbit = Orbit(6878e3, 0.0, sqrt(mu * 6878e3), 0.0, pi / 4, 0.0, mu=mu, k_J2=k)
    times = {"8min": 480.0, "16min": 960.0, "24min": 1440.0, "1orbit": TRUTH["orbit_s"]}
    for name, t in times.items():
        said = np.array(TRUTH["reference_states"][name]) * [1e3, 1e3, 1e6, 1, 1, 1]
        # As many digits as the table prints.
        np.testing.assert_allclose(orbit.elements_at(t), said, rtol=1e-11, atol=1e-9)


@given(elements)
def test_elements_are_found_again(drawn):
    orbit = Orbit.from_elements(*drawn)
    a, e = orbit.semi_major_axis, orbit.eccentricity
    assert orbit.h == pytest.approx(sqrt(EARTH_MU * a * (1 - e**2)), rel=1e-12)
    assert orbit.period == pytest.approx(2 * pi * sqrt(a**3 / EARTH_MU), rel=1e-12)
    assert orbit.v_x**2 + (orbit.h / orbit.r) ** 2 == pytest.approx(
        EARTH_MU * (2 / orbit.r - 1 / a), rel=1e-12
    )


def test_without_oblateness_an_orbit_closes():
    orbit = low(eccentricity=0.05, perigee=0.4, anomaly=2.0, k_J2=0.0)
    after = orbit.elements_at(3 * orbit.period)
    np.testing.assert_allclose(after[:5], orbit.initial_elements[:5], rtol=1e-9, atol=1e-5)
    assert after[5] - orbit.arg_latitude == pytest.approx(6 * pi, rel=1e-10)


def test_the_node_of_a_low_orbit_turns_as_the_textbook_says():
    # −3/2 J₂ n (R/p)² cos i on average, to first order in J₂ [Vallado2013, eq. 9-38].
    orbit = low()
    n, a = orbit.mean_motion, orbit.semi_major_axis
    turned = orbit.elements_at(15 * orbit.period)[3]
    first = -(K_J2 / (EARTH_MU * a**2)) * n * np.cos(pi / 4) * 15 * orbit.period
    assert turned == pytest.approx(first, rel=5e-3)


@given(elements, st.floats(0, 4e4))
def test_energy_with_oblateness_and_momentum_about_the_pole_stay(drawn, t):
    orbit = Orbit.from_elements(*drawn)

    def kept(chief):
        r, v_x, h, _, i, theta = chief
        high = (np.sin(i) * np.sin(theta)) ** 2
        energy = (v_x**2 + (h / r) ** 2) / 2 - EARTH_MU / r - K_J2 / r**3 * (1 / 3 - high)
        return np.array([energy, h * np.cos(i) / orbit.h])

    np.testing.assert_allclose(
        kept(orbit.elements_at(t)), kept(np.array(orbit.initial_elements)), rtol=1e-10, atol=1e-11
    )


@given(elements)
def test_between_what_was_integrated_the_orbit_is_as_good(drawn):
    orbit = Orbit.from_elements(*drawn)
    # Across the seam of two pieces, and against the rates.
    t, h = np.array([3599.5, 3600.0, 3600.5]), 0.5
    chief = orbit.elements_at(t)
    slope = (chief[2] - chief[0]) / (2 * h)
    rate = polar_nodal_rates(chief[1], orbit.mu, orbit.k_J2)
    size = polar_nodal_scales(chief[1])
    np.testing.assert_allclose(slope / size, rate / size, rtol=1e-6, atol=1e-12)


@given(elements, st.floats(10, 2e4))
def test_angular_accelerations_are_the_slopes_of_the_rates(drawn, t):
    orbit, h = Orbit.from_elements(*drawn), 2.0
    before, now, after = (lvlh_rates(orbit.elements_at(s), orbit.k_J2) for s in (t - h, t, t + h))
    size = orbit.mean_motion**2
    assert now.alpha_z == pytest.approx((after.omega_z - before.omega_z) / (2 * h), abs=1e-5 * size)
    assert now.alpha_x == pytest.approx((after.omega_x - before.omega_x) / (2 * h), abs=1e-8 * size)


def test_many_times_are_the_same_as_each():
    orbit, t = low(), np.array([[0.0, 10.0], [4000.0, 9000.0]])
    together = orbit.elements_at(t)
    for at in np.ndindex(2, 2):
        np.testing.assert_array_equal(together[at], orbit.elements_at(t[at]))


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"semi_major_axis": 7e6, "eccentricity": 1.0}, "0 ≤ eccentricity < 1"),
        ({"semi_major_axis": 7e6, "eccentricity": 0.2}, "above 7973 km would do"),
        ({"semi_major_axis": -7e6}, "positive semi-major axis"),
        ({"semi_major_axis": 7e6, "inclination": 4.0}, "between 0 and 180"),
    ],
)
def test_an_orbit_that_cannot_be_is_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        Orbit.from_elements(**wrong)


def test_a_state_that_escapes_is_refused():
    with pytest.raises(ValueError, match="never comes back"):
        Orbit(EARTH_RADIUS + 5e5, 0.0, 12e3 * (EARTH_RADIUS + 5e5), 0.0, 0.5, 0.0)


def test_the_past_is_not_known():
    with pytest.raises(ValueError, match="from time 0 on, got t = -1"):
        low().elements_at(np.array([3.0, -1.0]))
