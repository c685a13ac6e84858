"""The truth to fly against: second opinions on it, drag, and a table of 80-bit numbers."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from dynamics.atmosphere import Atmosphere
from dynamics.coordinate_frames import LVLH
from dynamics.elements import ClassicalElements
from dynamics.forces import Forces
from dynamics.inertial import InertialPlant
from dynamics.j2 import J2
from dynamics.orbit import EARTH_RADIUS, Orbit
from dynamics.propagation import Impact, propagate

TRUTH = json.loads((Path(__file__).parent / "j2_truth.json").read_text())  # in km
CIRCLE = Orbit.from_elements(6878e3, inclination=np.pi / 4)


def random_orbit(rng):
    e = rng.uniform(0, 0.3)
    return Orbit.from_elements((EARTH_RADIUS + 4e5) / (1 - e), e, *rng.uniform(0, np.pi, 4))


def some(rng, count, far=1e4):
    return rng.uniform(-1, 1, (count, 6)) * np.repeat([far, far * 1e-3], 3)


def in_steps(plant, x, u, end, dt, t=0.0):
    while end - t > 1e-9:
        x = plant.propagate(x, u, t, min(dt, end - t))[-1]
        t += min(dt, end - t)
    return x


def test_a_vehicle_at_the_chief_stays_there():
    air = InertialPlant(CIRCLE, np.array([0.02]), 0.02, Atmosphere())
    for plant in (InertialPlant(CIRCLE), air):
        path = plant.propagate(np.zeros((1, 6)), np.zeros((1, 3)), 500.0, 600.0, 5)
        np.testing.assert_array_equal(path, np.zeros((6, 1, 6)))


def test_thrust_changes_velocity_by_its_time():
    u = np.array([[1e-3, 0, 0], [0, 1e-3, 0], [0, 0, 1e-3]])
    end = InertialPlant(CIRCLE).propagate(np.zeros((3, 6)), u, 100.0, 0.1)[-1]
    np.testing.assert_allclose(end[:, 3:], u * 0.1, rtol=0, atol=3e-8)


def test_thrust_turns_with_the_chief(rng):
    # The relative equations hold their input in the chief's frame; these do so in space.
    orbit = random_orbit(rng)
    x, u = some(rng, 4), rng.normal(0, 1e-3, (4, 3))
    model = J2(orbit)
    second = solve_ivp(
        lambda t, y: model.rate(t, y.reshape(4, 6), u).ravel(),
        (300.0, 1200.0),
        x.ravel(),
        method="DOP853",
        rtol=1e-12,
        atol=1e-9,
    ).y[:, -1]
    flown = InertialPlant(orbit).propagate(x, u, 300.0, 900.0)[-1]
    np.testing.assert_allclose(flown, second.reshape(4, 6), rtol=0, atol=1e-6)


def test_it_is_the_difference_of_two_flights_in_inertial_space(rng):
    orbit = random_orbit(rng)
    plant, x = InertialPlant(orbit), some(rng, 6, 2e4)
    chief = LVLH.from_polar_nodal(orbit.elements_at(0.0), orbit.k_J2)
    both = np.vstack([chief.chief_state, chief.to_inertial(x)])
    flown = propagate(both, np.array([orbit.period]), accuracy=1e-13)[0]
    frame = LVLH.from_state(flown[0], Forces().acceleration(flown[0]))
    end = in_steps(plant, x, np.zeros((6, 3)), orbit.period, 600.0)
    np.testing.assert_allclose(end[:, :3], frame.from_inertial(flown[1:])[:, :3], atol=1e-6)


def test_it_agrees_with_the_relative_equations(rng):
    orbit = random_orbit(rng)
    x = some(rng, 6, 2e4)
    flown = InertialPlant(orbit).propagate(x, np.zeros((6, 3)), 0.0, 2e3, 2)
    second = J2(orbit).propagate(x, np.array([0.0, 1e3, 2e3]))
    np.testing.assert_allclose(flown, second, rtol=0, atol=1e-6)


@pytest.mark.parametrize("tilt", [0.0, np.pi / 2, np.pi])
def test_the_chief_moves_as_its_six_numbers_do(tilt):
    orbit = Orbit.from_elements(7.5e6, 0.05, tilt, 0.3, 0.4, 0.5)
    plant = InertialPlant(orbit)
    for t in (0.0, 59.0, 3000.0, 7261.5):
        here, there = plant.chief_elements(t), orbit.elements_at(t)
        np.testing.assert_allclose(here[:3], there[:3], rtol=1e-12, atol=1e-8)
        turn = here[5] - there[5] + np.cos(tilt) * (here[3] - there[3])
        assert np.exp(1j * turn) == pytest.approx(1, abs=1e-12)


def test_drag_of_one_more_than_the_other_carries_it_ahead():
    # Under a steady pull f along the orbit y = −3/2 f t² + 4 f/n² (1 − cos nt)
    # [Clohessy1960]: who is braked falls, and then leads.
    air, more = Atmosphere(rotation_rate=0.0), 0.004
    orbit = Orbit.from_elements(6878e3, inclination=0.5, k_J2=0.0)
    plant = InertialPlant(orbit, np.array([0.02 + more]), 0.02, air)
    t, n = orbit.period, orbit.mean_motion
    end = in_steps(plant, np.zeros((1, 6)), np.zeros((1, 3)), t, 600.0)
    chief = ClassicalElements.from_polar_nodal(orbit.elements_at(0.0)).to_state()
    f = -0.5 * more * float(air.density_at(chief[:3])) * (chief[3:] @ chief[3:])
    assert end[0, 1] == pytest.approx(-1.5 * f * t**2, rel=2e-3)
    assert end[0, 0] == pytest.approx(2 * f * t / n, rel=2e-3)


def test_the_chief_sinks_where_there_is_air():
    # −2π B ρ a² a revolution, the air at rest [Wertz1999, Sec. 6.2].
    orbit = Orbit.from_elements(6878e3, k_J2=0.0)
    sinking = InertialPlant(orbit, np.array([0.02]), 0.02, Atmosphere(rotation_rate=0.0))
    end = ClassicalElements.from_polar_nodal(sinking.chief_elements(orbit.period))
    density = Atmosphere().density_at(np.array([6878e3, 0, 0]))
    known = -2 * np.pi * 0.02 * density * 6878e3**2
    assert end.semi_major_axis - 6878e3 == pytest.approx(known, rel=1e-3)


@pytest.mark.parametrize("dt", [60.0, 480.0])
def test_the_truth_table_is_met_within_a_hundredth_of_a_micrometre(dt):
    six = 6878e3, 0.0, np.sqrt(TRUTH["mu"] * 6878) * 1e6, 0.0, np.pi / 4, 0.0
    plant = InertialPlant(Orbit(*six, mu=TRUTH["mu"] * 1e9, k_J2=TRUTH["kJ2"] * 1e15))
    found = 1e3 * np.array([deputy["initial"] for deputy in TRUTH["deputies"]])
    ends = {"8min": 480.0, "16min": 960.0, "24min": 1440.0, "1orbit": TRUTH["orbit_s"]}
    begin = 0.0
    for name, end in ends.items():
        known = 1e3 * np.array([deputy[name] for deputy in TRUTH["deputies"]])
        found, begin = in_steps(plant, found, np.zeros((2, 3)), end, dt, begin), end
        np.testing.assert_allclose(found[:, :3], known[:, :3], rtol=0, atol=2e-8)
        np.testing.assert_allclose(found[:, 3:], known[:, 3:], rtol=0, atol=2e-11)
        chief = TRUTH["reference_states"][name] * np.array([1e3, 1e3, 1e6, 1, 1, 1])
        chief[5] -= 2 * np.pi * round(chief[5] / (2 * np.pi))
        digits = [1e-5, 1e-11, 0.1, 1e-14, 1e-11, 1e-11]  # half the last one printed
        assert np.all(np.abs(plant.chief_elements(end) - chief) < np.array(digits))


def test_who_meets_the_earth_is_named():
    plant = InertialPlant(Orbit.from_elements(EARTH_RADIUS + 1e5, 0.0, 0.5))
    falling = np.zeros((3, 6))
    falling[2, 4] = -500.0
    with pytest.raises(Impact, match="vehicle 2 meets the Earth at t = ") as caught:
        plant.propagate(falling, np.zeros((3, 3)), 600.0, 3000.0)
    assert caught.value.agent == 2
    assert 600 < caught.value.time < 3600


def test_a_chief_that_falls_is_named():
    heavy = InertialPlant(
        Orbit.from_elements(EARTH_RADIUS + 1.6e5, 0.0, 0.5),
        np.zeros(1),
        1.0,
        Atmosphere.from_altitude(150e3),
    )
    with pytest.raises(Impact, match="the chief meets the Earth at t = "):
        heavy.chief_elements(3e4)


def test_drag_needs_the_coefficients_of_the_vehicles():
    with pytest.raises(ValueError, match="drag needs the ballistic coefficient C_D A/m of every"):
        InertialPlant(CIRCLE, atmosphere=Atmosphere())


@pytest.mark.parametrize("half", [{"ballistic": np.array([0.01])}, {"chief_ballistic": 0.01}])
def test_coefficients_need_air(half):
    with pytest.raises(ValueError, match="do nothing without an atmosphere"):
        InertialPlant(CIRCLE, **half)


def test_one_coefficient_is_that_of_all(rng):
    x, u, air = some(rng, 3), np.zeros((3, 3)), Atmosphere()
    all_alike = InertialPlant(CIRCLE, 0.01, 0.02, air).propagate(x, u, 0.0, 60.0)
    each = InertialPlant(CIRCLE, np.full(3, 0.01), 0.02, air).propagate(x, u, 0.0, 60.0)
    np.testing.assert_array_equal(all_alike, each)


def test_more_coefficients_than_vehicles_are_refused():
    plant = InertialPlant(CIRCLE, np.full(3, 0.01), 0.01, Atmosphere())
    with pytest.raises(
        ValueError, match=r"one for every vehicle: there are 2 vehicles and 3 coefficients"
    ):
        plant.propagate(np.zeros((2, 6)), np.zeros((2, 3)), 0.0, 60.0)


def test_nothing_is_known_before_time_0():
    with pytest.raises(ValueError, match=r"known from time 0 on, got t = -1.0 s"):
        InertialPlant(CIRCLE).chief_elements(-1.0)
