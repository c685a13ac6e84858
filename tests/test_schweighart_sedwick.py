"""Schweighart–Sedwick, against its source, its limits and exact motion under J2."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from orbit_examples import transition_matrix

from dynamics.circular_orbit import ClohessyWiltshire, SchweighartSedwick
from dynamics.coordinate_frames import LVLH, inertial_state, to_polar_nodal
from dynamics.j2 import gravity_gradient, invariant_velocity
from dynamics.orbit import K_J2, Orbit
from dynamics.propagation import propagate

model = SchweighartSedwick(6878e3, np.radians(45))


@given(st.floats(6.5e6, 5e7), st.floats(0, np.pi))
def test_without_oblateness_it_is_clohessy_wiltshire(radius, inclination):
    round_earth = SchweighartSedwick(radius, inclination, k_J2=0.0)
    plain = ClohessyWiltshire(round_earth.n)
    assert_allclose(round_earth.A(0.0), plain.A(0.0), rtol=1e-15, atol=0)
    position = np.array([300.0, -200.0, 100.0])
    here, there = round_earth.bounded_velocity(position), plain.bounded_velocity(position)
    assert_allclose(here, there, rtol=1e-15)


def test_the_centered_orbit_is_the_published_one(rng):
    """[Schweighart2002]: an ellipse with semi-axes in the ratio √(1 − s) : 2 √(1 + s)."""
    x0, y0 = rng.uniform(-1000, 1000, (2, 8))
    place = np.stack([x0, y0, np.zeros(8)], axis=-1)
    velocity = model.centered_velocity(place)
    s, n = model.s, model.n
    assert_allclose(velocity[:, 0], n * y0 * (1 - s) / (2 * np.sqrt(1 + s)), rtol=1e-13)
    assert_allclose(velocity[:, 1], -2 * n * x0 * np.sqrt(1 + s), rtol=1e-13)
    t = np.linspace(10, 2e4, 50)
    path = np.einsum("tij,kj->ikt", transitions(model, t), np.hstack([place, velocity]))
    C, S = np.cos(n * np.sqrt(1 - s) * t), np.sin(n * np.sqrt(1 - s) * t)
    axes = np.sqrt(1 - s) / (2 * np.sqrt(1 + s))
    assert_allclose(path[0], np.outer(x0, C) + axes * np.outer(y0, S), atol=1e-9)
    assert_allclose(path[1], np.outer(y0, C) - np.outer(x0, S) / axes, atol=1e-9)


def test_constants_follow_their_definitions():
    J2, R = 1.0826359e-3, 6378136.6  # [IERS2010]
    s = 3 * J2 * R**2 / (8 * 6878e3**2) * (1 + 3 * np.cos(2 * model.inclination))
    assert model.s == pytest.approx(s, rel=1e-14)
    assert model.c**2 == pytest.approx(1 + s, rel=1e-14)
    k_z = model.n * model.c + 3 * model.n * J2 * R**2 / (2 * 6878e3**2) / 2
    assert model.cross_track_rate == pytest.approx(k_z, rel=1e-14)


@given(st.floats(6.5e6, 2e7), st.floats(0, np.pi))
def test_radial_gradient_is_the_mean_gravity_gradient(radius, inclination):
    circle = SchweighartSedwick(radius, inclination)
    orbit = Orbit.from_elements(radius, inclination=inclination)
    theta = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    tilt = np.sin(inclination)
    pole = np.stack([tilt * np.sin(theta), tilt * np.cos(theta), 0 * theta], axis=-1)
    pole[:, 2] = np.cos(inclination)
    R = np.tile([radius, 0.0, 0.0], (16, 1))
    pull = gravity_gradient(R, pole, orbit)[:, 0, 0].mean() + circle.rotation_rate**2
    assert circle.radial_gradient == pytest.approx(pull, rel=1e-12)


def transitions(model, times):
    return np.array([transition_matrix(model, t) for t in times])


def chief(inclination, latitude):
    return Orbit.from_elements(7000e3, inclination=inclination, true_anomaly=latitude)


def test_rates_are_the_mean_rates_of_the_orbit():
    tilts, latitudes = np.meshgrid([0.2, 0.8, 1.7], [0.0, 0.8, 1.6])
    orbits = [chief(*pair) for pair in zip(tilts.ravel(), latitudes.ravel(), strict=True)]
    means = [SchweighartSedwick.from_orbit(orbit) for orbit in orbits]
    t = np.linspace(0, 10 * 2 * np.pi / model.n, 2001)
    path = to_polar_nodal(
        propagate(inertial_state(np.array([o.initial_elements for o in orbits])), t)
    )
    r, _, h, _, _, theta = np.moveaxis(path, -1, 0)
    rate = np.diff(np.unwrap(theta[[*range(0, 2001, 50)]], axis=0), axis=0).mean(axis=0) / t[50]
    # Periodic terms leave less than 1e-4 after ten orbits, which are not quite complete.
    assert_allclose(rate, [mean.cross_track_rate for mean in means], rtol=1e-4)
    assert_allclose((h / r**2).mean(axis=0), [m.rotation_rate for m in means], rtol=1e-4)
    # The osculating semi-major axis gives worse rates.
    naive = [SchweighartSedwick(7000e3, orbit.inclination).cross_track_rate for orbit in orbits]
    assert (np.abs(naive / rate - 1) > 4e-4).all()
    assert np.abs(naive / rate - 1).max() > 2e-3


def test_without_oblateness_the_radius_is_that_of_the_orbit():
    orbit = Orbit.from_elements(7000e3, inclination=1.0, true_anomaly=0.4, k_J2=0.0)
    assert SchweighartSedwick.from_orbit(orbit).radius == pytest.approx(7000e3, rel=1e-12)


def exact_cross_track(orbit, z, velocity, t):
    x = np.zeros((2, 6))
    x[1] = [0, 0, z, 0, invariant_velocity(orbit, np.zeros(3))[1], velocity]
    start = LVLH.from_polar_nodal(np.array(orbit.initial_elements), orbit.k_J2).to_inertial(x)
    path = propagate(start, t)
    return LVLH.from_state(path[:, 0]).from_inertial(path)[:, 1, 2]


def test_equal_inclinations_keep_the_cross_track_amplitude():
    """Compare ten orbits with exact motion; only the periodic terms are left."""
    orbit = chief(np.radians(45), 0.0)
    mean = SchweighartSedwick.from_orbit(orbit)
    t = np.linspace(10, 10 * 2 * np.pi / mean.cross_track_rate, 400)
    truth = exact_cross_track(orbit, 1000.0, 0.0, t)
    assert_allclose(transitions(mean, t)[:, 2, 2] * 1000, truth, atol=3)


@pytest.mark.parametrize("latitude", [0.0, 1.2])
def test_unequal_inclinations_add_the_stated_cross_track_growth(latitude):
    orbit = chief(np.radians(80), latitude)
    mean = SchweighartSedwick.from_orbit(orbit)
    t = np.linspace(10, 10 * 2 * np.pi / mean.cross_track_rate, 400)
    z, velocity = 700.0, 0.7
    truth = exact_cross_track(orbit, z, velocity, t)
    modeled = transitions(mean, t)[:, 2] @ [0, 0, z, 0, 0, velocity]
    assert np.abs(modeled - truth).max() > 50
    # The growth that the model leaves out: −r sin i ΔΩ cos(θ + k_z t), where the nodes drift
    # apart by ΔΩ, to first order in J2 and z [Schweighart2002].
    q, i = mean.cross_track_rate, mean.inclination
    inclined = z * np.sin(latitude) + velocity / q * np.cos(latitude)  # r Δi
    parted = mean.n * mean.k_J2 / (mean.mu * mean.radius**2) * np.sin(i) ** 2 * inclined * t
    assert_allclose(modeled - parted * np.cos(latitude + q * t), truth, atol=5)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"radius": 6878.0}, "above the Earth's, 6378 km, .* in meters, got 6878"),
        ({"radius": np.nan}, "radius: must be a finite number, got nan"),
        ({"inclination": 45.0}, r"got 45 rad; .*45° would be 0\.785"),
        ({"mu": 0.0}, "mu: must be a finite number above 0"),
        ({"k_J2": 100 * K_J2}, r"small part of gravity.*of the Earth .* 2\.633e\+25"),
        ({"k_J2": np.nan}, "k_J2: must be a finite number at most .*, got nan"),
    ],
)
def test_invalid_orbits_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(model, **change)
