"""Quasi-nonsingular relative elements: what each of them means, and where they end."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.coordinate_frames import LVLH
from dynamics.elements import ClassicalElements, true_anomaly
from dynamics.orbit import EARTH_MU
from dynamics.relative_elements import RelativeOrbitalElements

angle = st.floats(-np.pi, np.pi)
small = st.floats(-1e-3, 1e-3)


@st.composite
def chiefs(draw):
    e, perigee = draw(st.floats(0, 0.7)), draw(st.floats(6.6e6, 2e7))
    tilt = draw(st.floats(0.05, 3.09))
    return ClassicalElements(perigee / (1 - e), e, tilt, draw(angle), draw(angle), draw(angle))


def near_circle(anomaly=0.4, e=0.0):
    return ClassicalElements(7e6, e, 0.9, 0.3, 0.2, anomaly)


def one(name, size):
    zero = dict.fromkeys(RelativeOrbitalElements._fields, 0.0)
    return RelativeOrbitalElements(**(zero | {name: size}))


def later(elements, t):
    """Kepler's motion."""
    n = np.sqrt(EARTH_MU / elements.semi_major_axis**3)
    anomaly = true_anomaly(elements.mean_anomaly + n * t, elements.eccentricity)
    fixed = elements.semi_major_axis, elements.eccentricity, elements.inclination
    return ClassicalElements(*fixed, elements.raan, elements.perigee, anomaly)


@given(chiefs(), st.tuples(*[small] * 6))
def test_relative_elements_come_back_from_the_deputy(chief, numbers):
    back = RelativeOrbitalElements.from_elements(
        chief, RelativeOrbitalElements(*numbers).deputy_elements(chief)
    )
    np.testing.assert_allclose(np.array(back), numbers, rtol=0, atol=3e-14)


@given(chiefs(), st.integers(0, 2**32 - 1))
def test_states_come_back_from_relative_elements(chief, seed):
    rng = np.random.default_rng(seed)
    state = chief.state()
    frame = LVLH.from_state(state, rng.normal(0, 1e-2, 3))
    x = rng.uniform(-1, 1, (5, 6)) * np.repeat([2e4, 20], 3)
    back = RelativeOrbitalElements.from_lvlh(frame, x).to_lvlh(frame)
    # Angles hold 16 digits, of a lap of the orbit.
    lap = 1e-15 * chief.semi_major_axis / (1 - chief.eccentricity) ** 2
    np.testing.assert_allclose(back[:, :3], x[:, :3], rtol=0, atol=20 * lap)


def test_many_chiefs_with_many_deputies_are_each_by_itself(rng):
    chief = ClassicalElements(8e6, 0.1, *rng.uniform(0.1, 2, (4, 3)))
    frame = LVLH.from_state(chief.to_state())
    x = rng.uniform(-1e3, 1e3, (3, 4, 6)) * np.repeat([1, 1e-3], 3)
    relative = RelativeOrbitalElements.from_lvlh(frame, x)
    np.testing.assert_allclose(relative.to_lvlh(frame), x, rtol=0, atol=1e-7)
    alone = RelativeOrbitalElements.from_lvlh(LVLH.from_state(frame.chief_state[1]), x[1, 2])
    np.testing.assert_allclose([part[1, 2] for part in relative], alone, atol=1e-15)


def test_a_difference_of_longitude_stays_behind_or_ahead():
    chief = near_circle()
    relative = one("longitude", 1e-4)
    for t in (0.0, 1e3, 1e5):
        now, deputy = later(chief, t), later(relative.deputy_elements(chief), t)
        x = LVLH.from_state(now.to_state()).from_inertial(deputy.to_state())
        np.testing.assert_allclose(x[:3], [-3.5e-2, 700, 0], atol=1e-3)
        np.testing.assert_allclose(x[3:], 0, atol=1e-6)


