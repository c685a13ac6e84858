"""Inertial plant, against relative equations, a table of 80-bit numbers, and drag theory."""

import json
from pathlib import Path

import numpy as np
import pytest
from astropy.units import cm, kg, km
from numpy.testing import assert_allclose, assert_array_equal
from orbit_examples import random_orbit

from dynamics.atmosphere import Atmosphere
from dynamics.coordinate_frames import LVLH, inertial_state
from dynamics.forces import Forces
from dynamics.inertial import InertialPlant
from dynamics.j2 import J2
from dynamics.orbit import EARTH_RADIUS, Orbit
from dynamics.plant import NonlinearPlant
from dynamics.propagation import Impact, propagate

TRUTH = json.loads((Path(__file__).parent / "j2_truth.json").read_text())  # in km
CIRCLE = Orbit.from_elements(6878e3, inclination=np.pi / 4)


def relative_states(rng, count, far=1e4):
    return rng.uniform(-1, 1, (count, 6)) * np.repeat([far, far * 1e-3], 3)


def propagate_in_steps(plant, x, u, end, dt, t=0.0):
    while end - t > 1e-9:
        x = plant.propagate(x, u, t, min(dt, end - t))[-1]
        t += min(dt, end - t)
    return x


def test_an_agent_at_the_chief_stays_there():
    air = InertialPlant(CIRCLE, np.array([0.02]), 0.02, Atmosphere())
    for plant in (InertialPlant(CIRCLE), air):
        path = plant.propagate(np.zeros((1, 6)), np.zeros((1, 3)), 500.0, 600.0, 5)
        assert_array_equal(path, np.zeros((6, 1, 6)))


def test_thrust_rotates_with_the_lvlh_axes_of_the_chief(rng):
    orbit = random_orbit(rng)
    x, u = relative_states(rng, 4), rng.normal(0, 1e-3, (4, 3))
    path = InertialPlant(orbit).propagate(x, u, 300.0, 900.0)
    second = NonlinearPlant(J2(orbit)).propagate(x, u, 300.0, 900.0)
    assert_allclose(path, second, rtol=0, atol=1e-6)


def test_relative_motion_is_the_difference_of_two_inertial_orbits(rng):
    orbit = random_orbit(rng)
    plant, x = InertialPlant(orbit), relative_states(rng, 6, 2e4)
    chief = LVLH.from_polar_nodal(orbit.elements_at(0.0), orbit.k_J2)
    both = np.vstack([chief.chief_state, chief.to_inertial(x)])
    path = propagate(both, np.array([orbit.period]), accuracy=1e-13)[0]
    frame = LVLH.from_state(path[0], Forces().acceleration(path[0]))
    end = propagate_in_steps(plant, x, np.zeros((6, 3)), orbit.period, 600.0)
    assert_allclose(end[:, :3], frame.from_inertial(path[1:])[:, :3], atol=1e-6)


@pytest.mark.parametrize("tilt", [0.0, np.pi / 2, np.pi])
def test_the_chief_agrees_with_the_polar_nodal_equations(tilt):
    orbit = Orbit.from_elements(7.5e6, 0.05, tilt, 0.3, 0.4, 0.5)
    plant = InertialPlant(orbit)
    for t in (0.0, 59.0, 3000.0, 7261.5):
        here, there = plant.chief_elements(t), orbit.elements_at(t)
        assert_allclose(here[:3], there[:3], rtol=1e-12, atol=1e-8)
        turn = here[5] - there[5] + np.cos(tilt) * (here[3] - there[3])
        assert np.exp(1j * turn) == pytest.approx(1, abs=1e-12)


def test_higher_drag_moves_an_agent_ahead():
    # A constant along-track acceleration f gives y = −3/2 f t² + 4 f/n² (1 − cos nt)
    # [Clohessy1960]: drag lowers the orbit, and a lower orbit is faster.
    air, more = Atmosphere(rotation_rate=0.0), 0.004
    orbit = Orbit.from_elements(6878e3, inclination=0.5, k_J2=0.0)
    plant = InertialPlant(orbit, np.array([0.02 + more]), 0.02, air)
    t, n = orbit.period, orbit.mean_motion
    end = propagate_in_steps(plant, np.zeros((1, 6)), np.zeros((1, 3)), t, 600.0)
    chief = inertial_state(orbit.elements_at(0.0))
    f = -0.5 * more * float(air.density_at(chief[:3])) * (chief[3:] @ chief[3:])
    assert end[0, 1] == pytest.approx(-1.5 * f * t**2, rel=2e-3)
    assert end[0, 0] == pytest.approx(2 * f * t / n, rel=2e-3)


