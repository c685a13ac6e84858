"""Gravity and drag: potential, rounding, and the density table."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from orbit_examples import inertial_states

from dynamics.atmosphere import DENSITY_TABLE, Atmosphere
from dynamics.forces import Forces
from dynamics.orbit import EARTH_J2, EARTH_MU, EARTH_RADIUS, EARTH_ROTATION

seeds = st.integers(0, 2**32 - 1)


def states(rng, count):
    e = rng.uniform(0, 0.5, count)
    angles = rng.uniform(0, np.pi, (4, count))
    return inertial_states(rng.uniform(7e6, 9e6, count) / (1 - e), e, *angles)


def potential(position):
    # [Vallado2013, Sec. 8.6] with J2 alone: U = −μ/r (1 − J₂ (R/r)² (3 sin²φ − 1)/2).
    r, sine = np.linalg.norm(position), position[2] / np.linalg.norm(position)
    oblateness = EARTH_J2 * (EARTH_RADIUS / r) ** 2 * (3 * sine**2 - 1) / 2
    return -EARTH_MU / r * (1 - oblateness)


@given(seeds)
def test_gravity_is_the_gradient_of_its_potential(seed):
    state = states(np.random.default_rng(seed), 1)[0]
    at, h = state[:3], 2000.0
    slope = [
        sum(
            w * potential(at + k * h * axis)
            for k, w in zip((-2, -1, 1, 2), (1, -8, 8, -1), strict=True)
        )
        / (12 * h)
        for axis in np.eye(3)
    ]
    assert_allclose(Forces().acceleration(state), -np.array(slope), atol=1e-11)


@given(seeds, st.floats(1, 1e6))
def test_differential_acceleration_is_that_of_two_spacecraft(seed, far):
    rng = np.random.default_rng(seed)
    chief, air = states(rng, 1)[0], Forces(atmosphere=Atmosphere())
    offset = rng.uniform(-1, 1, (4, 6)) * np.repeat([far, far / 1e3], 3)
    drag = rng.uniform(0, 0.1, 4)
    direct = air.acceleration(chief + offset, drag) - air.acceleration(chief, 0.03)
    found = air.differential_acceleration(chief, offset, drag, 0.03)
    assert_allclose(found, direct, rtol=0, atol=1e-14)


def test_differential_acceleration_loses_no_digits_to_cancellation():
    chief, push = np.array([7e6, 0, 0, 0, 7.5e3, 0]), Forces(k_J2=0.0)
    offset = np.array([1e-3, 0, 0, 0, 0, 0])
    # 2μ d/R³ (1 − 3/2 d/R + …) along the radius
    expected = 2 * EARTH_MU * 1e-3 / 7e6**3 * (1 - 1.5e-3 / 7e6)
    assert push.differential_acceleration(chief, offset)[0] == pytest.approx(expected, rel=1e-14)


def test_drag_opposes_velocity_relative_to_the_rotating_air():
    air, B = Atmosphere(), 0.02
    at = np.array([EARTH_RADIUS + 500e3, 0, 0])
    corotating = np.array([*at, 0, EARTH_ROTATION * at[0], 0])
    np.testing.assert_array_equal(air.drag_acceleration(corotating, B), np.zeros(3))
    found = air.drag_acceleration(corotating + np.array([0, 0, 0, 0, 7e3, 0]), B)
    assert_allclose(found, [0, -0.5 * 6.967e-13 * B * 7e3**2, 0])


def test_density_falls_by_e_in_a_scale_height():
    air = Atmosphere.from_altitude(420e3)
    low, high = (np.array([0, 0, EARTH_RADIUS + h]) for h in (400e3, 400e3 + 58.515e3))
    assert air.density_at(low) == pytest.approx(3.725e-12)
    assert air.density_at(high) == pytest.approx(3.725e-12 / np.e)


def test_rows_of_the_density_table_join_within_3_percent():
    # The table itself is continuous to 3 % only.
    for (h, density, scale), (above, next_density, _) in pairwise(DENSITY_TABLE):
        assert density * np.exp(-(above - h) / scale) == pytest.approx(next_density, rel=0.03)


@pytest.mark.parametrize(
    ("wrong", "said"), [(-0.01, "finite and not negative"), (np.nan, r"with nan at \[1\]")]
)
def test_negative_ballistic_coefficients_are_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        Forces(atmosphere=Atmosphere()).validate_ballistic_coefficients(np.array([0.01, wrong]))


def test_altitudes_below_the_density_table_are_refused():
    with pytest.raises(ValueError, match=r"begins at 150 km.* got 0.5 km; altitudes are in meters"):
        Atmosphere.from_altitude(500.0)


def test_a_negative_density_is_refused():
    with pytest.raises(ValueError, match=r"reference_density: .* at least 0, got -1\.0"):
        Atmosphere(-1.0, 5e5, 6e4)
