"""The averaged J2: its limits, its sources, and what the exact motion says."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dynamics.clohessy_wiltshire import ClohessyWiltshire
from dynamics.coordinate_frames import LVLH, inertial_state, to_polar_nodal
from dynamics.j2 import gravity_gradient, invariant_velocity
from dynamics.orbit import EARTH_MU, K_J2, Orbit
from dynamics.propagation import propagate
from dynamics.schweighart_sedwick import SchweighartSedwick

model = SchweighartSedwick(6878e3, np.radians(45))


@given(st.floats(6.5e6, 5e7), st.floats(0, np.pi))
def test_without_oblateness_it_is_clohessy_wiltshire(radius, inclination):
    round_earth = SchweighartSedwick(radius, inclination, k_J2=0.0)
    plain = ClohessyWiltshire(round_earth.n)
    np.testing.assert_allclose(round_earth.A(0.0), plain.A(0.0), rtol=1e-15, atol=0)
    t, where = np.linspace(-1e4, 1e4, 7), np.array([300.0, -200.0, 100.0])
    np.testing.assert_allclose(
        round_earth.transition_matrix(t), plain.transition_matrix(t), rtol=1e-11
    )
    np.testing.assert_allclose(
        round_earth.bounded_velocity(where), plain.bounded_velocity(where), rtol=1e-15
    )
    across = round_earth.cross_track_motion(100.0, 0.1, 0.3, t)
    np.testing.assert_allclose(across, plain.transition_matrix(t)[:, 2] @ [0, 0, 100.0, 0, 0, 0.1])


def test_the_drift_free_orbit_is_the_published_one(rng):
    """[Schweighart2002]: an ellipse whose axes are as √(1 − s) to 2 √(1 + s)."""
    x0, y0 = rng.uniform(-1000, 1000, (2, 8))
    place = np.stack([x0, y0, np.zeros(8)], axis=-1)
    velocity = model.centered_velocity(place)
    s, n = model.s, model.n
    np.testing.assert_allclose(velocity[:, 0], n * y0 * (1 - s) / (2 * np.sqrt(1 + s)), rtol=1e-13)
    np.testing.assert_allclose(velocity[:, 1], -2 * n * x0 * np.sqrt(1 + s), rtol=1e-13)
    t = np.linspace(0, 2e4, 50)
    path = np.einsum("tij,kj->ikt", model.transition_matrix(t), np.hstack([place, velocity]))
    C, S = np.cos(n * np.sqrt(1 - s) * t), np.sin(n * np.sqrt(1 - s) * t)
    axes = np.sqrt(1 - s) / (2 * np.sqrt(1 + s))
    np.testing.assert_allclose(path[0], np.outer(x0, C) + axes * np.outer(y0, S), atol=1e-9)
    np.testing.assert_allclose(path[1], np.outer(y0, C) - np.outer(x0, S) / axes, atol=1e-9)


def test_s_and_c_are_those_of_the_definition():
    J2, R = 1.0826359e-3, 6378136.6  # [IERS2010]
    s = 3 * J2 * R**2 / (8 * 6878e3**2) * (1 + 3 * np.cos(2 * model.inclination))
    assert model.s == pytest.approx(s, rel=1e-14)
    assert model.c**2 == pytest.approx(1 + s, rel=1e-14)
    k_z = model.n * model.c + 3 * model.n * J2 * R**2 / (2 * 6878e3**2) / 2
    assert model.k_z == pytest.approx(k_z, rel=1e-14)


@given(st.floats(6.5e6, 2e7), st.floats(0, np.pi))
def test_its_radial_pull_is_the_gravity_gradient_averaged_round_the_circle(radius, inclination):
    circle = SchweighartSedwick(radius, inclination)
    orbit = Orbit.from_elements(radius, inclination=inclination)
    theta = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    tilt = np.sin(inclination)
    pole = np.stack([tilt * np.sin(theta), tilt * np.cos(theta), 0 * theta], axis=-1)
    pole[:, 2] = np.cos(inclination)
    R = np.tile([radius, 0.0, 0.0], (16, 1))
    pull = gravity_gradient(R, pole, orbit)[:, 0, 0].mean() + circle.rotation_rate**2
    assert circle.radial_gradient == pytest.approx(pull, rel=1e-12)


def chief(inclination, latitude):
    return Orbit.from_elements(7000e3, inclination=inclination, true_anomaly=latitude)


def test_its_rates_are_the_average_rates_of_the_orbit():
    tilts, latitudes = np.meshgrid([0.2, 0.8, 1.7], [0.0, 0.8, 1.6])
    orbits = [chief(*pair) for pair in zip(tilts.ravel(), latitudes.ravel(), strict=True)]
    means = [SchweighartSedwick.from_orbit(orbit) for orbit in orbits]
    t = np.linspace(0, 10 * 2 * np.pi / model.n, 2001)
    path = to_polar_nodal(
        propagate(inertial_state(np.array([o.initial_elements for o in orbits])), t)
    )
    r, _, h, _, _, theta = np.moveaxis(path, -1, 0)
    rate = np.diff(np.unwrap(theta[[*range(0, 2001, 50)]], axis=0), axis=0).mean(axis=0) / t[50]
    # Ten orbits, and not quite whole ones: what repeats in each leaves less than 1e-4.
    np.testing.assert_allclose(rate, [mean.k_z for mean in means], rtol=1e-4)
    np.testing.assert_allclose((h / r**2).mean(axis=0), [m.rotation_rate for m in means], rtol=1e-4)
    # The semi-major axis of an instant would not do.
    naive = [SchweighartSedwick(7000e3, orbit.inclination).k_z for orbit in orbits]
    assert (np.abs(naive / rate - 1) > 4e-4).all()
    assert np.abs(naive / rate - 1).max() > 2e-3


def test_about_a_round_earth_the_circle_is_the_orbit():
    orbit = Orbit.from_elements(7000e3, inclination=1.0, true_anomaly=0.4, k_J2=0.0)
    assert SchweighartSedwick.from_orbit(orbit).radius == pytest.approx(7000e3, rel=1e-12)


def across_for_real(orbit, z, velocity, t):
    x = np.zeros((2, 6))
    x[1] = [0, 0, z, 0, invariant_velocity(orbit, np.zeros(3))[1], velocity]
    start = LVLH.from_polar_nodal(np.array(orbit.start), orbit.k_J2).to_inertial(x)
    path = propagate(start, t)
    return LVLH.from_state(path[:, 0]).from_inertial(path)[:, 1, 2]


def test_planes_of_one_inclination_keep_their_distance():
    """A second opinion: the exact motion, ten orbits on; only what is averaged away is left."""
    orbit = chief(np.radians(45), 0.0)
    mean = SchweighartSedwick.from_orbit(orbit)
    t = np.linspace(0, 10 * 2 * np.pi / mean.k_z, 401)
    truth = across_for_real(orbit, 1000.0, 0.0, t)
    np.testing.assert_allclose(mean.transition_matrix(t)[:, 2, 2] * 1000, truth, atol=3)
    np.testing.assert_allclose(mean.cross_track_motion(1000.0, 0.0, 0.0, t), truth, atol=3)


@pytest.mark.parametrize("latitude", [0.0, 1.2])
def test_planes_of_two_inclinations_part_as_stated(latitude):
    orbit = chief(np.radians(80), latitude)
    mean = SchweighartSedwick.from_orbit(orbit)
    t = np.linspace(0, 10 * 2 * np.pi / mean.k_z, 401)
    z, velocity = 700.0, 0.7
    truth = across_for_real(orbit, z, velocity, t)
    without = mean.transition_matrix(t)[:, 2] @ [0, 0, z, 0, 0, velocity]
    assert np.abs(without - truth).max() > 50
    np.testing.assert_allclose(mean.cross_track_motion(z, velocity, latitude, t), truth, atol=5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radius": 6878.0}, "above the Earth's, 6378 km, from the centre and in metres, got 6878"),
        ({"radius": np.nan}, "radius above"),
        ({"inclination": 45.0}, "degrees are to be converted"),
        ({"mu": 0.0}, "gravity must be positive"),
        ({"k_J2": 100 * K_J2}, r"small part of gravity here.*the Earth's is 2\.633e\+25"),
        ({"k_J2": np.nan}, "small part"),
    ],
)
def test_an_orbit_that_is_none_is_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(model, **change)


def test_it_is_about_the_earth_unless_told():
    assert (model.mu, model.k_J2) == (EARTH_MU, K_J2)