@pytest.mark.parametrize("dt", [60.0, 480.0])
def test_reference_table_is_met_within_a_hundredth_of_a_micrometer(dt):
    six = 6878e3, 0.0, np.sqrt(TRUTH["mu"] * 6878) * 1e6, 0.0, np.pi / 4, 0.0
    plant = InertialPlant(Orbit(*six, mu=TRUTH["mu"] * 1e9, k_J2=TRUTH["kJ2"] * 1e15))
    found = 1e3 * np.array([deputy["initial"] for deputy in TRUTH["deputies"]])
    ends = {"8min": 480.0, "16min": 960.0, "24min": 1440.0, "1orbit": TRUTH["orbit_s"]}
    begin = 0.0
    for name, end in ends.items():
        known = 1e3 * np.array([deputy[name] for deputy in TRUTH["deputies"]])
        found, begin = propagate_in_steps(plant, found, np.zeros((2, 3)), end, dt, begin), end
        assert_allclose(found[:, :3], known[:, :3], rtol=0, atol=2e-8)
        assert_allclose(found[:, 3:], known[:, 3:], rtol=0, atol=2e-11)
        chief = TRUTH["reference_states"][name] * np.array([1e3, 1e3, 1e6, 1, 1, 1])
        chief[5] -= 2 * np.pi * round(chief[5] / (2 * np.pi))
        digits = [1e-5, 1e-11, 0.1, 1e-14, 1e-11, 1e-11]  # half the last one printed
        assert np.all(np.abs(plant.chief_elements(end) - chief) < np.array(digits))


def test_an_impact_names_agent_and_time():
    plant = InertialPlant(Orbit.from_elements(EARTH_RADIUS + 1e5, 0.0, 0.5))
    falling = np.zeros((3, 6))
    falling[2, 4] = -500.0
    with pytest.raises(Impact, match="agent 2 hits the Earth at t = ") as caught:
        plant.propagate(falling, np.zeros((3, 3)), 600.0, 3000.0)
    assert caught.value.agent == 2
    assert 600 < caught.value.time < 3600


def test_start_inside_the_earth_is_an_impact():
    plant = InertialPlant(Orbit.from_elements(EARTH_RADIUS + 3e5, 0.0, 0.5))
    deep = np.zeros((2, 6))
    deep[1, 0] = -1e6
    with pytest.raises(Impact, match="agent 1 hits the Earth at t = 20 s"):
        plant.propagate(deep, np.zeros((2, 3)), 20.0, 60.0)


def test_an_impact_of_the_chief_is_reported():
    heavy = InertialPlant(
        Orbit.from_elements(EARTH_RADIUS + 1.6e5, 0.0, 0.5),
        np.zeros(1),
        1.0,
        Atmosphere.from_altitude(150e3),
    )
    with pytest.raises(Impact, match="the chief hits the Earth at t = "):
        heavy.chief_elements(3e4)


def test_an_atmosphere_needs_both_ballistic_coefficients():
    for given in ({}, {"ballistic_coefficient": 0.01}, {"chief_ballistic_coefficient": 0.01}):
        with pytest.raises(ValueError, match="C_D A/m of every agent and of the chief"):
            InertialPlant(CIRCLE, atmosphere=Atmosphere(), **given)


@pytest.mark.parametrize(
    "given", [{"ballistic_coefficient": np.array([0.01])}, {"chief_ballistic_coefficient": 0.01}]
)
def test_ballistic_coefficients_need_an_atmosphere(given):
    with pytest.raises(ValueError, match="have no effect without an atmosphere"):
        InertialPlant(CIRCLE, **given)


def test_one_ballistic_coefficient_is_that_of_all_agents(rng):
    x, u, air = relative_states(rng, 3), np.zeros((3, 3)), Atmosphere()
    all_alike = InertialPlant(CIRCLE, 0.01, 0.02, air).propagate(x, u, 0.0, 60.0)
    each = InertialPlant(CIRCLE, np.full(3, 0.01), 0.02, air).propagate(x, u, 0.0, 60.0)
    assert_array_equal(all_alike, each)


def test_quantities_of_drag_are_converted(rng):
    x, u, ballistic = relative_states(rng, 3), np.zeros((3, 3)), 100.0 * cm**2 / kg
    given = InertialPlant(CIRCLE, ballistic, ballistic, Atmosphere.from_altitude(500 * km))
    plain = InertialPlant(CIRCLE, 0.01, 0.01, Atmosphere.from_altitude(500e3))
    assert_allclose(given.propagate(x, u, 0.0, 60.0), plain.propagate(x, u, 0.0, 60.0), rtol=1e-14)


def test_times_before_0_are_refused():
    with pytest.raises(ValueError, match=r"known from time 0 on, .* got t = -1\.0 s"):
        InertialPlant(CIRCLE).chief_elements(-1.0)
