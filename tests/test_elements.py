"""Classical elements: round trips, singular cases, and published examples."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import brentq

from dynamics.elements import ClassicalElements, mean_anomaly, true_anomaly
from dynamics.orbit import EARTH_MU, Orbit

angle = st.floats(-np.pi, np.pi)
NAMES = ("semi_major_axis", "eccentricity", "inclination", "raan", "arg_perigee", "true_anomaly")


def parts(elements):
    return [getattr(elements, name) for name in NAMES]


@st.composite
def ellipses(draw, least=0.0, edge=0.0):
    tilts = st.floats(edge, np.pi - edge)
    e, perigee = draw(st.floats(least, 0.9)), draw(st.floats(6.6e6, 2e7))
    return ClassicalElements(
        perigee / (1 - e), e, draw(tilts), draw(angle), draw(angle), draw(angle)
    )


@given(ellipses())
def test_states_survive_the_round_trip_through_elements(elements):
    state = elements.to_state()
    back = ClassicalElements.from_state(state).to_state()
    size = np.linalg.norm(state.reshape(2, 3), axis=1).repeat(3)
    assert_allclose(back / size, state / size, rtol=0, atol=3e-15)


@given(ellipses(0.01, 0.01))
def test_elements_survive_the_round_trip_through_states(elements):
    back = ClassicalElements.from_state(elements.to_state())
    for name, a, b in zip(NAMES, parts(elements), parts(back), strict=True):
        if name in NAMES[3:]:
            assert abs(np.exp(1j * a) - np.exp(1j * b)) < 1e-12
        else:
            assert b == pytest.approx(a, rel=1e-12, abs=1e-12)


@given(ellipses())
def test_an_orbit_from_elements_has_their_polar_nodal_elements(elements):
    orbit = Orbit.from_elements(*(float(part) for part in parts(elements)))
    assert_allclose(elements.to_polar_nodal(), orbit.initial_elements, rtol=1e-14, atol=1e-9)


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


def test_conversions_of_many_orbits_are_each_its_own(rng):
    many = ClassicalElements(*rng.uniform(7e6, 9e6, (1, 6)), *rng.uniform(0, 0.9, (5, 6)))
    back = ClassicalElements.from_state(many.to_state())
    for k in range(6):
        alone = ClassicalElements(*(part[k] for part in parts(many)))
        assert_array_equal(many.to_state()[k], alone.to_state())
        assert_array_equal(
            [part[k] for part in parts(back)], parts(ClassicalElements.from_state(alone.to_state()))
        )


def test_vallados_example_2_5():
    # [Vallado2013, example 2-5], in km and degrees as printed.
    state = 1e3 * np.array([6524.834, 6862.875, 6448.296, 4.901327, 5.533756, -1.976341])
    found = ClassicalElements.from_state(state, 398600.4418e9)
    assert found.semi_major_axis == pytest.approx(36127.343e3, rel=3e-7)
    assert found.eccentricity == pytest.approx(0.832853, abs=1e-6)
    angles = np.degrees(parts(found)[2:]) % 360
    assert_allclose(angles, [87.870, 227.898, 53.38, 92.335], atol=6e-3)


def test_vallados_example_2_6():
    # [Vallado2013, example 2-6]: p = 11 067.790 km, e = 0.83285.
    e, p = 0.83285, 11067.790e3
    angles = np.radians([87.87, 227.89, 53.38, 92.335])
    state = ClassicalElements(p / (1 - e**2), e, *angles).to_state(398600.4418e9)
    assert_allclose(state[:3], [6525.344e3, 6861.535e3, 6449.125e3], atol=0.5e3)
    assert_allclose(state[3:], [4902.276, 5533.124, -1975.709], atol=0.5)


def test_a_circular_orbit_has_its_perigee_at_the_node():
    exact = ClassicalElements.from_polar_nodal(np.array([4.0, 0.0, 4.0, 0.1, 0.2, 0.7]), mu=4.0)
    assert (exact.eccentricity, exact.arg_perigee, exact.true_anomaly) == (0, 0, 0.7)


@pytest.mark.parametrize("speed", [1.0, 1.2])
def test_orbits_that_escape_are_refused(speed):
    escape = np.array([7e6, 0, 0, 0, 0, speed * np.sqrt(2 * EARTH_MU / 7e6)])
    with pytest.raises(ValueError, match=r"0 ≤ e < 1.*can only be given by its inertial position"):
        ClassicalElements.from_state(escape)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"eccentricity": np.array([0.1, -0.1])}, "eccentricity: .* got -0.1"),
        ({"eccentricity": np.nan}, "eccentricity: .* got nan"),
        ({"semi_major_axis": -7e6}, "positive and finite, got -7000000.0 m"),
        ({"inclination": np.radians(200)}, r"between 0 and π, got 3\.49066 rad"),
    ],
)
def test_invalid_elements_are_refused(change, message):
    good = dict(zip(NAMES, (7e6, 0.1, 0.5, 0, 0, 0), strict=True))
    with pytest.raises(ValueError, match=message):
        ClassicalElements(**(good | change))