def test_a_difference_of_axis_drifts_by_three_pi_of_it_an_orbit():
    chief = near_circle()
    period = 2 * np.pi * np.sqrt(7e6**3 / EARTH_MU)
    deputy = one("semi_major_axis", 1e-6).deputy_elements(chief)
    start, end = (
        LVLH.from_state(later(chief, t).to_state()).from_inertial(later(deputy, t).to_state())
        for t in (0, period)
    )
    assert start[0] == pytest.approx(7, rel=1e-5)
    assert end[1] - start[1] == pytest.approx(-3 * np.pi * 7, rel=1e-4)


@pytest.mark.parametrize(
    ("name", "width"),
    [("eccentricity_x", 2), ("eccentricity_y", 2), ("inclination_x", 1), ("inclination_y", 1)],
)
def test_the_other_differences_go_round_and_do_not_drift(name, width):
    chief = near_circle()
    deputy = one(name, 1e-5).deputy_elements(chief)
    times = np.linspace(0, 2 * np.pi * np.sqrt(7e6**3 / EARTH_MU), 41)
    x = np.array(
        [
            LVLH.from_state(later(chief, t).to_state()).from_inertial(later(deputy, t).to_state())
            for t in times
        ]
    )
    np.testing.assert_allclose(x[-1], x[0], atol=1e-6)
    across = 1 if width == 2 else 2
    assert np.abs(x[:, across]).max() == pytest.approx(width * 70, rel=1e-3)


def test_the_linear_map_is_off_by_the_square_of_the_difference():
    chief = near_circle()
    frame, unit = LVLH.from_state(chief.to_state()), np.array([3, -2, 1, 2, -1, 1.5])
    off = []
    for size in (1e-3, 1e-4, 1e-5):
        relative = RelativeOrbitalElements(*(size * unit))
        off.append(np.abs(relative.to_lvlh_first_order(chief) - relative.to_lvlh(frame))[:3].max())
    np.testing.assert_allclose(np.log10(np.divide(off[:-1], off[1:])), 2, atol=0.05)


def test_they_are_those_of_brahe():
    # The example in brahe's documentation of `state_oe_to_roe`, as printed there.
    def orbit(a, e, *degrees):
        i, node, perigee, mean = np.radians(degrees)
        return ClassicalElements(a, e, i, node, perigee, true_anomaly(mean, e))

    chief = orbit(6378136.3 + 700e3, 0.001, 97.8, 15.0, 30.0, 45.0)
    deputy = orbit(6378136.3 + 701e3, 0.0015, 97.85, 15.05, 30.05, 45.05)
    a, longitude, e_x, e_y, i_x, i_y = RelativeOrbitalElements.from_elements(chief, deputy)
    np.testing.assert_allclose([a, e_x, e_y], [1.413e-4, 4.324e-4, 2.511e-4], atol=5.1e-8)
    np.testing.assert_allclose(
        np.degrees([longitude, i_x, i_y]), [9.321e-2, 5.0e-2, 4.954e-2], atol=5.1e-6
    )


@pytest.mark.parametrize("tilt", [0.0, np.pi])
def test_an_equatorial_chief_is_refused_with_what_would_do(tilt):
    flat = ClassicalElements(7e6, 0.01, tilt, 0.0, 0.2, 0.3)
    message = r"whose node is undefined: the chief .* use states in the chief's frame \(LVLH\)"
    with pytest.raises(ValueError, match=message):
        RelativeOrbitalElements.from_elements(flat, near_circle())
    with pytest.raises(ValueError, match=message):
        one("longitude", 1e-4).deputy_elements(flat)


def test_a_deputy_on_the_equator_or_past_it_is_refused():
    with pytest.raises(ValueError, match=r"the deputy has an inclination of 0°"):
        one("inclination_x", -0.9).deputy_elements(near_circle())
    with pytest.raises(ValueError, match=r"between 0 and 180 degrees, got -5\.7"):
        one("inclination_x", -1.0).deputy_elements(near_circle())


def test_a_deputy_that_never_comes_back_is_refused():
    with pytest.raises(ValueError, match=r"got an eccentricity of 1.2"):
        one("eccentricity_x", 1.2).deputy_elements(near_circle())
